"""What each autopilot gets, what it makes of it, and how control begins with it."""

import math
from dataclasses import replace

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    euler_from_quat,
    horizontal_acceleration,
    norm,
    quat_rotate,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.base.messages import (
    AutopilotSetup,
    AutopilotState,
    ControlReport,
    LandedState,
    Setpoint,
    VehicleState,
)
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.attitude import (
    attitude_from_acceleration,
    force_from_acceleration,
    thrust_from_acceleration,
)
from companion.control.controller import Controller
from companion.control.response.flight_model import velocity_gains
from companion.control.response.plant import Plant
from companion.control.setpoints import (
    GROUND_PRESS_M_S2,
    Heading,
    boosted,
    ground_setpoint,
    resolved,
    stop_setpoint,
    tilt_compensation,
    velocity_setpoint,
)
from tests.unit.control.control_plants import reference_rows, vehicle_config
from tests.unit.control.controller_inputs import plan_step, vehicle_state

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
    pressed_m_s2 = config.ground_acceleration_m_s2 if holds else GROUND_PRESS_M_S2
    assert resting.acceleration_ned_m_s2 == (0.0, 0.0, pressed_m_s2)
    # AND where no velocity loop tilts it, hardly any thrust is left: PX4 asks for this much
    assert holds or GROUND_PRESS_M_S2 + 4.0 * config.ground_descent_m_s > 0.9 * GRAVITY_M_S2


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


# ---------------- Acceleration to attitude and thrust, at all headings and tilts

HEADINGS_DEG = (0.0, 90.0, 180.0, 270.0, 33.0)
ACCELERATIONS: tuple[Vector3, ...] = (
    (0.0, 0.0, 0.0),
    (2.0, 0.0, 0.0),
    (0.0, -2.0, 0.0),
    (-3.0, 1.5, -2.0),
    (1.0, 1.0, 3.0),
)


@pytest.mark.parametrize("heading_deg", HEADINGS_DEG)
@pytest.mark.parametrize("acceleration", ACCELERATIONS)
def test_pushing_along_the_bodys_up_axis_gives_the_acceleration_back(
    heading_deg: float, acceleration: Vector3
) -> None:
    attitude = attitude_from_acceleration(acceleration, math.radians(heading_deg))
    thrust = thrust_from_acceleration(acceleration, 0.5)
    force = quat_rotate(attitude, (0.0, 0.0, -thrust / 0.5 * GRAVITY_M_S2))
    flown = (force[0], force[1], force[2] + GRAVITY_M_S2)
    assert flown == pytest.approx(acceleration, abs=1e-9)
    turned = math.remainder(yaw_from_quat(attitude) - math.radians(heading_deg), math.tau)
    assert turned == pytest.approx(0.0, abs=1e-9)


