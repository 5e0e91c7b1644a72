"""The simulated flight controller answers setpoints like the recorded ones, in a frame of its own."""

import math
from math import nan

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import (
    IDENTITY,
    euler_from_quat,
    quat_from_euler,
    quat_multiply,
    rotate_yaw,
    tilt_from_quat,
    wrap_angle,
    yaw_from_quat,
)
from companion.base.messages import LandedState
from sitl.autopilot.control.estimator import EstimatorErrors
from sitl.autopilot.control.setpoints import AttitudeSetpoint, LocalFrame, MotionSetpoint, StreamedMotion
from sitl.autopilot.flight.modes import Task
from tests.unit.sitl.autopilot.autopilot_flight import (
    STAND_STILL,
    ZERO,
    AutopilotFlight,
    MotionSample,
    in_the_air,
    reached_s,
    velocity,
)

# ---------------------------------------------------------------- answers to setpoints


@pytest.mark.parametrize(("autopilot_kind", "t63_s", "t90_s"), [("px4", 0.72, 1.2), ("ardupilot", 0.84, 1.4)])
def test_a_velocity_step_is_shaped_by_ardupilot_and_not_by_px4(
    airborne: AutopilotFlight, t63_s: float, t90_s: float
) -> None:
    samples = airborne.run(6.0, velocity(2.0))
    assert reached_s(samples, lambda s: s.velocity[0], 1.26) == pytest.approx(t63_s, abs=0.08)
    assert reached_s(samples, lambda s: s.velocity[0], 1.8) == pytest.approx(t90_s, abs=0.2)
    assert max(s.velocity[0] for s in samples) < 2.25
    assert samples[-1].velocity[0] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(("autopilot_kind", "t63_s"), [("px4", 1.42), ("ardupilot", 2.05)])
def test_a_position_step_is_shaped_by_ardupilot_and_not_by_px4(
    airborne: AutopilotFlight, t63_s: float
) -> None:
    x, y, z = airborne.autopilot.estimate.position_ned_m
    samples = airborne.run(8.0, MotionSetpoint(position_ned_m=(x + 5.0, y, z)))
    assert reached_s(samples, lambda s: s.position[0] - x, 3.15) == pytest.approx(t63_s, abs=0.1)
    assert 5.0 < max(s.position[0] - x for s in samples) < 5.6
    assert max(s.velocity[0] for s in samples) < 3.6
    assert samples[-1].position[0] - x == pytest.approx(5.0, abs=0.1)


