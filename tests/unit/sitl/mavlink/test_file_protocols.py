"""Logs and files of a vehicle without any: every request of a client has an answer."""

import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight

HEADER = struct.Struct("<HBBBBBBI")
ACK, NAK = 128, 129


def answers(*messages: Any) -> list[Any]:
    """What the vehicle sends back, telemetry apart."""
    flight = AutopilotFlight("px4")
    endpoint = MavlinkEndpoint(flight.autopilot)
    client, ours = mavlink.MAVLink(None, srcSystem=245, srcComponent=190), mavlink.MAVLink(None)
    for message in messages:
        endpoint.receive(message.pack(client), 1.0)
    return list(ours.parse_buffer(b"".join(endpoint.answers(1.0))) or [])


def ftp(opcode: int, data: bytes = b"", sequence: int = 7) -> Any:
    payload = (HEADER.pack(sequence, 0, opcode, len(data), 0, 0, 0, 0) + data).ljust(251, b"\0")
    return mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload))


def test_there_are_no_logs() -> None:
    [entry] = answers(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    assert (entry.get_type(), entry.num_logs, entry.last_log_num, entry.size) == ("LOG_ENTRY", 0, 0, 0)
    [data] = answers(mavlink.MAVLink_log_request_data_message(1, 1, 3, 90, 90))
    assert (data.get_type(), data.id, data.ofs, data.count) == ("LOG_DATA", 3, 90, 0)


@pytest.mark.parametrize(
    ("opcode", "error"), [(3, 10), (4, 10), (5, 4), (6, 9), (11, 9), (14, 10), (15, 4), (77, 7)]
)
def test_a_request_for_a_file_is_refused_with_a_reason(opcode: int, error: int) -> None:
    [reply] = answers(ftp(opcode, b"/fs/microsd/log"))
    sequence, session, kind, size, asked, *_ = HEADER.unpack_from(bytes(reply.payload))
    assert (sequence, session, kind, size, asked) == (8, 0, NAK, 1, opcode)
    assert reply.payload[HEADER.size] == error
    assert (reply.target_system, reply.target_component) == (245, 190)


@pytest.mark.parametrize("opcode", [0, 1, 2])
def test_sessions_are_ended_without_having_begun(opcode: int) -> None:
    [reply] = answers(ftp(opcode, sequence=0xFFFF))
    sequence, _, kind, size, asked, *_ = HEADER.unpack_from(bytes(reply.payload))
    assert (sequence, kind, size, asked) == (0, ACK, 0, opcode)


@pytest.mark.parametrize("opcode", [ACK, NAK])
def test_an_answer_is_not_answered(opcode: int) -> None:
    assert answers(ftp(opcode)) == []
