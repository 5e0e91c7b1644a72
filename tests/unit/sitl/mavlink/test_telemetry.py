"""The simulated autopilot's own sensors: their messages as PX4 and as ArduPilot, their cost."""

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import GRAVITY_M_S2, ned_from_geodetic, quat_from_euler
from companion.config import LinkConfig, SenseConfig
from companion.link.codec import Codec, command_long
from companion.link.session import Session
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.external import pose as external_pose
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.mavlink.sensor_telemetry import HIL_STATE, SIM_STATE, TruthMessages
from sitl.scenario.scenario import USUAL_HOMES, Scenario
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.sensors.inertial import NO_IMU_ERRORS, SensorErrors
from sitl.vehicle.quadrotor import QuadrotorState, resting_state
from sitl.world.world import World
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight
from tests.unit.sitl.autopilot.missions.mission_desk import of
from tests.unit.sitl.sensors.flawless import NO_GPS_ERRORS, NO_MAG_ERRORS, NO_RANGE_ERRORS

DT_S = 1.0 / 400.0
FIELD_UT = (20.9, 0.6, 42.9)


class StandingVehicle:
    """An autopilot on its feet with sensors in a state of our choice."""

    def __init__(self, autopilot_kind: AutopilotKind, seed: int = 1, flawless: bool = True) -> None:
        self.autopilot: SimulatedAutopilot = AutopilotFlight(autopilot_kind).autopilot
        flaws = SensorErrors(NO_IMU_ERRORS, NO_MAG_ERRORS, NO_GPS_ERRORS, NO_RANGE_ERRORS)
        self.sensors = SimulatedAutopilotSensors(
            np.random.default_rng(seed),
            DT_S,
            home=HOME,
            field_ned_ut=FIELD_UT,
            imu_filter=self.autopilot.profile.imu_filter,
            antenna_body_m=(0.0, 0.0, 0.0),
            errors=flaws if flawless else None,
        )
        self.endpoint = MavlinkEndpoint(self.autopilot, self.sensors)
        self.flight = AutopilotFlight(autopilot_kind)
        self.flight.autopilot = self.autopilot
        self.state: QuadrotorState = resting_state((0.0, 0.0, -0.18), 0.0)
        self.range_height_m = 1.5
        self.parser = mavlink.MAVLink(None)

    def run(self, seconds: float) -> list[Any]:
        heard: list[Any] = []
        for _ in range(round(seconds * 200)):
            self.flight.run(2 * DT_S)
            for step in (1, 0):
                self.sensors.step(
                    self.flight.now_s - step * DT_S, self.state, 0.0, lambda: self.range_height_m
                )
            heard += self.parser.parse_buffer(self.endpoint.transmit(self.flight.now_s)) or []
        return heard

    def ask(self, name: str, rate_hz: float) -> bool:
        return self.endpoint.set_interval(getattr(mavlink, f"MAVLINK_MSG_ID_{name}"), 1e6 / rate_hz)


IMU = {"px4": ["HIGHRES_IMU"], "ardupilot": ["RAW_IMU", "SCALED_IMU"]}


@pytest.fixture
def vehicle(autopilot_kind: AutopilotKind) -> StandingVehicle:
    """Asked for its own IMU messages, of the two alone that it has."""
    vehicle, own = StandingVehicle(autopilot_kind), IMU[autopilot_kind]
    assert [name for name in (*IMU["px4"], *IMU["ardupilot"]) if vehicle.ask(name, 100.0)] == own
    return vehicle


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_tilting_vehicle_that_moves_is_reported_in_the_messages_own_units(
    vehicle: StandingVehicle, autopilot_kind: AutopilotKind, yaw_deg: float
) -> None:
    yaw = math.radians(yaw_deg)
    vehicle.state = QuadrotorState(
        position_ned_m=(30.0, -20.0, -7.0),
        velocity_ned_m_s=(1.5 * math.cos(yaw), 1.5 * math.sin(yaw), 0.4),
        attitude=quat_from_euler(0.0, 0.0, yaw),
        rate_body_rad_s=(0.1, -0.2, 0.3),
        specific_force_body_m_s2=(1.0, -2.0, -9.0),
    )
    heard = vehicle.run(12.0)
    for name in IMU[autopilot_kind]:
        assert len(of(heard, name)) == pytest.approx(1200, abs=18)
    fix = of(heard, "GPS_RAW_INT")[-1]
    assert fix.fix_type == mavlink.GPS_FIX_TYPE_3D_FIX
    assert (fix.vel, fix.cog) == (150, round(100 * yaw_deg))
    assert fix.alt == pytest.approx(407_000, abs=5)
    imu = of(heard, IMU[autopilot_kind][0])[-1]
    # m/s², rad/s and gauss; milli-g, mrad/s and milligauss
    g, per_rad_s, field_ut = 1.0, 1.0, 100.0
    close: tuple[float | None, float | None] = (None, None)
    if autopilot_kind == "ardupilot":
        g, per_rad_s, field_ut, close = GRAVITY_M_S2 / 1e3, 1e3, 0.1, (0.011, 1.0)
    assert (imu.xacc * g, imu.yacc * g, imu.zacc * g) == pytest.approx((1.0, -2.0, -9.0), abs=close[0])
    turned = [rate * per_rad_s for rate in (0.1, -0.2, 0.3)]
    assert [imu.xgyro, imu.ygyro, imu.zgyro] == pytest.approx(turned, abs=close[1])
    (north, east, down), c, s = FIELD_UT, math.cos(yaw), math.sin(yaw)
    assert (imu.xmag * field_ut, imu.ymag * field_ut, imu.zmag * field_ut) == pytest.approx(
        (c * north + s * east, -s * north + c * east, down), abs=0.11
    )


