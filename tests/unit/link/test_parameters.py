"""Integers in a PARAM_VALUE: ArduPilot's as numbers, PX4's as bytes in a float's place."""

import math
import struct

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.link.codec import mavlink
from companion.link.commands import ParameterRequest, ParameterRequests
from tests.unit.link.telemetry.autopilot_readings import packed

INT8, INT32, REAL32 = (
    mavlink.MAV_PARAM_TYPE_INT8,
    mavlink.MAV_PARAM_TYPE_INT32,
    mavlink.MAV_PARAM_TYPE_REAL32,
)


def as_bytes(value: int) -> float:
    """The float with an integer's bytes, as PX4 sends it."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


@pytest.mark.parametrize(
    ("kind", "sent", "param_type", "told"),
    [
        ("ardupilot", 9.0, INT32, 9.0),
        ("ardupilot", -1.0, INT8, -1.0),
        ("px4", as_bytes(5), INT32, 5.0),
        ("px4", as_bytes(-1), INT32, -1.0),  # its bytes are no number as a float
        ("px4", as_bytes(0), INT32, 0.0),
        ("px4", 0.5, REAL32, 0.5),
        ("px4", math.nan, REAL32, None),
    ],
)
def test_an_integer_is_read_as_its_autopilot_sends_it(
    kind: AutopilotKind, sent: float, param_type: int, told: float | None
) -> None:
    requests, request = ParameterRequests(), ParameterRequest("COM_OBL_RC_ACT")
    requests.submit(request)
    requests.to_send(0.0, 1)
    message = mavlink.MAVLink_param_value_message(b"COM_OBL_RC_ACT", sent, param_type, 9, 0)
    requests.heard(packed(message), kind)
    assert request.value == told
