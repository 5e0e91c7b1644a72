"""The client that watches somebody else's vehicle, without a socket: what it asks, hears and says."""

import math
from collections import Counter
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.geometry import ned_from_geodetic
from companion.link.codec import Codec
from sitl.external.client import COMPONENT, ESTIMATES, VehicleClient
from tests.unit.sitl.external.external_vehicle import (
    ARDUPILOT,
    GROUND,
    PX4,
    MessageSender,
    heartbeat,
    hil_state,
    sim_state,
)

SET_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
SIM, HIL = mavlink.MAVLINK_MSG_ID_SIM_STATE, mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION


class ClientBench:
    """A client and the vehicle's side of its link, on a clock of our own."""

    def __init__(self, autopilot: int) -> None:
        self.texts: list[str] = []
        self.client = VehicleClient(self.texts.append)
        self.vehicle = MessageSender()
        self.autopilot = autopilot
        self.armed = False
        self.now_s = 100.0
        self.sent: list[Any] = []
        self._listener = Codec(0)

    def hear(self, *messages: Any, sender: MessageSender | None = None) -> None:
        self.client.receive((sender or self.vehicle).pack(*messages), self.now_s)

    def run(self, seconds: float, *every_20_ms: Any, beats: bool = True) -> None:
        """Let time pass; the vehicle says these at 50 Hz, and its heartbeat at 1 Hz."""
        for k in range(round(seconds / 0.02)):
            if beats and k % 50 == 0:
                self.hear(heartbeat(self.autopilot, armed=self.armed))
            if every_20_ms:
                self.hear(*every_20_ms)
            self.sent += self._listener.decode(self.client.transmit(self.now_s))
            self.now_s += 0.02

    def asked(self) -> Counter[int]:
        commands = [m for m in self.sent if m.get_type() == "COMMAND_LONG" and m.command == SET_INTERVAL]
        return Counter(round(m.param1) for m in commands)


@pytest.fixture
def px4() -> ClientBench:
    return ClientBench(PX4)


@pytest.fixture
def ardupilot() -> ClientBench:
    return ClientBench(ARDUPILOT)


def attitude(*q: float, time_ms: int = 0, roll_rate: float = 0.0, yaw_rate: float = 0.0) -> Any:
    q = q or (1.0, 0.0, 0.0, 0.0)
    return mavlink.MAVLink_attitude_quaternion_message(time_ms, *q, roll_rate, 0.0, yaw_rate)


def place(latitude: int = 470_000_000, longitude: int = 80_000_000, altitude: int = 400_000) -> Any:
    return mavlink.MAVLink_global_position_int_message(0, latitude, longitude, altitude, 0, 0, 0, 0, 0)


def local(x: float = 3.0, y: float = 4.0, z: float = -5.0, vx: float = 1.0) -> Any:
    return mavlink.MAVLink_local_position_ned_message(0, x, y, z, vx, 0.0, 0.0)


STANDS = sim_state((0.0, 0.0, 0.0))


@pytest.mark.parametrize(("autopilot", "wanted"), [(ARDUPILOT, SIM), (PX4, HIL)])
def test_it_asks_for_the_truth_that_this_simulator_has(autopilot: int, wanted: int) -> None:
    bench = ClientBench(autopilot)
    bench.run(3.0)
    assert set(bench.asked()) == {wanted, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION}
    (first, *_) = [m for m in bench.sent if m.get_type() == "COMMAND_LONG" and m.param1 == wanted]
    assert (first.target_system, first.target_component, first.param2) == (1, 1, 1e4)


def test_it_is_a_component_of_its_own_that_no_autopilot_waits_for(px4: ClientBench) -> None:
    px4.run(5.0)
    beats = [m for m in px4.sent if m.get_type() == "HEARTBEAT"]
    assert 4 <= len(beats) <= 6
    nobody = (mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID)
    assert {(m.type, m.autopilot) for m in beats} == {nobody}
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in px4.sent} == {(1, COMPONENT)}


def test_a_rate_that_comes_is_not_asked_for_again_and_one_that_is_lost_is(ardupilot: ClientBench) -> None:
    ardupilot.run(10.0, STANDS, STANDS)
    assert ardupilot.asked()[SIM] == 1
    ardupilot.run(10.0)
    assert ardupilot.asked()[SIM] >= 4