def test_stamps_count_from_boot_and_a_fix_is_stamped_when_it_comes(
    vehicle: StandingVehicle, autopilot_kind: AutopilotKind
) -> None:
    heard, booted_s = vehicle.run(12.0), vehicle.autopilot.booted_s
    assert booted_s is not None
    imu = of(heard, IMU[autopilot_kind][0])[-1]
    assert imu.time_usec * 1e-6 == pytest.approx(vehicle.flight.now_s - booted_s, abs=0.006)
    stamps = [m.time_usec * 1e-6 + booted_s for m in of(heard, "GPS_RAW_INT") if m.fix_type >= 3]
    assert [(stamp - 0.12) % 0.2 for stamp in stamps[-5:]] == pytest.approx(
        [stamps[-1] % 0.2 - 0.12] * 5, abs=1e-3
    )


def test_px4_says_which_fields_are_new_and_nobody_who_asks_costs_nothing() -> None:
    vehicle = StandingVehicle("px4")
    vehicle.run(1.0)
    assert vehicle.sensors.imu is None
    assert vehicle.sensors.range is None
    vehicle.ask("HIGHRES_IMU", 200.0)
    bits = [m.fields_updated for m in of(vehicle.run(1.0), "HIGHRES_IMU")]
    assert set(bits) == {0b111_111, 0b111_111_111}
    assert bits.count(0b111_111_111) == pytest.approx(50, abs=2)


def test_the_rangefinder_tells_centimetres_and_a_lost_echo_lies_out_of_range() -> None:
    vehicle = StandingVehicle("px4")
    vehicle.ask("DISTANCE_SENSOR", 20.0)
    near = of(vehicle.run(1.0), "DISTANCE_SENSOR")
    assert len(near) == pytest.approx(20, abs=2)
    assert {m.current_distance for m in near} == {150}
    assert near[-1].orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    vehicle.range_height_m = 99.0
    far = of(vehicle.run(0.5), "DISTANCE_SENSOR")
    assert all(m.current_distance > m.max_distance for m in far[2:])


def test_gps_has_its_own_noise_and_no_fix_before_the_alignment(autopilot_kind: AutopilotKind) -> None:
    vehicle = StandingVehicle(autopilot_kind, flawless=False)
    heard = of(vehicle.run(12.0), "GPS_RAW_INT")
    assert heard[0].fix_type < mavlink.GPS_FIX_TYPE_3D_FIX
    fixes = [m for m in heard if m.fix_type >= 3]
    assert len({(m.lat, m.lon, m.alt) for m in fixes}) > 0.9 * len(fixes)
    assert np.std([m.alt for m in fixes]) > 50  # mm, on the ground


def test_the_same_seed_gives_the_same_samples_whoever_else_draws() -> None:
    def samples(seed: int) -> list[Any]:
        vehicle = StandingVehicle("px4", seed, flawless=False)
        vehicle.ask("HIGHRES_IMU", 100.0)
        return [m.to_dict() for m in of(vehicle.run(1.0), "HIGHRES_IMU")]

    assert samples(5) == samples(5)
    assert samples(5) != samples(6)


@pytest.mark.parametrize("latency_s", [0.12, 0.2, 0.5])
def test_however_late_its_fixes_come_none_is_lost(latency_s: float) -> None:
    sensors = SimulatedAutopilotSensors(
        np.random.default_rng(1),
        DT_S,
        home=HOME,
        field_ned_ut=FIELD_UT,
        imu_filter=2,
        gps_latency_s=latency_s,
    )
    state, told = resting_state((0.0, 0.0, -0.18), 0.0), set()
    for step in range(round(10.0 / DT_S)):
        sensors.step(step * DT_S, state, 0.0, lambda: 1.0)
        if sensors.gps is not None:
            told.add(sensors.gps.time_s)
    assert min(told) == pytest.approx(latency_s)
    assert (10.0 - latency_s) / 0.2 - 1.0 < len(told) < 52


