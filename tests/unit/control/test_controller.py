"""The controller's step: what leaves in which situation."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import ZERO3, quat_from_euler, tilt_from_quat, yaw_from_quat
from companion.config import ControlConfig
from companion.control.controller import Controller
from tests.unit.control.control_plants import controller, reference_rows, vehicle_config
from tests.unit.control.controller_inputs import (
    PERIOD_S,
    hover_reference,
    pad_state,
    plan_step,
    vehicle_state,
)


def test_without_a_reference_nothing_leaves() -> None:
    assert controller().step(plan_step(0.0, None), vehicle_state(0.0), pad_state(0.0), 0.0) is None


def test_straight_above_the_pad_it_stays() -> None:
    answer = controller().step(plan_step(0.0, hover_reference(0.0)), vehicle_state(0.0), pad_state(0.0), 0.0)
    assert answer is not None
    setpoint, report = answer
    assert report.solved
    assert setpoint.velocity_ned_m_s == pytest.approx(ZERO3, abs=2e-3)
    assert setpoint.acceleration_ned_m_s2 == pytest.approx(ZERO3, abs=2e-2)


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("kind", ["velocity", "attitude"])
def test_it_sets_out_towards_the_pad_whichever_way_the_vehicle_looks(direction_deg: float, kind: str) -> None:
    angle = math.radians(direction_deg)
    towards = (math.cos(angle), math.sin(angle), 2.0)
    fly = controller(setpoint=kind)
    for k in range(5):
        now = k * PERIOD_S
        vehicle = vehicle_state(now, attitude=quat_from_euler(0.0, 0.0, 1.0))
        answer = fly.step(
            plan_step(now, hover_reference(now, heading_rad=1.0)), vehicle, pad_state(now, towards), now
        )
    assert answer is not None
    acceleration = answer[0].acceleration_ned_m_s2
    assert (
        math.atan2(acceleration[1], acceleration[0])
        == pytest.approx(math.remainder(angle, math.tau), abs=0.1)
        or direction_deg == 180.0
    )
    assert acceleration[0] * towards[0] + acceleration[1] * towards[1] > 0.5


def test_a_pad_that_moves_is_followed_at_its_speed_at_once() -> None:
    # on station over the pad, and as fast as the pad
    pad = replace(pad_state(0.0, velocity=(1.5, -0.5, 0.0)), relative_velocity_ned_m_s=ZERO3)
    vehicle = vehicle_state(0.0, velocity_ned_m_s=(1.5, -0.5, 0.0))
    answer = controller().step(plan_step(0.0, hover_reference(0.0)), vehicle, pad, 0.0)
    assert answer is not None
    assert answer[0].velocity_ned_m_s == pytest.approx((1.5, -0.5, 0.0), abs=0.01)


def test_setpoints_by_the_pad_tell_the_exposure_and_local_ones_do_not() -> None:
    by_pad = controller().step(plan_step(1.0, hover_reference(1.0)), vehicle_state(1.0), pad_state(1.0), 1.0)
    local = controller().step(
        plan_step(1.0, hover_reference(1.0, "local")), vehicle_state(1.0), pad_state(1.0), 1.0
    )
    assert by_pad is not None
    assert local is not None
    assert by_pad[0].exposure_time_s == pytest.approx(0.93)
    assert local[0].exposure_time_s is None


def test_local_references_go_by_the_vehicles_own_position() -> None:
    place = ((10.0, -4.0, -7.0), ZERO3, ZERO3)
    reference = reference_rows(0.0, lambda _t: place, origin="local")
    answer = controller().step(plan_step(0.0, reference), vehicle_state(0.0), None, 0.0)
    assert answer is not None
    assert answer[0].velocity_ned_m_s == pytest.approx(ZERO3, abs=2e-3)
    np.testing.assert_allclose(answer[1].predicted_position_m[-1], (10.0, -4.0, -7.0), atol=5e-3)


def test_on_the_ground_it_goes_along_with_the_pad_and_presses_down() -> None:
    pad = pad_state(0.0, (0.0, 0.0, 0.18), (1.0, 0.5, 0.2))
    answer = controller().step(
        plan_step(0.0, hover_reference(0.0), on_ground=True), vehicle_state(0.0), pad, 0.0
    )
    assert answer is not None
    assert answer[0].velocity_ned_m_s == (1.0, 0.5, ControlConfig().ground_descent_m_s)
    assert answer[0].acceleration_ned_m_s2[2] >= 0.0
    assert answer[0].attitude is None
    without = controller().step(
        plan_step(0.0, hover_reference(0.0), on_ground=True), vehicle_state(0.0), None, 0.0
    )
    assert without is not None
    assert without[0].velocity_ned_m_s == (0.0, 0.0, ControlConfig().ground_descent_m_s)


def test_on_the_ground_by_attitude_it_is_level_without_thrust() -> None:
    fly = controller(setpoint="attitude")
    answer = fly.step(
        plan_step(0.0, hover_reference(0.0), on_ground=True), vehicle_state(0.0), pad_state(0.0), 0.0
    )
    assert answer is not None
    assert answer[0].attitude is not None
    assert tilt_from_quat(answer[0].attitude) == pytest.approx(0.0, abs=1e-9)
    assert answer[0].thrust == 0.0  # which the gate's least thrust does not forbid here
    assert answer[1].limited == ()


def test_taking_off_from_the_ground_again_begins_without_old_commands() -> None:
    fly = controller()
    for k in range(10):
        now = k * PERIOD_S
        fly.step(
            plan_step(now, hover_reference(now), on_ground=True), vehicle_state(now), pad_state(now), now
        )
    now = 10 * PERIOD_S
    answer = fly.step(plan_step(now, hover_reference(now)), vehicle_state(now), pad_state(now), now)
    assert answer is not None
    assert answer[1].solved
    assert answer[1].disturbance_ned_m_s2 == ZERO3


def test_the_heading_turns_at_the_allowed_rate_from_where_the_vehicle_looks() -> None:
    fly = controller()
    start = 0.8
    for k in range(16):
        now = k * PERIOD_S
        vehicle = vehicle_state(now, attitude=quat_from_euler(0.1, -0.05, start))
        answer = fly.step(plan_step(now, hover_reference(now, heading_rad=3.0)), vehicle, pad_state(now), now)
        assert answer is not None
        assert answer[0].heading_rad == pytest.approx(start + math.radians(90.0) * now)
    assert answer is not None
    assert 0.3 < answer[0].heading_rate_rad_s <= math.radians(90.0)


def test_by_attitude_the_heading_is_in_the_attitude() -> None:
    fly = controller(setpoint="attitude")
    vehicle = vehicle_state(0.0, attitude=quat_from_euler(0.0, 0.0, 2.0))
    answer = fly.step(plan_step(0.0, hover_reference(0.0, heading_rad=2.0)), vehicle, pad_state(0.0), 0.0)
    assert answer is not None
    assert answer[0].attitude is not None
    assert yaw_from_quat(answer[0].attitude) == pytest.approx(2.0)


def test_taking_over_in_wind_by_attitude_keeps_the_tilt() -> None:
    fly = controller(setpoint="attitude")
    tilt = quat_from_euler(0.0, -0.1, 0.0)  # nose down, and yet no acceleration
    answer = fly.step(
        plan_step(0.0, hover_reference(0.0)), vehicle_state(0.0, attitude=tilt), pad_state(0.0), 0.0
    )
    assert answer is not None
    assert answer[0].attitude is not None
    assert answer[0].attitude == pytest.approx(tilt, abs=5e-3)


def test_an_older_estimate_is_carried_forward() -> None:
    # the pad was estimated 0.1 s ago; since then the vehicle came 0.1 m nearer
    old = replace(pad_state(0.0, (0.1, 0.0, 2.0)), relative_velocity_ned_m_s=(-1.0, 0.0, 0.0), time_s=-0.1)
    new = replace(pad_state(0.0, (0.0, 0.0, 2.0)), relative_velocity_ned_m_s=(-1.0, 0.0, 0.0))
    vehicle = vehicle_state(0.0, velocity_ned_m_s=(1.0, 0.0, 0.0))
    by_old = controller().step(plan_step(0.0, hover_reference(0.0)), vehicle, old, 0.0)
    by_new = controller().step(plan_step(0.0, hover_reference(0.0)), vehicle, new, 0.0)
    assert by_old is not None
    assert by_new is not None
    assert by_old[0].velocity_ned_m_s == pytest.approx(by_new[0].velocity_ned_m_s, abs=1e-3)


def test_by_attitude_ardupilot_gets_the_upward_part_alone_since_it_raises_it_itself() -> None:
    vehicle = vehicle_state(0.0, attitude=quat_from_euler(0.0, -0.4, 0.0))
    stay = reference_rows(0.0, lambda _t: (vehicle.position_ned_m, ZERO3, ZERO3), origin="local")
    thrust: dict[str, float] = {}
    for autopilot_kind in ("px4", "ardupilot"):
        flown = Controller(
            ControlConfig(setpoint="attitude"), vehicle_config(), autopilot_kind=autopilot_kind
        )
        step = flown.step(plan_step(0.0, stay), vehicle, None, 0.0)
        assert step is not None
        assert step[0].thrust is not None
        thrust[autopilot_kind] = step[0].thrust
    assert thrust["ardupilot"] == pytest.approx(0.5, abs=0.005)
    assert thrust["px4"] == pytest.approx(0.5 / math.cos(0.4), abs=0.01)
