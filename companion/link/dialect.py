"""The MAVLink dialect of the link: pymavlink's `ardupilotmega` (which holds `common`), and CURRENT_MODE.

CURRENT_MODE (436) has moved into MAVLink's `common` in 2024, and PX4 1.15 and later send it; the pymavlink in
use has it among the messages in development only, whose dialects take a second to import. It is built here
from the message's definition: custom_mode and intended_custom_mode, 32 bits each, and the standard mode.
"""

import struct
from typing import Any, Final

from pymavlink.dialects.v20 import ardupilotmega

mavlink: Any = ardupilotmega
CURRENT_MODE: Final = 436


class CurrentMode(mavlink.MAVLink_message):  # type: ignore[misc]
    """CURRENT_MODE: `custom_mode` as in HEARTBEAT, sent at a rate that can be set."""

    id = CURRENT_MODE
    msgname = "CURRENT_MODE"
    fieldnames = ("standard_mode", "custom_mode", "intended_custom_mode")
    ordered_fieldnames = ("custom_mode", "intended_custom_mode", "standard_mode")
    fieldtypes = ("uint8_t", "uint32_t", "uint32_t")
    fielddisplays_by_name: Final[dict[str, str]] = {}
    fieldenums_by_name: Final[dict[str, str]] = {"standard_mode": "MAV_STANDARD_MODE"}
    fieldunits_by_name: Final[dict[str, str]] = {}
    native_format = bytearray(b"<IIB")
    orders = (2, 0, 1)
    lengths = (1, 1, 1)
    array_lengths = (0, 0, 0)
    crc_extra = 193
    unpacker = struct.Struct("<IIB")
    instance_field = None
    instance_offset = -1

    def __init__(self, standard_mode: int, custom_mode: int, intended_custom_mode: int) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field = self.instance_field
        self._instance_offset = self.instance_offset
        self.standard_mode = standard_mode
        self.custom_mode = custom_mode
        self.intended_custom_mode = intended_custom_mode

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, as pymavlink's own messages pack themselves."""
        payload = self.unpacker.pack(self.custom_mode, self.intended_custom_mode, self.standard_mode)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


mavlink.mavlink_map.setdefault(CURRENT_MODE, CurrentMode)


def message_number(name: str) -> int:
    """MAVLink's number of a message.

    Raises:
        KeyError: the dialect has no such message.
    """
    number: int = CURRENT_MODE if name == CurrentMode.msgname else vars(mavlink)[f"MAVLINK_MSG_ID_{name}"]
    return number