def test_a_descent_rate_is_held_with_little_overshoot(
    airborne: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    samples = airborne.run(3.0, velocity(0.0, 0.0, 0.5))
    assert max(s.velocity[2] for s in samples) < (0.56 if autopilot_kind == "px4" else 0.6)
    assert samples[-1].velocity[2] == pytest.approx(0.5, abs=0.03)


def test_acceleration_fed_forward_makes_a_circle_far_rounder_than_velocity_alone(
    autopilot_kind: AutopilotKind,
) -> None:
    radius_m, turn = 2.0, 0.6
    speed, pull = radius_m * turn, radius_m * turn * turn

    def lag(share: float) -> float:
        """With a share of the acceleration, or none at all."""

        def circle(time_s: float) -> MotionSetpoint:
            c, s = math.cos(turn * time_s), math.sin(turn * time_s)
            return MotionSetpoint(
                velocity_ned_m_s=(speed * c, speed * s, 0.0),
                acceleration_ned_m_s2=(-share * pull * s, share * pull * c, 0.0 * share),
            )

        samples = in_the_air(autopilot_kind).run(12.0, circle)[250:]
        squares = [math.dist(s.velocity, circle(s.time_s).velocity_ned_m_s) ** 2 for s in samples]
        return math.sqrt(sum(squares) / len(squares))

    fed, alone = lag(1.0), lag(nan)
    assert fed < 0.2
    assert fed < 0.4 * alone


def test_an_acceleration_alone_gains_the_speed_it_says(
    airborne: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    setpoint = MotionSetpoint(velocity_ned_m_s=(nan, nan, 0.0), acceleration_ned_m_s2=(1.0, 0.0, nan))
    gained = airborne.run(2.0, setpoint)[-1].velocity[0]
    # PX4: nothing makes up for drag
    assert gained == pytest.approx(1.85, abs=0.1) if autopilot_kind == "ardupilot" else 1.2 < gained < 1.8


def test_wind_is_rejected_by_the_integral(airborne: AutopilotFlight) -> None:
    airborne.vehicle.wind_ned_m_s = (-3.0, 5.0, 0.0)
    samples = airborne.run(14.0, STAND_STILL)
    assert max(abs(s.velocity[1]) for s in samples) > 0.2
    assert math.dist(samples[-1].velocity, ZERO) < 0.05
    assert tilt_from_quat(samples[-1].attitude) > 0.05


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_body_frame_velocities_follow_the_nose(heading_deg: float) -> None:
    heading = math.radians(heading_deg)
    flight = AutopilotFlight("px4", heading_rad=heading)
    flight.take_off(3.0)
    flight.take_control()
    for _ in range(120):
        fields = StreamedMotion(LocalFrame.BODY_NED, 0b110111000111, ZERO, (1.0, 0.5, 0.0), ZERO, 0.0, 0.0)
        flight.autopilot.stream_fields(fields, flight.now_s)
        flight.run(1.0 / 30.0)
    forward, right, _ = rotate_yaw(flight.vehicle.velocity, -heading)
    assert [forward, right] == pytest.approx([1.0, 0.5], abs=0.06)


def test_yaw_and_yaw_rate_are_flown(airborne: AutopilotFlight) -> None:
    airborne.run(8.0, MotionSetpoint(velocity_ned_m_s=ZERO, yaw_rad=math.pi / 2))
    assert yaw_from_quat(airborne.vehicle.attitude) == pytest.approx(math.pi / 2, abs=0.03)
    samples = airborne.run(3.0, MotionSetpoint(velocity_ned_m_s=ZERO, yaw_rate_rad_s=0.3))
    turned = wrap_angle(yaw_from_quat(samples[-1].attitude) - yaw_from_quat(samples[50].attitude))
    assert turned == pytest.approx(0.3 * (samples[-1].time_s - samples[50].time_s), abs=0.03)
    assert math.dist(airborne.vehicle.velocity, ZERO) < 0.1


def test_the_attitude_loop_takes_a_sixth_of_a_second() -> None:
    flight = in_the_air("px4")
    samples = flight.run(0.8, AttitudeSetpoint(quat_from_euler(0.15, 0.0, 0.0), 0.5))
    assert reached_s(samples, lambda s: euler_from_quat(s.attitude)[0], 0.63 * 0.15) == pytest.approx(
        0.15, abs=0.05
    )
    assert max(euler_from_quat(s.attitude)[0] for s in samples) < 0.165


def test_the_thrust_field_is_thrust_to_px4_and_a_climb_rate_to_ardupilot(
    airborne: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    def climbed(seconds: float) -> float:
        return -airborne.run(seconds, AttitudeSetpoint(IDENTITY, 0.6))[-1].velocity[2]

    if autopilot_kind == "px4":
        assert climbed(3.0) > 1.5
        return
    assert climbed(3.0) == pytest.approx(0.5, abs=0.05)
    airborne.run(3.0, STAND_STILL)
    airborne.autopilot.parameters.set("GUID_OPTIONS", 8)
    assert climbed(1.5) > 1.5


def test_ardupilot_raises_thrust_for_the_tilt_it_flies_and_px4_does_not(
    airborne: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    airborne.autopilot.parameters.set("GUID_OPTIONS", 8)
    tilting = AttitudeSetpoint(quat_from_euler(0.0, -0.5, 0.0), airborne.autopilot.thrust)
    sank = airborne.run(1.5, tilting)[-1].velocity[2]
    assert sank == pytest.approx(0.0, abs=0.3) if autopilot_kind == "ardupilot" else sank > 0.8


@pytest.mark.parametrize("share", [0.0, 0.8])
def test_at_ardupilots_time_out_what_stands_by_a_thrust_stays_down_and_what_hovers_holds_its_height(
    share: float,
) -> None:
    """Its height controller begins from the throttle that there is; the field is a thrust no more."""
    flight = in_the_air("ardupilot")
    flight.autopilot.parameters.set("GUID_OPTIONS", 8)
    flight.autopilot.parameters.set("GUID_TIMEOUT", 0.5)
    flight.vehicle.airframe = flight.vehicle.airframe.model_copy(
        update={"mass_kg": 1.2 * flight.vehicle.airframe.mass_kg}
    )
    hover, level = 1.2 * flight.autopilot.thrust, quat_from_euler(0.0, 0.0, 0.0)
    flight.run(1.0, AttitudeSetpoint(level, hover))
    held = flight.run(5.0)
    assert held[-1].velocity[2] == pytest.approx(0.0, abs=0.05)
    assert held[-1].position[2] == pytest.approx(held[0].position[2], abs=0.5)
    flight.run(0.5, AttitudeSetpoint(level, 0.9 * hover))
    flight.vehicle.floor_z_m = flight.vehicle.position[2] + 0.01
    flight.run(0.5, AttitudeSetpoint(level, share * hover))  # too short to be a landing
    assert flight.autopilot.landed_state is not LandedState.ON_GROUND
    assert flight.vehicle.height_m == 0.0
    flight.run(4.0)
    assert flight.vehicle.height_m < 0.005


# ---------------------------------------------------------------- its own idea of the world


def test_its_estimate_is_off_in_place_height_and_heading_but_flight_stays_calm() -> None:
    flight = in_the_air("px4", errors=EstimatorErrors(), seed=5)
    samples = flight.run(20.0, STAND_STILL)
    estimate, vehicle = flight.autopilot.estimate, flight.vehicle
    assert math.radians(2.0) <= abs(estimate.heading_bias_rad) <= math.radians(3.0)
    shown = yaw_from_quat(estimate.attitude)
    assert wrap_angle(shown - yaw_from_quat(vehicle.attitude)) == pytest.approx(
        estimate.heading_bias_rad, abs=0.01
    )
    assert math.dist(estimate.position_ned_m, vehicle.position) > 0.1
    assert max(math.dist(s.velocity, ZERO) for s in samples) < 0.25


def test_a_velocity_is_flown_in_its_own_heading() -> None:
    flight = in_the_air("px4", errors=EstimatorErrors(0.0, 0.0), seed=2)
    flight.run(5.0, velocity(2.0))
    bias = flight.autopilot.estimate.heading_bias_rad
    north, east, _ = rotate_yaw((2.0, 0.0, 0.0), -bias)
    assert flight.vehicle.velocity[0] == pytest.approx(north, abs=0.04)
    assert flight.vehicle.velocity[1] == pytest.approx(east, abs=0.04)


def test_its_hover_wanders_as_far_as_the_recorded_one() -> None:
    flight = AutopilotFlight("px4", errors=EstimatorErrors(), seed=3)
    flight.take_off()
    norths = [s.position[0] for s in flight.run(60.0)]
    mean = sum(norths) / len(norths)
    spread = math.sqrt(sum((x - mean) ** 2 for x in norths) / len(norths))
    assert 0.05 < spread < 0.6


def test_the_same_seed_flies_the_same_flight() -> None:
    def fly(seed: int) -> list[MotionSample]:
        flight = AutopilotFlight("ardupilot", errors=EstimatorErrors(), seed=seed)
        flight.take_off(3.0)
        return flight.run(1.0, velocity(1.0))

    assert fly(7) == fly(7)
    assert fly(7) != fly(8)


def test_a_wish_without_any_field_means_stop() -> None:
    flight = in_the_air("px4")
    flight.run(3.0, velocity(2.0, 0.0, -1.0))
    flight.run(5.0, MotionSetpoint())
    assert math.dist(flight.vehicle.velocity, ZERO) < 0.05


def test_held_places_are_held_in_the_attitude_that_wind_asks_for() -> None:
    flight = AutopilotFlight("px4")
    flight.take_off()
    flight.vehicle.wind_ned_m_s = (0.0, 4.0, 0.0)
    flight.run(15.0)
    assert math.hypot(*flight.vehicle.position[:2]) < 0.15
    assert flight.autopilot.task is Task.HOLD
    tilting = euler_from_quat(quat_multiply((1.0, 0.0, 0.0, 0.0), flight.vehicle.attitude))[0]
    assert tilting < -0.05


def test_a_far_position_is_approached_no_faster_than_the_top_speed() -> None:
    flight = in_the_air("px4")
    flight.autopilot.parameters.set("MPC_XY_VEL_MAX", 2.0)
    fields = StreamedMotion(LocalFrame.LOCAL_NED, 0b110111111000, (50.0, 0.0, -6.18), ZERO, ZERO, 0.0, 0.0)
    for _ in range(120):
        flight.autopilot.stream_fields(fields, flight.now_s)
        flight.run(1.0 / 30.0)
    assert flight.vehicle.velocity[0] == pytest.approx(2.0, abs=0.1)