# ----------------
# The truth as real simulators tell it: as it is, when asked for, and only from one that serves it.

PX4_HOME = USUAL_HOMES["px4"]

OF = {"px4": HIL_STATE, "ardupilot": SIM_STATE}
STATE = QuadrotorState(
    (3.0, -4.0, -5.0), (0.5, 0.25, -1.0), quat_from_euler(0.1, -0.2, 2.5), (0.1, -0.2, 0.3)
)


def endpoint(autopilot_kind: AutopilotKind, *, serving: bool) -> MavlinkEndpoint:
    world = World(Scenario(name="t", description="t", autopilot=autopilot_kind), 0)
    world.place(STATE)
    autopilot = SimulatedAutopilot(autopilot_kind, world.airframe.body, np.random.default_rng(0), PX4_HOME)
    return MavlinkEndpoint(autopilot, truth=TruthMessages(autopilot, world, PX4_HOME) if serving else None)


def heard(port: MavlinkEndpoint, *requests: Any, seconds: float = 1.0) -> list[Any]:
    """What it sends in that time after these requests."""
    client, listener, messages = Codec(1, 26), Codec(0), []
    for request in requests:
        port.receive(client.encode(request), 0.0)
    for k in range(round(seconds / 0.005)):
        messages += listener.decode(port.transmit(0.005 * k))
    return messages


def interval(message_id: int, rate_hz: float) -> Any:
    return command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0), 1)


def test_it_is_the_truth_at_the_rate_asked_for(autopilot_kind: AutopilotKind) -> None:
    told = [m for m in heard(endpoint(autopilot_kind, serving=True), interval(OF[autopilot_kind], 100.0))
            if m.get_msgId() == OF[autopilot_kind]]  # fmt: skip
    assert len(told) == pytest.approx(100, abs=2)
    read = external_pose.hil_state if autopilot_kind == "px4" else external_pose.sim_state
    sample = read(told[-1], 0.0)
    assert sample is not None
    assert ned_from_geodetic(*sample.place, PX4_HOME) == pytest.approx(STATE.position_ned_m, abs=0.012)
    assert sample.velocity_ned_m_s == pytest.approx(STATE.velocity_ned_m_s, abs=0.01)
    assert sample.attitude == pytest.approx(STATE.attitude, abs=1e-6)
    assert sample.rate_body_rad_s == pytest.approx(STATE.rate_body_rad_s, abs=1e-6)


def test_nobody_gets_it_unasked_nor_from_a_simulator_that_does_not_serve_it(
    autopilot_kind: AutopilotKind,
) -> None:
    truths = {SIM_STATE, HIL_STATE}
    assert not truths & {m.get_msgId() for m in heard(endpoint(autopilot_kind, serving=True))}
    asked = [interval(number, 100.0) for number in truths]
    refused = heard(endpoint(autopilot_kind, serving=False), *asked)
    assert not truths & {m.get_msgId() for m in refused}
    results = [m.result for m in refused if m.get_type() == "COMMAND_ACK"]
    assert len(results) == 2
    assert mavlink.MAV_RESULT_ACCEPTED not in results


def test_the_app_never_asks_for_it_nor_hears_it(autopilot_kind: AutopilotKind) -> None:
    """A minute of the app's session, with the autopilot's own sensors, against a simulator that serves it."""
    port = endpoint(autopilot_kind, serving=True)
    session = Session(LinkConfig(), SenseConfig(source="autopilot"))
    listener, asked = Codec(0), set()
    for k in range(1200):
        now_s = 0.05 * k
        session.receive(port.transmit(now_s), now_s)
        out = session.tick(now_s)
        asked |= {
            round(m.param1)
            for m in listener.decode(out)
            if m.get_type() in ("COMMAND_LONG", "COMMAND_INT") and m.command in (511, 512)
        }
        port.receive(out, now_s)
    assert {mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_HOME_POSITION} & asked
    assert not {SIM_STATE, HIL_STATE, 164} & asked  # 164: ArduPilot's SIMSTATE
    # one that another client has asked for is not listened to
    before = session.counters.decoded
    port.receive(Codec(1, 26).encode(interval(OF[autopilot_kind], 100.0)), 60.0)
    sent = mavlink.MAVLink(None).parse_buffer(port.transmit(60.05)) or []
    truth = [bytes(m.get_msgbuf()) for m in sent if m.get_msgId() == OF[autopilot_kind]]
    assert truth
    session.receive(b"".join(truth), 60.05)
    assert session.counters.decoded == before
