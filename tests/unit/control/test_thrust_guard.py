"""By attitude nothing is flown before the thrust that holds the vehicle is measured, nor in a fall."""

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import ZERO3
from companion.base.messages import AutopilotSetup, AutopilotState, ControlReport, LandedState, Setpoint
from companion.config import ControlConfig
from companion.control.controller import Controller
from tests.unit.control.control_plants import reference_rows, vehicle_config
from tests.unit.control.controller_inputs import plan_step, vehicle_state

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
    setpoint, report = step(controller, 40 * PERIOD_S)
    assert setpoint.attitude is None  # and stays so, whatever comes
    assert report.failure == told[-1]


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
