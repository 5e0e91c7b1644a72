"""Several clients of one vehicle: each has a link of its own, and what is for others gets to them."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from benchmarks.mavlink.fuzzing import Fuzz
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import ZERO3
from companion.link.codec import mavlink
from companion.link.signing import LinkSigning
from sitl.autopilot.flight.modes import CommandResult
from sitl.mavlink.framing import FrameReader, Signing
from sitl.mavlink.ground_station import Companion, Forger, GroundStation
from sitl.mavlink.network import Network
from sitl.scenario.scenario import BeaconSettings
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import resting_state
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight

UNIX_S = 1.8e9


class NetworkClient:
    """One end of the network, by its name."""

    def __init__(self, network: Network, system: int, component: int) -> None:
        self.us = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._network, self._data = network, bytearray()
        self.port = network.connect(self._take, datagrams=True)

    def _take(self, frames: Sequence[bytes]) -> None:
        for frame in frames:
            self._data += frame

    def send(self, message: Any, now_s: float = 6.0) -> None:
        self._network.receive(self.port, bytes(message.pack(self.us)), now_s)

    def heard(self, name: str = "") -> list[Any]:
        frames = FrameReader().read(bytes(self._data), 0.0)
        self._data.clear()
        messages = [self.us.decode(bytearray(frame.data)) for frame in frames]
        return [m for m in messages if name in ("", m.get_type())]


class NetworkedVehicle:
    """A vehicle with a network."""

    def __init__(self, autopilot_kind: AutopilotKind = "px4") -> None:
        self.flight = AutopilotFlight(autopilot_kind)
        self.sensors = SimulatedAutopilotSensors(
            np.random.default_rng(0), 0.01, home=HOME, field_ned_ut=(20.9, 0.6, 42.9), imu_filter=2
        )
        signing = Signing(autopilot_kind)
        self.ground = GroundStation(
            BeaconSettings(position_std_m=1.0), np.random.default_rng(0), HOME, signing=signing
        )
        self.network = Network(self.flight.autopilot, self.sensors, self.ground, signing, UNIX_S)
        self.flight.run(6.0)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.flight.run(0.01)
            self.network.transmit(self.flight.now_s, ZERO3, ZERO3)

    def client(self, system: int, component: int = 1) -> NetworkClient:
        return NetworkClient(self.network, system, component)


@pytest.fixture
def desk() -> NetworkedVehicle:
    return NetworkedVehicle()


@pytest.fixture
def one(desk: NetworkedVehicle) -> NetworkClient:
    return desk.client(255)


@pytest.fixture
def other(desk: NetworkedVehicle) -> NetworkClient:
    return desk.client(254)


def command(number: int, *values: float, target: tuple[int, int] = (1, 1)) -> Any:
    return mavlink.MAVLink_command_long_message(*target, number, 0, *values, *(0.0,) * (7 - len(values)))


def test_rates_and_sequence_numbers_are_each_client_s_own(
    desk: NetworkedVehicle, one: NetworkClient, other: NetworkClient
) -> None:
    one.send(command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 1e6))
    one.heard()
    other.heard()
    desk.run(2.0)
    for client, attitudes in ((one, 2), (other, 100)):
        heard = client.heard()
        assert Counter(m.get_type() for m in heard)["ATTITUDE"] == attitudes
        ours = [m.get_seq() for m in heard if m.get_srcSystem() == 1]
        assert all((b - a) % 256 == 1 for a, b in pairwise(ours))


def test_answers_go_to_the_sender_at_once_and_texts_to_all(one: NetworkClient, other: NetworkClient) -> None:
    one.send(command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0))
    assert [m.result for m in one.heard("COMMAND_ACK")] == [0]
    heard = other.heard()
    assert not [m for m in heard if m.get_type() == "COMMAND_ACK"]
    assert "Armed by external command" in [m.text for m in heard if m.get_type() == "STATUSTEXT"]


def test_a_text_that_time_brings_goes_to_all(
    desk: NetworkedVehicle, one: NetworkClient, other: NetworkClient
) -> None:
    desk.run(0.5)
    one.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0), desk.flight.now_s)
    desk.run(10.0)
    for client in (one, other):
        assert [m.text for m in client.heard("STATUSTEXT")][-1] == "Operation timeout"


def test_a_parameter_that_one_sets_is_reported_to_all(one: NetworkClient, other: NetworkClient) -> None:
    one.send(mavlink.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 7.0, 9))
    for client in (one, other):
        assert [m.param_value for m in client.heard("PARAM_VALUE")] == [7.0]


def test_what_is_for_another_goes_where_that_one_was_heard_and_nowhere_else(desk: NetworkedVehicle) -> None:
    ground, companion, third = desk.client(255), desk.client(1, 191), desk.client(30)
    for client in (ground, companion, third):
        client.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    assert {m.get_srcSystem() for m in ground.heard("HEARTBEAT")} == {1, 30}
    companion.heard()
    third.heard()
    ground.send(command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0, target=(1, 191)))
    assert [m.target_component for m in companion.heard("COMMAND_LONG")] == [191]
    assert not third.heard("COMMAND_LONG")
    assert not ground.heard("COMMAND_ACK"), "it was not for the autopilot"


def test_some_things_are_not_passed_on(
    desk: NetworkedVehicle, one: NetworkClient, other: NetworkClient
) -> None:
    for message in (
        mavlink.MAVLink_setup_signing_message(0, 0, bytes(32), 0),
        mavlink.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0),
        command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0),
    ):
        one.send(message)
        assert not other.heard(message.get_type())
    # nor the vehicle's own frames that come back
    desk.client(1).send(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))
    assert not other.heard()


def test_the_beacon_at_the_pad_is_heard_by_all_when_one_asks(
    desk: NetworkedVehicle, other: NetworkClient
) -> None:
    companion = desk.client(1, 191)
    companion.send(command(mavlink.MAV_CMD_REQUEST_MESSAGE, 144.0, target=(255, 0)))
    desk.run(1.0)
    for client in (companion, other):
        assert [m.get_srcSystem() for m in client.heard("FOLLOW_TARGET")] == [255]


# ---------------------------------------------------------------- messages that need the vehicle's context


def test_timesync_is_answered_with_the_time_of_arrival_and_pings_are(desk: NetworkedVehicle) -> None:
    client = desk.client(250, 3)
    client.send(mavlink.MAVLink_timesync_message(0, 9), now_s=6.00123)
    assert client.heard("TIMESYNC")[0].tc1 == 6_001_230_000
    client.send(mavlink.MAVLink_ping_message(11, 12, 0, 0))
    (answer,) = client.heard("PING")
    assert (answer.time_usec, answer.seq, answer.target_system, answer.target_component) == (11, 12, 250, 3)


def test_health_is_reported_as_it_is(autopilot_kind: AutopilotKind) -> None:
    desk = NetworkedVehicle(autopilot_kind)
    client, state = desk.client(255), resting_state((0.0, 0.0, -0.18), 0.0)
    gps, mag = mavlink.MAV_SYS_STATUS_SENSOR_GPS, mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG

    def ill() -> int:
        client.heard()
        for _ in range(200):
            desk.sensors.step(desk.flight.now_s, state, 0.0, lambda: 1.0)
            desk.run(0.01)
        heard = client.heard()
        fix = next(m.fix_type for m in reversed(heard) if m.get_type() == "GPS_RAW_INT")
        status = next(m for m in reversed(heard) if m.get_type() == "SYS_STATUS")
        assert (fix >= mavlink.GPS_FIX_TYPE_3D_FIX) is desk.sensors.has_sky
        return int(~status.onboard_control_sensors_health & (gps | mag))

    assert ill() == 0
    desk.sensors.has_sky = False
    assert ill() == gps
    desk.sensors.has_sky, desk.sensors.stray_field_ut = True, (0.0, 40.0, 0.0)
    assert ill() == mag


def test_what_is_streamed_by_default_is_said_and_stream_groups_are_ardupilot_s(
    autopilot_kind: AutopilotKind,
) -> None:
    desk = NetworkedVehicle(autopilot_kind)
    client = desk.client(255)
    desk.run(3.0)
    kinds = {m.get_type() for m in client.heard()}
    common = {"VFR_HUD", "SYSTEM_TIME", "VIBRATION", "SERVO_OUTPUT_RAW", "RC_CHANNELS", "BATTERY_STATUS"}
    px4, ardupilot = {"ALTITUDE", "ESTIMATOR_STATUS"}, {"EKF_STATUS_REPORT"}
    own, others = (px4, ardupilot) if autopilot_kind == "px4" else (ardupilot, px4)
    assert common | own <= kinds
    assert not others & kinds
    client.send(mavlink.MAVLink_request_data_stream_message(1, 1, 10, 5, 1), desk.flight.now_s)
    client.heard()
    desk.run(2.0)
    assert len(client.heard("ATTITUDE")) == (100 if autopilot_kind == "px4" else 10)


# ---------------------------------------------------------------- what a vehicle has to stand


@pytest.mark.parametrize(
    ("autopilot_kind", "key"), [("px4", None), ("ardupilot", None), ("px4", bytes(range(32)))]
)
def test_wrong_frames_cost_no_legal_one(autopilot_kind: AutopilotKind, key: bytes | None) -> None:
    found = Fuzz(autopilot_kind, 7, key).run(7000)
    assert found.holds, found
    assert found.lost == 0
    assert (found.refused > 1000) is (key is not None)


def test_orders_that_make_no_sense_cost_no_legal_frame(autopilot_kind: AutopilotKind) -> None:
    found = Fuzz(autopilot_kind, 3, orders=True).run(5000)
    assert found.holds, found
    assert found.kinds["orders"] > 3000


def test_a_second_companion_is_obeyed_and_heard(desk: NetworkedVehicle) -> None:
    client, autopilot = desk.client(1, 191), desk.flight.autopilot
    assert autopilot.set_mode_named("OFFBOARD") is autopilot.profile.refused  # nobody sends setpoints
    desk.ground.intruders["setpoints"] = Companion(196, 0.1)
    desk.run(0.5)
    heard = client.heard("SET_POSITION_TARGET_LOCAL_NED")
    assert {(m.get_srcSystem(), m.get_srcComponent(), m.target_system) for m in heard} == {(1, 196, 1)}
    assert len(heard) == pytest.approx(5, abs=1)
    assert autopilot.set_mode_named("OFFBOARD") is CommandResult.ACCEPTED


def test_frames_without_the_key_bear_the_largest_stamp_and_are_refused() -> None:
    key = bytes(range(32))
    forged = FrameReader(datagrams=True).read(Forger(1.0).due(0.0), 0.0)
    signing = Signing("px4", key)
    link = LinkSigning(key, 0)
    assert [(frame.system, frame.component, frame.signed) for frame in forged] == [(1, 1, True)]
    assert int.from_bytes(forged[0].data[-12:-6], "little") > (1 << 48) - 300
    assert not link.accepts(forged[0].data)
    # a heartbeat, as this one, may come unsigned; the same signature under any other message may not
    assert not signing.accepts(forged[0]._replace(message_id=mavlink.MAVLINK_MSG_ID_COMMAND_LONG))
    assert link.stamp < 1000
