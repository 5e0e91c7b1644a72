"""What each autopilot gets, what it makes of it, and how control begins with it."""

import math
from dataclasses import replace

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, quat_rotate
from companion.base.messages import Setpoint, VehicleState
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.attitude import attitude_from_acceleration
from companion.control.response.flight_model import velocity_gains
from companion.control.response.plant import Plant
from companion.control.setpoints import (
    Heading,
    boosted,
    ground_setpoint,
    resolved,
    stop_setpoint,
    tilt_compensation,
    velocity_setpoint,
)
from tests.unit.control.control_plants import vehicle_config
from tests.unit.control.controller_inputs import vehicle_state

LAGS_S = (0.11, 0.11, 0.04)


@pytest.mark.parametrize(
    ("asked", "autopilot_kind", "sent"),
    [
        ("auto", "px4", "acceleration"),
        ("auto", "ardupilot", "attitude"),
        ("acceleration", "px4", "acceleration"),
        # which shapes velocities and accelerations alike
        ("acceleration", "ardupilot", "attitude"),
        ("velocity", "px4", "velocity"),
        ("velocity", "ardupilot", "velocity"),
        ("attitude", "px4", "attitude"),
        ("attitude", "ardupilot", "attitude"),
    ],
)
def test_each_autopilot_gets_the_kind_that_it_takes(
    asked: str, autopilot_kind: AutopilotKind, sent: str
) -> None:
    config = ControlConfig.model_validate({"setpoint": asked})
    assert resolved(config, autopilot_kind).setpoint == sent


def test_the_pid_keeps_the_velocity_loop_that_it_was_tuned_on() -> None:
    config = ControlConfig.model_validate({"controller": "pid"})
    assert resolved(config, "px4").setpoint == "velocity"
    asked = config.model_copy(update={"setpoint": "acceleration"})
    assert resolved(asked, "px4").setpoint == "acceleration"


def _sent(kind: str, lasting: Vector3 = (1.0, 0.0, 0.4)) -> Setpoint:
    return velocity_setpoint(
        0.0,
        ControlConfig.model_validate({"setpoint": kind}),
        motion=Motion(ZERO3, (2.0, 0.0, 0.5), ZERO3),
        input_ned_m_s2=(-1.0, 0.3, 0.2),
        disturbance_ned_m_s2=lasting,
        lasting_ned_m_s2=lasting,
        lags_s=LAGS_S,
        gains_1_s=(2.2 if kind == "velocity" else 0.0, 2.2 if kind == "velocity" else 0.0, 4.0),
        heading=Heading(0.0),
    )


def test_without_a_velocity_loop_sideways_all_of_the_input_is_acceleration() -> None:
    by_tilt, by_velocity = _sent("acceleration"), _sent("velocity")
    assert not by_tilt.holds_horizontal_velocity
    assert by_tilt.acceleration_ned_m_s2[:2] == (-1.0, 0.3)
    assert by_velocity.holds_horizontal_velocity
    assert by_velocity.acceleration_ned_m_s2[0] > -0.5  # the lasting push is met by the velocity
    assert by_tilt.acceleration_ned_m_s2[2] == by_velocity.acceleration_ned_m_s2[2]
    assert by_tilt.velocity_ned_m_s[2] == by_velocity.velocity_ned_m_s[2]


def test_standing_still_in_the_air_needs_the_autopilots_velocity_loop() -> None:
    assert stop_setpoint(0.0, Heading(0.0)).holds_horizontal_velocity


@pytest.mark.parametrize(("kind", "holds"), [("acceleration", False), ("velocity", True)])
def test_on_the_pad_no_integral_of_the_autopilots_tilts_the_vehicle(kind: str, holds: bool) -> None:
    config = ControlConfig.model_validate({"setpoint": kind})
    resting = ground_setpoint(0.0, config, None, Heading(0.0))
    assert resting.holds_horizontal_velocity is holds
    assert resting.acceleration_ned_m_s2 == (0.0, 0.0, config.ground_acceleration_m_s2)


def _vehicle(time_s: float, velocity: Vector3, acceleration: Vector3, tilt: Vector3) -> VehicleState:
    return vehicle_state(
        time_s,
        position_ned_m=ZERO3,
        attitude=attitude_from_acceleration(tilt, 1.0),
        velocity_ned_m_s=velocity,
        acceleration_ned_m_s2=acceleration,
    )


