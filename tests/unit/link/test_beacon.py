"""Whose FOLLOW_TARGET is the pad's: an answer to our request, or of the component that the settings name."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from companion.base.messages import PadBeacon
from companion.config import LinkConfig
from companion.link.beacon import ANSWER_S
from companion.link.codec import Codec, mavlink
from companion.link.commands import request_message
from companion.link.session import Session
from tests.unit.link.ground_beacon import follow_target

BEACON = PadBeacon(0.0, 47.0, 8.0, 401.0, (1.0, 0.0, 0.0), 1.0)
ACCEPTED, UNSUPPORTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_UNSUPPORTED
GROUND = (255, 190)
PAD_SYSTEM = 42


def asked(now_s: float = 3.0, **settings: Any) -> Session:
    """A session whose request for the pad's position has just left."""
    session = Session(LinkConfig(**settings))
    session.command(request_message(mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET, GROUND[0], target_component=0))
    session.tick(now_s)
    return session


def answer(
    session: Session, now_s: float, sender: tuple[int, int] = GROUND, result: int = ACCEPTED, us: int = 191
) -> None:
    number = mavlink.MAV_CMD_REQUEST_MESSAGE
    ack = mavlink.MAVLink_command_ack_message(number, result, 0, 0, 1, us)
    session.receive(Codec(*sender).encode(ack), now_s)


def send(session: Session, now_s: float, sender: tuple[int, int] = GROUND, north_m_s: float = 1.0) -> None:
    beacon = replace(BEACON, velocity_ned_m_s=(north_m_s, 0.0, 0.0))
    session.receive(Codec(*sender).encode(follow_target(beacon)), now_s)


def heard(session: Session) -> PadBeacon:
    assert session.beacons.beacon is not None
    return session.beacons.beacon


def test_the_answer_to_our_request_is_the_pads() -> None:
    session = asked()
    answer(session, 3.1)
    send(session, 3.6)
    assert (heard(session).time_s, heard(session).altitude_m) == (3.6, 401.0)


@pytest.mark.parametrize(
    ("session", "answered", "sent_s", "sender"),
    [
        *(
            pytest.param(asked, {"result": result}, 3.2, GROUND, id=f"it refuses to answer: {result}")
            for result in (UNSUPPORTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_IN_PROGRESS)
        ),
        pytest.param(lambda: Session(LinkConfig()), {}, 3.2, GROUND, id="nobody asked"),
        pytest.param(asked, {"us": 42}, 3.2, GROUND, id="it answers another"),
        *(
            pytest.param(asked, {}, 3.2, sender, id=f"{sender} has not accepted")
            for sender in ((254, 190), (1, 1), (1, 191), (255, 1), (255, 191))
        ),
        pytest.param(asked, {}, 3.1 + ANSWER_S + 0.1, GROUND, id="long after the acceptance"),
        pytest.param(lambda: asked(beacon_system_id=PAD_SYSTEM), {}, 3.2, GROUND, id="a system is named"),
    ],
)
def test_what_is_no_answer_to_our_request_is_not(
    session: Callable[[], Session], answered: dict[str, Any], sent_s: float, sender: tuple[int, int]
) -> None:
    listening = session()
    send(listening, 3.05, sender)
    answer(listening, 3.1, **answered)
    send(listening, sent_s, sender)
    assert (listening.beacons.beacon, listening.beacons.ignored) == (None, sender)


def test_what_a_ground_station_streams_unasked_is_not() -> None:
    session = Session(LinkConfig())
    for second in range(20):
        send(session, float(second))
    assert session.beacons.beacon is None
    assert session.beacons.ignored == GROUND


def test_the_component_that_is_named_needs_no_asking_and_no_other_counts() -> None:
    session = asked(beacon_component_id=25)
    answer(session, 3.0)
    send(session, 3.1)
    assert session.beacons.beacon is None
    send(session, 3.2, (254, 25))
    assert session.beacons.beacon is None
    send(session, 3.3, (255, 25))
    assert session.beacons.beacon is not None


@pytest.mark.parametrize("ground_system_id", [255, 77])
def test_a_beacon_faster_than_any_pad_leaves_the_last_good_one(ground_system_id: int) -> None:
    session = Session(
        LinkConfig(ground_system_id=ground_system_id, beacon_component_id=190, maximum_pad_speed_m_s=3.0)
    )
    for time_s, north_m_s in ((1.0, 2.9), (2.0, 3.1), (3.0, 1000.0)):
        send(session, time_s, (ground_system_id, 190), north_m_s)
    assert heard(session).time_s == 1.0


