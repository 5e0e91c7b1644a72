"""Logs and files of a vehicle without any, and its parameters: every request of a client has an answer."""

import struct
import zlib
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.autopilot.flight.autopilot import PROFILES
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight
from tests.unit.sitl.autopilot.missions.mission_desk import Station

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
def test_sessions_are_ended_without_having_begun_and_an_answer_is_not_answered(opcode: int) -> None:
    [reply] = answers(ftp(opcode, sequence=0xFFFF), ftp(ACK), ftp(NAK))
    sequence, _, kind, size, asked, *_ = HEADER.unpack_from(bytes(reply.payload))
    assert (sequence, kind, size, asked) == (0, ACK, 0, opcode)


# ----------------
# The parameter protocol and tables of both autopilots: paced lists, types, bounds, hash, reboots.

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9


def read(station: Station, name: bytes, index: int = -1) -> list[Any]:
    return station.send(mavlink.MAVLink_param_request_read_message(1, 1, name, index))


def store(station: Station, name: bytes, value: float, kind: int) -> list[Any]:
    return station.send(mavlink.MAVLink_param_set_message(1, 1, name, value, kind))


def as_float(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def test_a_list_is_complete_in_order_and_paced(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind, 0.1)
    station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    bursts = [[m for m in station.run(0.05) if m.get_type() == "PARAM_VALUE"] for _ in range(60)]
    assert max(len(burst) for burst in bursts) <= 21
    values = [m for m in station.heard if m.get_type() == "PARAM_VALUE" and m.param_id != "_HASH_CHECK"]
    table = station.flight.autopilot.parameters
    assert [m.param_id for m in values] == list(table)
    assert [m.param_index for m in values] == list(range(len(table)))
    assert {m.param_count for m in values} == {len(table)}


def test_no_parameter_is_there_twice_and_px4s_are_in_alphabetical_order() -> None:
    for autopilot_kind in PROFILES.values():
        names = [parameter.name for parameter in autopilot_kind.parameters]
        assert len(names) > 21  # more than one burst
        assert len(set(names)) == len(names)
    names = [parameter.name for parameter in PROFILES["px4"].parameters]
    assert names == sorted(names)


@pytest.mark.parametrize(
    ("autopilot_kind", "name", "kind"),
    [
        ("px4", b"SYS_AUTOSTART", INT32),
        ("px4", b"NAV_ACC_RAD", REAL32),
        ("ardupilot", b"FRAME_CLASS", INT8),
        ("ardupilot", b"LAND_SPEED", INT16),
        ("ardupilot", b"RTL_ALT", INT32),
        ("ardupilot", b"WPNAV_SPEED", REAL32),
    ],
)
def test_types_are_reported(autopilot_kind: AutopilotKind, name: bytes, kind: int) -> None:
    assert read(Station(autopilot_kind, 0.1), name)[0].param_type == kind


def test_integers_are_set_bytewise_and_a_wrong_type_is_not_taken_by_px4() -> None:
    station = Station("px4", 0.1)
    answer = store(station, b"COM_RCL_EXCEPT", as_float(4), INT32)[0]
    assert struct.unpack("<i", struct.pack("<f", answer.param_value))[0] == 4
    assert not store(station, b"COM_RCL_EXCEPT", 2.0, REAL32)
    station.run(0.1)
    assert any("types mismatch" in text for text in station.texts)
    assert station.flight.autopilot.parameters["COM_RCL_EXCEPT"] == 4.0


def test_ardupilot_casts_integers_and_names_no_index_in_answers_by_name() -> None:
    station = Station("ardupilot", 0.1)
    answer = store(station, b"LAND_SPEED", 60.4, REAL32)[0]
    assert (answer.param_value, answer.param_index) == (60.0, 0xFFFF)
    assert read(station, b"", 3)[0].param_index == 3
    assert not read(station, b"NONE")


WRITABLE = {"px4": "NAV_ACC_RAD", "ardupilot": "WPNAV_RADIUS"}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e30, -1e30])
def test_values_out_of_bounds_are_answered_by_the_one_that_stands(
    autopilot_kind: AutopilotKind, value: float
) -> None:
    station, name = Station(autopilot_kind, 0.1), WRITABLE[autopilot_kind]
    before = station.flight.autopilot.parameters[name]
    assert store(station, name.encode(), value, REAL32)[0].param_value == before


def test_px4s_hash_changes_with_a_value_and_ends_a_list() -> None:
    station = Station("px4", 0.1)

    def crc() -> int:
        message = read(station, b"_HASH_CHECK")[0]
        assert message.param_type == mavlink.MAV_PARAM_TYPE_UINT32
        return int(struct.unpack("<I", struct.pack("<f", message.param_value))[0])

    table, expected = station.flight.autopilot.parameters, 0xFFFFFFFF
    for name in table:
        kind, value = ("<i", int(table[name])) if table.is_integer(name) else ("<f", table[name])
        expected = zlib.crc32(name.encode() + struct.pack(kind, value), expected)
    first = crc()
    assert first == expected ^ 0xFFFFFFFF
    store(station, b"NAV_ACC_RAD", 3.0, REAL32)
    assert crc() != first
    assert station.send(mavlink.MAVLink_param_request_list_message(1, 1))[0].param_id == "_HASH_CHECK"
    store(station, b"_HASH_CHECK", 0.0, mavlink.MAV_PARAM_TYPE_UINT32)
    assert not [m for m in station.run(0.5) if m.get_type() == "PARAM_VALUE"]


def test_values_outlive_a_reboot_which_is_one_until_storage_is_reset(station: Station) -> None:
    autopilot, name = station.flight.autopilot, WRITABLE[station.autopilot_kind]
    before = autopilot.parameters[name]
    store(station, name.encode(), 7.5, REAL32)
    autopilot.set_mode_named(autopilot.profile.hold_mode)
    assert station.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == 0
    station.run(0.5)
    assert not autopilot.aligned
    assert autopilot.mode == autopilot.profile.boot_mode
    assert autopilot.parameters[name] == 7.5
    for action, value in ((1, 7.5), (2, before)):  # 2: all as at first
        assert station.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, action) == 0
        assert autopilot.parameters[name] == value
    assert autopilot.arm() != 0
    station.run(6.0)
    assert autopilot.arm() == 0
    assert station.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) != 0
    assert autopilot.armed
