"""Between a firmware and its clients: MAVLink is forwarded unchanged; the ground station receives it too.

The counterpart of `sitl.mavlink.network` for the bundled autopilots. Once a tick what the firmware has sent
goes to every client, so that load on the machine changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from companion.base.geometry import Vector3
from sitl.firmware.base import Firmware
from sitl.mavlink.framing import FrameReader, MavFrame, dialect
from sitl.mavlink.ground_station import GroundStation

mavlink: Any = dialect

Write = Callable[[Sequence[bytes]], None]
AUTOPILOT: Final = 1


class FirmwarePort:
    """One client."""

    def __init__(self, write: Write, *, datagrams: bool) -> None:
        self.write = write
        self.reader = FrameReader(datagrams=datagrams)


class FirmwareNetwork:
    """All clients of one firmware, and the state in its heartbeat."""

    def __init__(self, firmware: Firmware, ground_station: GroundStation) -> None:
        self.armed = False
        self._firmware = firmware
        self._ground_station = ground_station
        self._decoder = mavlink.MAVLink(None)
        self._reader = FrameReader(datagrams=True)
        self._ports: list[FirmwarePort] = []

    def connect(self, write: Write, *, datagrams: bool) -> FirmwarePort:
        """Open a port for a client; `datagrams`: whole ones are handed to `receive`."""
        port = FirmwarePort(write, datagrams=datagrams)
        self._ports.append(port)
        return port

    def disconnect(self, port: Any) -> None:
        """Close a port."""
        self._ports.remove(port)

    def receive(self, port: Any, data: bytes, now_s: float) -> None:
        """Take what a client sent: to the firmware frame by frame, and to the ground station."""
        for frame in port.reader.read(data, now_s):
            self._firmware.write(frame.data)
            self._ground_station.handle(frame, now_s)

    def transmit(self, now_s: float, pad_position_ned_m: Vector3, pad_velocity_ned_m_s: Vector3) -> None:
        """Forward what the firmware and the ground station have sent; the beacon is at the pad."""
        sent = self._firmware.read()
        for data in sent:
            for frame in self._reader.read(data, now_s):
                self._watch(frame)
        beacon = self._ground_station.transmit(now_s, pad_position_ned_m, pad_velocity_ned_m_s)
        if beacon:
            self._firmware.write(beacon)
            sent.append(beacon)
        for port in tuple(self._ports) if sent else ():
            port.write(sent)

    def _watch(self, frame: MavFrame) -> None:
        is_its = frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and frame.component == AUTOPILOT
        if is_its:
            mode = self._decoder.decode(bytearray(frame.data)).base_mode
            self.armed = bool(mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
