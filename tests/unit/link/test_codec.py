"""The codec: framing that survives garbage, and the messages we build, there and back."""

import math

import numpy as np
import pytest

from companion.base.geometry import quat_from_euler
from companion.base.messages import PadBeacon, Setpoint
from companion.link import codec
from companion.link.beacon import pad_beacon
from companion.link.codec import Codec, mavlink
from tests.unit.link.ground_beacon import follow_target


def attitudes(sender: Codec, count: int) -> list[bytes]:
    return [
        sender.encode(mavlink.MAVLink_attitude_message(i, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)) for i in range(count)
    ]


def test_a_message_comes_through_with_its_source() -> None:
    [message] = Codec(1).decode(Codec(7, 42).encode(codec.heartbeat()))
    assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 42)
    assert message.get_type() == "HEARTBEAT"


def test_our_heartbeat_is_that_of_an_onboard_computer_without_autopilot() -> None:
    [message] = Codec(1).decode(Codec(1).encode(codec.heartbeat()))
    assert message.get_srcComponent() == 191
    assert message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    assert message.autopilot == mavlink.MAV_AUTOPILOT_INVALID


@pytest.mark.parametrize("chunk", [1, 2, 7, 11, 64, 4096])
def test_messages_come_through_however_the_bytes_are_cut(chunk: int) -> None:
    stream = b"".join(attitudes(Codec(1, 1), 20))
    receiver = Codec(1)
    stamps = [
        m.time_boot_ms for i in range(0, len(stream), chunk) for m in receiver.decode(stream[i : i + chunk])
    ]
    assert stamps == list(range(20))
    assert receiver.counters.skipped_bytes == 0


@pytest.mark.parametrize("seed", range(5))
def test_garbage_between_messages_costs_none_of_them(seed: int) -> None:
    generator = np.random.default_rng(seed)
    stream = b"".join(
        generator.bytes(int(generator.integers(0, 40))) + b"\xfd" + frame
        for frame in attitudes(Codec(1, 1), 50)
    )
    # what a false start byte claims may reach past the end: let it
    receiver = Codec(1)
    found = [m.time_boot_ms for m in receiver.decode(stream + bytes(300)) if m.get_type() == "ATTITUDE"]
    assert found == list(range(50))
    assert receiver.counters.skipped_bytes > 50


def test_a_message_whose_check_sum_is_wrong_is_skipped_and_the_next_one_is_not() -> None:
    first, second = attitudes(Codec(1, 1), 2)
    broken = bytearray(first)
    broken[15] ^= 0x10
    receiver = Codec(1)
    assert [m.time_boot_ms for m in receiver.decode(bytes(broken) + second)] == [1]
    assert receiver.counters.skipped_bytes == len(first)


def test_unwanted_messages_are_passed_over_but_checked() -> None:
    sender, receiver = Codec(1, 1), Codec(1, wanted=[mavlink.MAVLINK_MSG_ID_HEARTBEAT])
    attitude = attitudes(sender, 1)[0]
    broken = bytearray(attitudes(sender, 1)[0])
    broken[12] ^= 1
    heartbeat = sender.encode(codec.heartbeat())
    assert [m.get_type() for m in receiver.decode(attitude + bytes(broken) + heartbeat)] == ["HEARTBEAT"]
    assert receiver.counters.passed_over == 1
    assert receiver.counters.skipped_bytes == len(broken)


def test_mavlink_1_and_signed_frames_are_read_too() -> None:
    sender = mavlink.MAVLink(None, 1, 1)
    v1 = codec.heartbeat().pack(sender, force_mavlink1=True)
    sender.signing.secret_key = bytes(32)
    sender.signing.sign_outgoing = True
    signed = codec.heartbeat().pack(sender)
    assert len(signed) > len(v1) + 13
    assert len(Codec(1).decode(v1 + signed + v1)) == 3