def test_poses_come_out_and_others_are_not_heard(ardupilot: ClientBench) -> None:
    ardupilot.hear(sim_state((9.0, 9.0, -9.0)))  # before anybody said who it is
    ardupilot.run(0.02, sim_state((1.0, 2.0, -3.0)))
    ardupilot.hear(sim_state((50.0, 0.0, 0.0)), sender=MessageSender(system=7))
    ardupilot.hear(sim_state((50.0, 0.0, 0.0)), sender=MessageSender(component=30))
    ardupilot.hear(heartbeat(PX4, armed=True), sender=MessageSender(system=7))
    (sample,) = ardupilot.client.take_samples()
    assert ned_from_geodetic(*sample.place, GROUND) == pytest.approx((1.0, 2.0, -3.0), abs=0.012)
    assert sample.time_s == 100.0
    assert not ardupilot.client.armed
    assert ardupilot.client.source == "SIM_STATE"


def test_a_stamp_is_turned_into_our_time_by_timesync_and_no_stamp_means_now(px4: ClientBench) -> None:
    px4.run(0.5)
    question = [m for m in px4.sent if m.get_type() == "TIMESYNC"][-1]
    # the vehicle's clock shows 40 s when ours shows 100 s and a little
    px4.now_s = question.ts1 / 1e9 + 0.004
    px4.hear(mavlink.MAVLink_timesync_message(40_000_000_000, question.ts1))
    middle_s = question.ts1 / 1e9 + 0.002
    px4.client.take_samples()
    px4.now_s = middle_s + 1.010
    px4.hear(hil_state((0.0, 0.0, 0.0), time_usec=41_000_000))
    px4.hear(hil_state((0.0, 0.0, 0.0)))
    px4.hear(hil_state((0.0, 0.0, 0.0), time_usec=77_000_000))  # of another clock
    stamped, unstamped, wrong = (s.time_s for s in px4.client.take_samples())
    assert stamped == pytest.approx(middle_s + 1.0, abs=1e-6)
    assert unstamped == wrong == px4.now_s


def test_a_pose_has_the_time_of_the_vehicle_s_own_clock(px4: ClientBench) -> None:
    px4.run(0.02)
    px4.hear(attitude(time_ms=7000), hil_state((0.0, 0.0, 0.0)))
    px4.now_s += 0.05  # in which it has stood still for 40 ms
    px4.hear(attitude(time_ms=7010), hil_state((0.0, 0.0, 0.0)))
    first, second = px4.client.take_samples()
    assert second.simulated_s - first.simulated_s == pytest.approx(0.01)
    assert second.time_s - first.time_s == pytest.approx(0.05)


ESTIMATE = (attitude(), place(), local())


def test_without_the_truth_it_warns_once_and_takes_the_estimates(px4: ClientBench) -> None:
    px4.run(12.0, *ESTIMATE)
    (text,) = px4.texts
    assert text.startswith("WARNING: no HIL_STATE_QUATERNION within 5 s, so no truth")
    sample = px4.client.take_samples()[-1]
    assert px4.client.source == ESTIMATES
    assert sample.place == pytest.approx(GROUND, abs=1e-6)
    assert sample.velocity_ned_m_s == (1.0, 0.0, 0.0)
    px4.hear(local(4.0))
    moved = ned_from_geodetic(*px4.client.take_samples()[-1].place, GROUND)
    assert moved == pytest.approx((1.0, 0.0, 0.0), abs=1e-4)


TRUE_PLACE = (0.3, -0.4, 1.2)  # from where the estimates have it


def test_a_truth_that_comes_late_takes_their_place_on_the_ground_and_not_in_the_air(
    ardupilot: ClientBench,
) -> None:
    ardupilot.run(7.0, *ESTIMATE)
    ardupilot.client.take_samples()
    ardupilot.armed = True
    ardupilot.run(1.0, sim_state(TRUE_PLACE))
    assert ardupilot.client.take_samples() == []
    ardupilot.armed = False
    # what the estimates said in the same breath is not taken for truth
    ardupilot.hear(heartbeat(ARDUPILOT), *ESTIMATE, sim_state(TRUE_PLACE))
    (sample,) = ardupilot.client.take_samples()
    assert ned_from_geodetic(*sample.place, GROUND) == pytest.approx(TRUE_PLACE, abs=0.012)
    assert ardupilot.client.source == "SIM_STATE"
    assert ardupilot.texts[1:] == [
        "SIM_STATE comes after all, but the vehicle is armed: keeping to the estimates",
        "SIM_STATE comes after all: the pose is the simulator's truth",
    ]