@pytest.mark.parametrize(
    ("kind", "push"),
    [("acceleration", (-1.5, 0.8, 0.0)), ("attitude", (-1.5, 0.8, 0.0)), ("velocity", ZERO3)],
)
def test_who_makes_the_tilt_begins_with_the_wind_that_the_vehicle_tilts_against(
    kind: str, push: Vector3
) -> None:
    plant = Plant(ControlConfig.model_validate({"setpoint": kind}), vehicle_config(), LAGS_S)
    vehicle = _vehicle(0.0, ZERO3, ZERO3, (1.5, -0.8, 0.0))
    plant.begin(vehicle)
    assert plant.disturbance_ned_m_s2 == pytest.approx(push, abs=1e-6)
    # so that what is asked for first is the tilt that there is
    assert plant.last_input(Motion(ZERO3, ZERO3, ZERO3)) == pytest.approx((-push[0], -push[1], 0.0), abs=1e-6)


def test_a_hold_brakes_by_the_autopilots_own_loop_and_not_by_wind() -> None:
    config = ControlConfig(setpoint="acceleration")
    plant = Plant(config, vehicle_config(), LAGS_S)
    gain = velocity_gains(vehicle_config(), config)[0]
    speed, flown, felt, worst = 2.0, 0.0, 0.0, 0.0
    plant.begin(_vehicle(0.0, (speed, 0.0, 0.0), ZERO3, ZERO3))
    step_s = 1.0 / config.rate_hz
    for k in range(1, 40):
        plant.remember(Setpoint((k - 1) * step_s, holds_horizontal_velocity=True))
        for _ in range(10):
            wanted = -gain * speed if k > 1 else 0.0
            flown += (wanted - flown) * -math.expm1(-0.1 * step_s / LAGS_S[0])
            speed += flown * 0.1 * step_s
            felt += (flown - felt) * -math.expm1(-0.1 * step_s / config.acceleration_estimate_lag_s)
        now = _vehicle(k * step_s, (speed, 0.0, 0.0), (flown, 0.0, 0.0), (flown, 0.0, 0.0))
        plant.observe(replace(now, acceleration_ned_m_s2=(felt, 0.0, 0.0)), step_s)
        worst = max(worst, abs(plant.disturbance_ned_m_s2[0]))
    assert speed < 0.5
    assert worst < 0.4


@pytest.mark.parametrize(("flown", "asked"), [(3.5, 0.0), (0.0, 3.5), (-2.0, 2.0)])
def test_a_tilt_that_lags_takes_nothing_from_the_climb(flown: float, asked: float) -> None:
    """The autopilot's thrust, along the axis that the vehicle still has, makes the wanted upward force."""
    wanted, tilts = (asked, 0.5, -0.8), (flown, -0.3, -0.8)
    setpoint = boosted(Setpoint(0.0, acceleration_ned_m_s2=wanted), tilt_compensation(tilts, wanted, 0.5))
    up = -quat_rotate(attitude_from_acceleration(wanted, 0.4), (0.0, 0.0, -1.0))[2]
    thrust = (GRAVITY_M_S2 - setpoint.acceleration_ned_m_s2[2]) / up
    made = quat_rotate(attitude_from_acceleration(tilts, 0.4), (0.0, 0.0, -thrust))
    assert made[2] + GRAVITY_M_S2 == pytest.approx(-0.8, abs=1e-9)
    assert setpoint.acceleration_ned_m_s2[:2] == wanted[:2]


def test_an_upset_vehicle_is_not_thrown_up_and_no_number_counts_for_nothing() -> None:
    most = 1.0 / math.cos(0.5)
    assert tilt_compensation((0.0, 9.0, 7.5), ZERO3, 0.5) == pytest.approx(most)
    assert tilt_compensation(ZERO3, (9.0, 0.0, 7.5), 0.5) == pytest.approx(1.0 / most)
    assert math.isfinite(tilt_compensation((math.nan, 0.0, 0.0), ZERO3, 0.5))


def test_what_was_boosted_can_be_given_without_it() -> None:
    setpoint = Setpoint(0.0, acceleration_ned_m_s2=(1.0, 2.0, 0.3), thrust=0.5)
    more = boosted(setpoint, 1.1)
    assert more.thrust == pytest.approx(0.55)
    back = boosted(more, 1.0 / 1.1)
    assert back.acceleration_ned_m_s2 == pytest.approx(setpoint.acceleration_ned_m_s2)
    assert back.thrust == pytest.approx(0.5)