@pytest.mark.parametrize("mavlink_1", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_every_message_of_the_dialect_is_what_pymavlink_makes_of_it(seed: int, mavlink_1: bool) -> None:
    generator, theirs = np.random.default_rng(seed), mavlink.MAVLink(None)
    for number, kind in mavlink.mavlink_map.items():
        if mavlink_1 and number > 255:
            continue
        payload = generator.bytes(kind.unpacker.size if seed else 1)  # zeros at the end are not sent
        size, sequence = len(payload), number % 256
        if mavlink_1:
            header = bytes([0xFE, size, sequence, 3, 4, number])
        else:
            header = bytes([0xFD, size, 0, 0, sequence, 3, 4]) + number.to_bytes(3, "little")
        crc = mavlink.x25crc(header[1:] + payload + bytes([kind.crc_extra])).crc
        frame = header + payload + crc.to_bytes(2, "little")
        [message], expected = Codec(1).decode(frame), theirs.decode(bytearray(frame))
        assert type(message) is type(expected)
        assert repr(message.to_dict()) == repr(expected.to_dict())  # NaN is like NaN
        assert vars(message.get_header()) == vars(expected.get_header())
        assert message.get_msgbuf() == expected.get_msgbuf()


def test_lost_messages_are_counted_per_source() -> None:
    frames, others = attitudes(Codec(1, 1), 300), attitudes(Codec(2, 1), 3)
    receiver = Codec(1)
    receiver.decode(b"".join(frames[:250]) + others[0] + b"".join(frames[253:]) + others[2])
    assert receiver.counters.lost == 4


def test_a_velocity_setpoint_says_velocity_acceleration_yaw_and_nothing_of_position() -> None:
    setpoint = Setpoint(1.0, (1.0, -2.0, 0.5), (0.1, 0.2, -0.3), heading_rad=0.7, heading_rate_rad_s=0.05)
    [message] = Codec(1).decode(Codec(1).encode(codec.setpoint_message(setpoint, 2.5, 9)))
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.target_system, message.target_component) == (9, 1)
    assert message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
    assert message.type_mask == 0b0111
    assert message.time_boot_ms == 2500
    assert (message.vx, message.vy, message.vz) == pytest.approx((1.0, -2.0, 0.5))
    assert (message.afx, message.afy, message.afz) == pytest.approx((0.1, 0.2, -0.3))
    assert (message.yaw, message.yaw_rate) == pytest.approx((0.7, 0.05))


def test_without_a_velocity_to_hold_the_vertical_one_alone_is_sent_for() -> None:
    setpoint = Setpoint(1.0, (1.0, -2.0, 0.5), (0.1, 0.2, -0.3), holds_horizontal_velocity=False)
    message = codec.setpoint_message(setpoint, 2.5, 9)
    ignored = (
        mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
        | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
        | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
        | mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
        | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    )
    assert message.type_mask == ignored
    assert (message.vz, message.afx, message.afy, message.afz) == pytest.approx((0.5, 0.1, 0.2, -0.3))


def test_an_attitude_setpoint_says_attitude_and_thrust() -> None:
    attitude = quat_from_euler(0.1, -0.2, 1.0)
    setpoint = Setpoint(1.0, attitude=attitude, thrust=0.55)
    [message] = Codec(1).decode(Codec(1).encode(codec.setpoint_message(setpoint, 2.5, 9)))
    assert message.get_type() == "SET_ATTITUDE_TARGET"
    assert message.q == pytest.approx(attitude)
    assert message.thrust == pytest.approx(0.55)
    assert message.type_mask == 0b0111


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 100, 130])
def test_a_text_is_chunked_to_50_bytes_and_ends_with_one_that_is_not_full(length: int) -> None:
    text = "".join(chr(97 + i % 26) for i in range(length))
    sender = Codec(1)
    data = b"".join(sender.encode(m) for m in codec.status_texts(text, "warning", 7))
    messages = Codec(1).decode(data)
    assert "".join(m.text for m in messages) == text
    assert [m.chunk_seq for m in messages] == list(range(len(messages)))
    assert {m.severity for m in messages} == {mavlink.MAV_SEVERITY_WARNING}
    assert {m.id for m in messages} == ({7} if length > 50 else {0})
    assert length <= 50 or len(messages[-1].text) < 50