def test_after_a_flight_on_estimates_its_score_is_kept_to(ardupilot: ClientBench) -> None:
    ardupilot.run(7.0, *ESTIMATE)
    ardupilot.client.take_samples()
    ardupilot.client.flown = True
    ardupilot.run(0.8, sim_state(TRUE_PLACE))
    assert ardupilot.client.source == ESTIMATES
    assert ardupilot.texts[1:] == [
        "SIM_STATE comes after all, but the vehicle has flown: keeping to the estimates"
    ]


WILD = [math.nan, math.inf, 3.4e38]


@pytest.mark.parametrize(
    "wrong",
    [
        (attitude(*[math.nan] * 4), place(), local()),
        (attitude(0.0, 0.0, 0.0, 0.0), place(), local()),
        *((attitude(roll_rate=wild), place(), local()) for wild in WILD),
        *((attitude(yaw_rate=wild), place(), local()) for wild in WILD),
        *((attitude(), place(), local(x=wild)) for wild in WILD),
        *((attitude(), place(), local(z=wild)) for wild in WILD),
        *((attitude(), place(), local(vx=wild)) for wild in WILD),
        (attitude(), place(0, 0, 0), local()),
        (attitude(), place(910_000_000, 0, 0), local()),
    ],
)
def test_estimates_that_hold_no_pose_are_not_taken_and_spoil_none_that_follows(
    px4: ClientBench, wrong: tuple[Any, ...]
) -> None:
    px4.run(6.0, *wrong)  # no truth comes
    assert px4.client.take_samples() == []
    px4.run(0.1, *ESTIMATE)
    assert px4.client.take_samples()[-1].place == pytest.approx(GROUND, abs=1e-6)
    px4.hear(*wrong[2:])
    px4.hear(*ESTIMATE)
    assert px4.client.take_samples()[-1].place == pytest.approx(GROUND, abs=1e-6)


def test_an_attitude_that_is_nearly_of_unit_length_is_made_so(px4: ClientBench) -> None:
    px4.run(6.0, attitude(1.02, 0.0, 0.0, 0.0), place(), local())
    assert px4.client.take_samples()[-1].attitude == pytest.approx((1.0, 0.0, 0.0, 0.0))


def test_a_vehicle_that_falls_silent_is_reported_once_and_so_is_its_return(ardupilot: ClientBench) -> None:
    ardupilot.run(3.0, STANDS, STANDS)
    assert ardupilot.texts == []
    ardupilot.run(20.0, beats=False)
    ardupilot.run(3.0, STANDS, STANDS)
    assert ardupilot.texts == [
        "no SIM_STATE for 1 s; the camera waits for it",
        "vehicle 1: no heartbeat for 5 s; waiting for it",
        "vehicle 1: received again",
    ]


def test_a_truth_that_comes_too_seldom_is_reported(ardupilot: ClientBench) -> None:
    for _ in range(120):
        ardupilot.run(0.1, beats=False)
        ardupilot.hear(heartbeat(ARDUPILOT), STANDS)
    assert ardupilot.texts == ["SIM_STATE comes at 10 Hz only; expected 40 Hz or more"]


def test_noise_on_the_line_costs_nothing(ardupilot: ClientBench) -> None:
    ardupilot.run(0.1)
    ardupilot.client.receive(b"\xfd\x00garbage\xfe" * 50, ardupilot.now_s)
    for _ in range(10):
        ardupilot.hear(STANDS)
    # the last of the noise claims a frame, which is not one once its end has come
    assert len(ardupilot.client.take_samples()) == 10


def test_home_is_asked_for_until_it_comes(px4: ClientBench) -> None:
    def requests() -> int:
        px4.sent.clear()
        px4.run(5.0)
        home = mavlink.MAVLINK_MSG_ID_HOME_POSITION
        return len([m for m in px4.sent if m.get_type() == "COMMAND_LONG" and m.param1 == home])

    def home(latitude: int, longitude: int, altitude: int) -> Any:
        rest = (0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
        return mavlink.MAVLink_home_position_message(latitude, longitude, altitude, *rest)

    assert requests() >= 2
    px4.hear(home(0, 0, 0))
    assert px4.client.home is None
    px4.hear(home(470_000_000, 80_000_000, 400_000))
    assert px4.client.home == pytest.approx(GROUND)
    assert requests() == 0