def test_accelerating_north_noses_down_when_looking_north_and_rolls_left_when_looking_east() -> None:
    north = euler_from_quat(attitude_from_acceleration((2.0, 0.0, 0.0), 0.0))
    assert north[1] == pytest.approx(-math.atan2(2.0, GRAVITY_M_S2))
    assert north[0] == pytest.approx(0.0, abs=1e-12)
    east = euler_from_quat(attitude_from_acceleration((2.0, 0.0, 0.0), math.pi / 2))
    assert east[0] == pytest.approx(-math.atan2(2.0, GRAVITY_M_S2))
    assert east[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("heading_deg", HEADINGS_DEG)
def test_level_acceleration_reads_an_attitude_back(heading_deg: float) -> None:
    attitude = attitude_from_acceleration((1.2, -0.7, 0.0), math.radians(heading_deg))
    assert horizontal_acceleration(attitude) == pytest.approx((1.2, -0.7))


def test_level_flight_hovers_at_hover_thrust() -> None:
    assert thrust_from_acceleration((0.0, 0.0, 0.0), 0.43) == pytest.approx(0.43)
    assert thrust_from_acceleration((0.0, 0.0, -GRAVITY_M_S2), 0.43) == pytest.approx(0.86)


def test_falling_faster_than_gravity_never_turns_the_vehicle_over() -> None:
    attitude = attitude_from_acceleration((0.5, 0.0, 30.0), 0.0)
    assert force_from_acceleration((0.5, 0.0, 30.0))[2] < 0.0
    assert tilt_from_quat(attitude) < math.radians(20.0)
    assert norm(attitude[1:]) < 0.2


# ----------------
# By attitude nothing is flown before the thrust that holds the vehicle is measured, nor in a fall.

PERIOD_S = 1.0 / 30.0
TOLD = AutopilotSetup(hover_thrust=0.35)


def ardupilot(setpoint: str = "attitude", measures_thrust: bool = True) -> Controller:
    config = ControlConfig.model_validate({"setpoint": setpoint})
    kind: AutopilotKind = "ardupilot" if setpoint == "attitude" else "px4"
    return Controller(config, vehicle_config(), None, kind, TOLD, measures_thrust)


def held_by(thrust: float | None, now_s: float, landed: LandedState = LandedState.IN_AIR) -> AutopilotState:
    return AutopilotState(now_s, True, "ardupilot", True, landed=landed, thrust=thrust, thrust_time_s=now_s)


def feel(controller: Controller, thrust: float | None, seconds: float, **changes: object) -> float:
    """Somebody else flies for a while."""
    for cycle in range(round(seconds / PERIOD_S)):
        now_s = cycle * PERIOD_S
        controller.thrust.feel(vehicle_state(now_s, **changes), held_by(thrust, now_s), TOLD, now_s)
    return seconds


def step(
    controller: Controller, now_s: float, sink_m_s: float = 0.0, down_m_s2: float = 0.0
) -> tuple[Setpoint, ControlReport]:
    moves = {"velocity_ned_m_s": (0.0, 0.0, sink_m_s), "acceleration_ned_m_s2": (0.0, 0.0, down_m_s2)}
    vehicle = vehicle_state(now_s, **moves)
    stay = reference_rows(now_s, lambda _t: (vehicle.position_ned_m, ZERO3, ZERO3), origin="local")
    answer = controller.step(plan_step(now_s, stay), vehicle, None, now_s)
    assert answer is not None
    return answer


@pytest.mark.parametrize("hover", [0.25, 0.35, 0.5, 0.65, 0.8])
def test_it_takes_over_with_the_thrust_that_holds_the_vehicle(hover: float) -> None:
    controller = ardupilot()
    setpoint, report = step(controller, feel(controller, hover, 2.0))
    assert setpoint.thrust == pytest.approx(hover, rel=0.02)
    assert report.hover_thrust == pytest.approx(hover, rel=0.01)
    assert report.failure == ""


def test_what_holds_it_may_be_learnt_in_a_climb_too() -> None:
    controller = ardupilot()
    climbing = (0.0, 0.0, -0.2 * 9.80665)
    step_s = feel(controller, 0.78, 2.0, acceleration_ned_m_s2=climbing)
    assert step(controller, step_s)[1].hover_thrust == pytest.approx(0.65, rel=0.01)


@pytest.mark.parametrize("case", ["never reported", "on the ground", "no IMU"])
def test_unmeasured_it_is_left_to_the_autopilots_own_loops_and_told(case: str) -> None:
    controller = ardupilot()
    for cycle in range(60):
        now_s = cycle * PERIOD_S
        landed = LandedState.ON_GROUND if case == "on the ground" else LandedState.IN_AIR
        state = held_by(None if case == "never reported" else 0.5, now_s, landed)
        vehicle = None if case == "no IMU" else vehicle_state(now_s)
        controller.thrust.feel(vehicle, state, TOLD, now_s)
    setpoint, report = step(controller, 2.0)
    assert (setpoint.attitude, setpoint.thrust, setpoint.velocity_ned_m_s) == (None, None, ZERO3)
    assert report.failure.startswith("hover thrust: uncertain: 100 %")
    assert controller.thrust.doubt == report.failure


def learnt_in_silence(silence_s: float, thrust: float, acceleration_m_s2: float, *, of_thrust: bool) -> float:
    """Hover thrust after 2 s at 0.45, and then a silence of the thrust's reports, or of the IMU.

    What came last was this thrust, and this acceleration (down).
    """
    controller = ardupilot()
    silent_s = feel(controller, 0.45, 2.0)
    for cycle in range(round(silence_s / PERIOD_S)):
        now_s = silent_s + cycle * PERIOD_S
        state = replace(held_by(thrust, now_s), thrust_time_s=silent_s if of_thrust else now_s)
        age_s = 0.0 if of_thrust else now_s - silent_s
        moves = (0.0, 0.0, acceleration_m_s2)
        vehicle = vehicle_state(now_s, imu_age_s=age_s, acceleration_ned_m_s2=moves)
        controller.thrust.feel(vehicle, state, TOLD, now_s)
    setpoint, report = step(controller, now_s)
    assert report.failure == ""
    assert setpoint.thrust is not None
    return setpoint.thrust


@pytest.mark.parametrize(
    ("thrust", "acceleration_m_s2", "of_thrust"),
    [
        (0.70, 0.0, True),  # a climb's, and it hovers by now
        (0.26, 0.0, True),
        (0.45, -3.0, False),  # it climbed when its IMU fell silent
    ],
)
def test_nothing_is_learnt_from_a_thrust_or_an_acceleration_of_long_ago(
    thrust: float, acceleration_m_s2: float, of_thrust: bool
) -> None:
    """GIVEN one of the two that goes on, THEN it alone says nothing."""
    soon, late = (
        learnt_in_silence(seconds, thrust, acceleration_m_s2, of_thrust=of_thrust) for seconds in (0.5, 20.0)
    )
    assert soon == pytest.approx(late, rel=1e-3)
    assert soon == pytest.approx(0.45, rel=0.2)  # what was fresh for a moment


def test_what_contradicts_the_file_and_the_parameter_is_left_too_until_it_is_resolved() -> None:
    controller = ardupilot()
    now_s = feel(controller, 0.98, 6.0)
    setpoint, report = step(controller, now_s)
    assert setpoint.attitude is None
    assert "0.98 measured, vehicle 'test' 0.50, the autopilot's parameter 0.35 configured" in report.failure
    controller.thrust.feel(
        vehicle_state(now_s), held_by(0.98, now_s), AutopilotSetup(hover_thrust=0.8), now_s
    )
    setpoint, report = step(controller, now_s + PERIOD_S)
    assert setpoint.attitude is not None
    assert report.failure == ""


def test_by_other_kinds_of_setpoint_nothing_needs_to_be_known() -> None:
    controller = ardupilot("acceleration")
    assert not controller.thrust.measures
    assert step(controller, 0.0)[1].failure == ""


def sinking(controller: Controller, speeds_m_s: list[float]) -> list[str]:
    """What is told while it sinks like that, with the accelerations that belong to it."""
    told, before = [], speeds_m_s[0]
    for k, speed in enumerate(speeds_m_s):
        told.append(step(controller, k * PERIOD_S, speed, (speed - before) / PERIOD_S)[1].failure)
        before = speed
    return told


def test_who_falls_is_handed_to_the_autopilots_own_loops_within_half_a_second() -> None:
    controller = ardupilot(measures_thrust=False)
    told = sinking(controller, [0.1 * k for k in range(40)])  # 3 m/s² down
    first = next(k for k, words in enumerate(told) if words)
    assert 0.3 < first * PERIOD_S <= 0.55
    assert "faster than planned" in told[first]
    setpoint, report = step(controller, 40 * PERIOD_S, 3.9)
    assert setpoint.attitude is None  # and stays so while it sinks
    assert report.failure == told[-1]


def test_who_was_caught_is_flown_by_thrust_again() -> None:
    """By the thrust that the autopilot has caught it with, once that is known."""
    controller = ardupilot(measures_thrust=False)
    sinking(controller, [0.1 * k for k in range(40)])
    step(controller, 40 * PERIOD_S, -0.1, -5.0)
    setpoint, report = step(controller, 41 * PERIOD_S, -0.1)
    assert setpoint.attitude is not None
    assert report.failure == ""


@pytest.mark.parametrize(
    "speeds_m_s",
    [
        [0.4] * 60,
        [1.5 - 0.1 * k for k in range(15)],  # it is braked
        [0.1 * k for k in range(8)] + [0.8 - 0.1 * k for k in range(8)],  # a gust
    ],
)
def test_who_sinks_a_little_is_braked_or_pushed_for_a_moment_does_not_fall(speeds_m_s: list[float]) -> None:
    assert set(sinking(ardupilot(measures_thrust=False), speeds_m_s)) == {""}


def test_by_the_autopilots_own_height_loop_a_fall_is_its_own_business() -> None:
    assert set(sinking(ardupilot("acceleration"), [0.1 * k for k in range(40)])) == {""}