def test_missing_parameters_of_a_command_are_no_value() -> None:
    message = codec.command_long(mavlink.MAV_CMD_NAV_LAND, (1.0,), 3)
    [back] = Codec(1).decode(Codec(1).encode(message))
    assert back.param1 == 1.0
    assert all(math.isnan(value) for value in (back.param2, back.param4, back.param7))


def test_a_command_with_a_position_keeps_its_centimetres() -> None:
    position = (47.123456712, -8.765432198, 412.34)
    message = codec.command_int(mavlink.MAV_CMD_DO_REPOSITION, (-1.0, 1.0), position, 3)
    [back] = Codec(1).decode(Codec(1).encode(message))
    assert (back.x * 1e-7, back.y * 1e-7) == pytest.approx(position[:2], abs=1e-7)
    assert back.z == pytest.approx(412.34, abs=1e-4)
    assert math.isnan(back.param4)


def test_a_beacon_comes_through_in_metres() -> None:
    beacon = PadBeacon(5.0, 47.0001234, 8.0005678, 401.5, (1.0, -0.5, 0.1), 1.5)
    [message] = Codec(1).decode(Codec(255, 190).encode(follow_target(beacon)))
    back = pad_beacon(message, 9.0, 8.0)
    assert back is not None
    assert back.time_s == 9.0
    assert (back.latitude_deg, back.longitude_deg) == pytest.approx((47.0001234, 8.0005678), abs=1e-7)
    assert (back.altitude_m, back.position_std_m) == pytest.approx((401.5, 1.5))
    assert back.velocity_ned_m_s == pytest.approx((1.0, -0.5, 0.1))


def beacon_message(
    capabilities: int,
    latitude_e7: int,
    altitude_m: float,
    std_m: float,
    *,
    north_m_s: float = 3.0,
    longitude_e7: int = 80000000,
) -> codec.Message:
    return mavlink.MAVLink_follow_target_message(
        0, capabilities, latitude_e7, longitude_e7, altitude_m, [north_m_s, 0.0, 0.0], [0.0] * 3,
        [1.0, 0.0, 0.0, 0.0], [0.0] * 3, [std_m] * 3, 0,
    )  # fmt: skip


def test_a_beacon_without_velocity_stands_still_and_without_accuracy_is_poor() -> None:
    beacon = pad_beacon(beacon_message(0b01, 470000000, 400.0, 0.0), 1.0, 8.0)
    assert beacon is not None
    assert beacon.velocity_ned_m_s == (0.0, 0.0, 0.0)
    assert beacon.position_std_m == 5.0


@pytest.mark.parametrize(
    "message",
    [
        beacon_message(0b10, 470000000, 400.0, 1.0),
        beacon_message(0b11, 470000000, math.nan, 1.0),
        beacon_message(0b11, 470000000, 400.0, math.inf),
        beacon_message(0b11, 470000000, 400.0, 1.0, north_m_s=math.nan),
        beacon_message(0b11, 470000000, 400.0, 1.0, north_m_s=-8.1),
        beacon_message(0b11, 910000000, 400.0, 1.0),
        beacon_message(0b11, 0, 0.0, 1.0, longitude_e7=0),
    ],
    ids=["no position", "no altitude", "no accuracy", "no velocity", "too fast", "not on Earth", "no fix"],
)
def test_a_beacon_that_says_nothing_useful_is_none(message: codec.Message) -> None:
    assert pad_beacon(message, 1.0, 8.0) is None


def test_bytes_hold_only_what_is_named_when_they_are_whole_frames_of_it() -> None:
    streams, sender = frozenset({mavlink.MAVLINK_MSG_ID_ATTITUDE}), Codec(1, 1)
    one, two = attitudes(sender, 2)
    assert codec.holds_only(one, streams)
    assert codec.holds_only(one + two, streams)
    assert not codec.holds_only(one + sender.encode(codec.heartbeat()), streams)
    assert not codec.holds_only(one + two[:-1], streams)
    assert not codec.holds_only(two[3:], streams)
    assert not codec.holds_only(b"\0" + one, streams)