# ---------------- A system on the pad


def system_position(north_cm_s: int = 100, latitude_e7: int = 470_000_000, boot_ms: int = 5000) -> Any:
    return mavlink.MAVLink_global_position_int_message(
        boot_ms, latitude_e7, 80_000_000, 401_000, 1000, north_cm_s, 0, 0, 65535
    )


def system_accuracy(across_mm: int, up_mm: int) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(
        0, 6, 470_000_000, 80_000_000, 401_000, 65535, 65535, 65535, 65535, 20, 0, across_mm, up_mm, 0, 0, 0
    )


def test_the_position_of_the_named_system_is_the_pads_as_accurate_as_it_says() -> None:
    session, codec = Session(LinkConfig(beacon_system_id=PAD_SYSTEM)), Codec(PAD_SYSTEM, 1)
    session.receive(codec.encode(system_position()), 1.0)
    assert heard(session).position_std_m == 5.0  # it has told none
    session.receive(codec.encode(system_accuracy(20, 30)) + codec.encode(system_position(boot_ms=6000)), 2.0)
    expected = replace(BEACON, time_s=2.0, position_std_m=0.02, vertical_std_m=0.03, fix_time_s=6.0)
    assert replace(heard(session), velocity_std_m_s=None) == expected


def test_a_pads_receiver_without_a_fix_leads_nobody() -> None:
    session, codec = Session(LinkConfig(beacon_system_id=PAD_SYSTEM)), Codec(PAD_SYSTEM, 1)
    lost = system_accuracy(20, 30)
    lost.fix_type = mavlink.GPS_FIX_TYPE_2D_FIX
    found: list[float | None] = []
    messages = (
        (1.0, codec.encode(lost) + codec.encode(system_position())),
        (2.0, codec.encode(system_accuracy(20, 30)) + codec.encode(system_position())),
        (6.0, codec.encode(system_position(boot_ms=9000))),
    )
    for now_s, data in messages:
        session.receive(data, now_s)
        beacon = session.beacons.beacon
        found.append(None if beacon is None else beacon.position_std_m)
    # an accuracy of long ago says nothing of now
    assert found == [None, 0.02, 5.0]


@pytest.mark.parametrize(
    ("system_id", "settings"), [(43, {"beacon_system_id": PAD_SYSTEM}), (PAD_SYSTEM, {}), (1, {})]
)
def test_the_position_of_any_other_system_is_not(system_id: int, settings: dict[str, Any]) -> None:
    session = Session(LinkConfig(**settings))
    session.receive(Codec(system_id, 1).encode(system_position()), 1.0)
    assert session.beacons.beacon is None


def test_the_pads_system_is_never_adopted_as_the_vehicle() -> None:
    session, codec = Session(LinkConfig(system_id=0, beacon_system_id=PAD_SYSTEM)), Codec(PAD_SYSTEM, 1)
    heartbeat = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
    session.receive(codec.encode(heartbeat) + codec.encode(system_position()), 1.0)
    assert session.system_id == 0
    assert not session.state.connected
    assert session.state.global_position is None


@pytest.mark.parametrize("wrong", [{"north_cm_s": 900}, {"latitude_e7": 910_000_000}])
def test_what_no_pad_can_be_leaves_the_last_good_position(wrong: dict[str, int]) -> None:
    session, codec = Session(LinkConfig(beacon_system_id=PAD_SYSTEM)), Codec(PAD_SYSTEM, 1)
    session.receive(codec.encode(system_position()), 1.0)
    session.receive(codec.encode(system_position(**wrong)), 2.0)
    assert heard(session).time_s == 1.0


def test_the_pads_system_is_not_the_vehicles() -> None:
    with pytest.raises(ValueError, match="beacon_system_id: expected another system than the vehicle's"):
        LinkConfig(system_id=7, beacon_system_id=7)
    with pytest.raises(
        ValueError, match="beacon_system_id: expected another system than the ground station's"
    ):
        LinkConfig(ground_system_id=250, beacon_system_id=250)


def test_what_an_answer_says_of_its_accuracy_is_kept() -> None:
    session = asked()
    answer(session, 3.1)
    session.receive(Codec(*GROUND).encode(follow_target(replace(BEACON, time_s=812.25))), 3.6)
    beacon = heard(session)
    assert beacon.velocity_std_m_s is not None
    assert (beacon.vertical_std_m, beacon.fix_time_s) == (1.0, 812.25)
