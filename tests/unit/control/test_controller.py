"""The controller's step: what leaves in which situation."""

import math
from dataclasses import replace
from itertools import count, pairwise

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    norm,
    quat_from_euler,
    subtract,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.base.messages import AutopilotSetup, LinkHealth, Phase, Setpoint
from companion.config import ControlConfig
from companion.control.attitude import attitude_from_acceleration
from companion.control.controller import Controller
from companion.control.solver_health import FAILURES_TO_STOP
from tests.unit.control.control_plants import controller, reference_rows, vehicle_config
from tests.unit.control.controller_inputs import (
    PERIOD_S,
    answered,
    hover_reference,
    pad_state,
    plan_step,
    vehicle_state,
)


def test_without_a_reference_nothing_leaves() -> None:
    assert controller().step(plan_step(0.0, None), vehicle_state(0.0), pad_state(0.0), 0.0) is None


def test_straight_above_the_pad_it_stays() -> None:
    setpoint, report = answered(controller())
    assert report.solved
    assert setpoint.velocity_ned_m_s == pytest.approx(ZERO3, abs=2e-3)
    assert setpoint.acceleration_ned_m_s2 == pytest.approx(ZERO3, abs=2e-2)


def test_thrust_that_the_feet_are_to_carry_is_taken_away() -> None:
    full, less = (
        answered(controller(setpoint="attitude"), unloading=share)[0].thrust for share in (0.0, 0.4)
    )
    assert full is not None
    assert less == pytest.approx(0.6 * full)


def test_to_an_autopilot_that_chooses_the_thrust_it_is_an_acceleration_downwards() -> None:
    setpoint, _ = answered(controller(setpoint="velocity"), unloading=0.2)
    assert setpoint.acceleration_ned_m_s2[2] == pytest.approx(0.2 * GRAVITY_M_S2, abs=0.05)


def test_thrust_that_was_taken_away_comes_back_at_once() -> None:
    flown = []
    for share in (0.0, 0.3):
        fly = controller(setpoint="attitude")
        for k in range(8):
            setpoint, _ = answered(fly, k * PERIOD_S, unloading=share if 2 <= k < 7 else 0.0)
        flown.append(setpoint.thrust or 0.0)
    assert flown[1] > 0.99 * flown[0] > 0.0  # what it has begun to fall by is met as well


def test_what_was_asked_for_as_thrust_was_taken_away_is_nothing_to_the_next_take_over() -> None:
    fly = controller(setpoint="attitude")
    for k in range(20):  # a deck that comes up: it asks for a climb
        now = k * PERIOD_S
        answered(fly, now, pad=pad_state(now, (0.0, 0.0, 1.3)), unloading=0.2)
    setpoint, _ = answered(fly, 60.0)
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
        reference = hover_reference(now, heading_rad=1.0)
        setpoint, _ = answered(fly, now, reference=reference, vehicle=vehicle, pad=pad_state(now, towards))
    acceleration = setpoint.acceleration_ned_m_s2
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
    setpoint, _ = answered(controller(), vehicle=vehicle, pad=pad)
    assert setpoint.velocity_ned_m_s == pytest.approx((1.5, -0.5, 0.0), abs=0.01)


def test_setpoints_by_the_pad_tell_the_exposure_and_local_ones_do_not() -> None:
    by_pad, _ = answered(controller(), 1.0)
    local, _ = answered(controller(), 1.0, reference=hover_reference(1.0, "local"))
    assert by_pad.exposure_time_s == pytest.approx(0.93)
    assert local.exposure_time_s is None


def test_local_references_go_by_the_vehicles_own_position() -> None:
    place = ((10.0, -4.0, -7.0), ZERO3, ZERO3)
    reference = reference_rows(0.0, lambda _t: place, origin="local")
    setpoint, report = answered(controller(), reference=reference, seen=False)
    assert setpoint.velocity_ned_m_s == pytest.approx(ZERO3, abs=2e-3)
    np.testing.assert_allclose(report.predicted_position_m[-1], (10.0, -4.0, -7.0), atol=5e-3)


def test_on_the_ground_it_goes_along_with_the_pad_and_presses_down() -> None:
    pad = pad_state(0.0, (0.0, 0.0, 0.18), (1.0, 0.5, 0.2))
    setpoint, _ = answered(controller(), pad=pad, on_ground=True)
    assert setpoint.velocity_ned_m_s == (1.0, 0.5, ControlConfig().ground_descent_m_s)
    assert setpoint.acceleration_ned_m_s2[2] >= 0.0
    assert setpoint.attitude is None
    without, _ = answered(controller(), seen=False, on_ground=True)
    assert without.velocity_ned_m_s == (0.0, 0.0, ControlConfig().ground_descent_m_s)


def test_on_the_ground_by_attitude_it_is_level_without_thrust() -> None:
    setpoint, report = answered(controller(setpoint="attitude"), on_ground=True)
    assert setpoint.attitude is not None
    assert tilt_from_quat(setpoint.attitude) == pytest.approx(0.0, abs=1e-9)
    assert setpoint.thrust == 0.0  # which the gate's least thrust does not forbid here
    assert report.limited == ()


def test_taking_off_from_the_ground_again_begins_without_old_commands() -> None:
    fly = controller()
    for k in range(10):
        answered(fly, k * PERIOD_S, on_ground=True)
    _, report = answered(fly, 10 * PERIOD_S)
    assert (report.solved, report.disturbance_ned_m_s2) == (True, ZERO3)


def test_the_heading_turns_at_the_allowed_rate_from_where_the_vehicle_looks() -> None:
    fly, start = controller(), 0.8
    for k in range(16):
        now = k * PERIOD_S
        vehicle = vehicle_state(now, attitude=quat_from_euler(0.1, -0.05, start))
        setpoint, _ = answered(fly, now, reference=hover_reference(now, heading_rad=3.0), vehicle=vehicle)
        assert setpoint.heading_rad == pytest.approx(start + math.radians(90.0) * now)
    assert 0.3 < setpoint.heading_rate_rad_s <= math.radians(90.0)


def test_by_attitude_the_heading_is_in_the_attitude() -> None:
    vehicle = vehicle_state(0.0, attitude=quat_from_euler(0.0, 0.0, 2.0))
    reference = hover_reference(0.0, heading_rad=2.0)
    setpoint, _ = answered(controller(setpoint="attitude"), reference=reference, vehicle=vehicle)
    assert setpoint.attitude is not None
    assert yaw_from_quat(setpoint.attitude) == pytest.approx(2.0)


def test_taking_over_in_wind_by_attitude_keeps_the_tilt() -> None:
    tilt = quat_from_euler(0.0, -0.1, 0.0)  # nose down, and yet no acceleration
    setpoint, _ = answered(controller(setpoint="attitude"), vehicle=vehicle_state(0.0, attitude=tilt))
    assert setpoint.attitude == pytest.approx(tilt, abs=5e-3)


def test_an_older_estimate_is_carried_forward() -> None:
    # the pad was estimated 0.1 s ago; since then the vehicle came 0.1 m nearer
    old = replace(pad_state(0.0, (0.1, 0.0, 2.0)), relative_velocity_ned_m_s=(-1.0, 0.0, 0.0), time_s=-0.1)
    new = replace(pad_state(0.0, (0.0, 0.0, 2.0)), relative_velocity_ned_m_s=(-1.0, 0.0, 0.0))
    vehicle = vehicle_state(0.0, velocity_ned_m_s=(1.0, 0.0, 0.0))
    by_old, by_new = (answered(controller(), vehicle=vehicle, pad=pad)[0] for pad in (old, new))
    assert by_old.velocity_ned_m_s == pytest.approx(by_new.velocity_ned_m_s, abs=1e-3)


@pytest.mark.parametrize(
    ("autopilot_kind", "thrust"), [("px4", 0.5 / math.cos(0.4)), ("ardupilot", 0.5)], ids=["px4", "ardupilot"]
)
def test_by_attitude_ardupilot_gets_the_upward_part_alone_since_it_raises_it_itself(
    autopilot_kind: AutopilotKind, thrust: float
) -> None:
    vehicle = vehicle_state(0.0, attitude=quat_from_euler(0.0, -0.4, 0.0))
    stay = reference_rows(0.0, lambda _t: (vehicle.position_ned_m, ZERO3, ZERO3), origin="local")
    fly = Controller(ControlConfig(setpoint="attitude"), vehicle_config(), autopilot_kind=autopilot_kind)
    setpoint, _ = answered(fly, reference=stay, vehicle=vehicle, seen=False)
    assert setpoint.thrust == pytest.approx(thrust, abs=0.005)


# ----------------
# The controller's step without an estimate, a pad, the IMU or a solution in time, and after pauses.


def test_a_reference_by_the_pad_without_a_pad_is_a_stop() -> None:
    fly, speed, flown = controller(), 1.0, 0.0
    for k in range(150):
        now = k * PERIOD_S
        vehicle = vehicle_state(
            now, velocity_ned_m_s=(speed, 0.0, 0.0), acceleration_ned_m_s2=(flown, 0.0, 0.0)
        )
        setpoint, _ = answered(fly, now, vehicle=vehicle, seen=False)
        assert setpoint.exposure_time_s is None
        # an autopilot's velocity loop, and the lag of tilting
        wanted = setpoint.acceleration_ned_m_s2[0] + 2.5 * (setpoint.velocity_ned_m_s[0] - speed)
        flown += (wanted - flown) * PERIOD_S / 0.2
        speed += flown * PERIOD_S
        assert speed < 1.05
    assert abs(speed) < 0.05


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
def test_an_estimate_that_is_no_number_ends_in_a_hold_and_is_survived(kind: str) -> None:
    fly = controller(setpoint=kind)
    broken = vehicle_state(0.0, velocity_ned_m_s=(math.nan, 0.0, 0.0), position_ned_m=(math.nan, 0.0, 0.0))
    lost = replace(pad_state(0.0), relative_position_ned_m=(math.nan, math.nan, math.nan))
    for k in range(40):
        now = k * PERIOD_S
        bad = 10 <= k < 20
        vehicle = replace(broken if bad else vehicle_state(now), time_s=now)
        pad = replace(lost if bad else pad_state(now), time_s=now)
        setpoint, report = answered(fly, now, vehicle=vehicle, pad=pad)
        assert _all_finite(setpoint)
        assert report.solved is not bad
    assert norm(setpoint.velocity_ned_m_s) < 0.05


def test_after_a_pause_all_begins_anew() -> None:
    fly = controller()
    for k in range(20):
        answered(fly, k * PERIOD_S, pad=pad_state(k * PERIOD_S, (1.0, 0.0, 3.0)))
    (again, later), (first, fresh) = (
        answered(each, 60.0, pad=pad_state(60.0, (0.3, 0.0, 2.0))) for each in (fly, controller())
    )
    assert again.velocity_ned_m_s == pytest.approx(first.velocity_ned_m_s, abs=1e-4)
    assert again.acceleration_ned_m_s2 == pytest.approx(first.acceleration_ned_m_s2, abs=1e-3)
    assert later.disturbance_ned_m_s2 == fresh.disturbance_ned_m_s2 == ZERO3


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
def test_without_the_imu_it_is_reported_not_to_accelerate_until_samples_come_again(kind: str) -> None:
    fly = controller(setpoint=kind)
    drifting = (1.0, -0.5, 0.4)
    silent_from, silent_to = 10, 24
    for k in range(30):
        now = k * PERIOD_S
        silent = silent_from <= k < silent_to
        vehicle = vehicle_state(now, velocity_ned_m_s=drifting, imu_age_s=0.12 if silent else 0.004)
        setpoint, report = answered(fly, now, vehicle=vehicle, pad=pad_state(now, (3.0, 0.0, 2.0)))
        assert report.blind is silent
        if k != silent_to - 1:  # the limits let it come down from what was commanded before
            continue
        # its own loops feel what we do not
        assert setpoint.attitude is None
        assert setpoint.velocity_ned_m_s == pytest.approx((1.0, -0.5, 0.0))
        assert setpoint.acceleration_ned_m_s2 == pytest.approx(ZERO3)
    assert report.solved


def test_without_the_imu_px4_keeps_the_tilt_and_goes_on_down_where_contact_is_near() -> None:
    fly = controller(setpoint="acceleration")
    sinking = replace(hover_reference(0.0), velocity_m_s=np.full_like(hover_reference(0.0).velocity_m_s, 0.2))
    for phase, sink_m_s in ((Phase.DESCEND, 0.0), (Phase.TOUCHDOWN, 0.4)):  # as firmly as it ever sinks
        for k in range(10):
            now = k * PERIOD_S
            vehicle = vehicle_state(now, velocity_ned_m_s=(1.0, 0.0, 0.2), imu_age_s=0.2)
            pad = pad_state(now, velocity=(1.0, 0.0, 0.1))  # it sinks itself: the reference counts from it
            reference = replace(sinking, time_s=now)
            setpoint, _ = answered(fly, now, reference=reference, vehicle=vehicle, pad=pad, phase=phase)
        # its velocity loop, whose integral is from another wind, stays passed by
        assert not setpoint.holds_horizontal_velocity
        assert setpoint.acceleration_ned_m_s2 == pytest.approx(ZERO3, abs=1e-9)
        assert setpoint.velocity_ned_m_s[2] == pytest.approx(sink_m_s)


@pytest.mark.parametrize("kind", ["acceleration", "velocity", "attitude"])
def test_without_the_imu_it_turns_with_the_pad_that_it_sinks_onto(kind: str) -> None:
    fly = controller(setpoint=kind)
    level = hover_reference(0.0)
    sinking = replace(level, velocity_m_s=np.full_like(level.velocity_m_s, 0.2))
    for reference, acceleration in ((level, ZERO3), (sinking, (0.0, -0.45, 0.0))):
        for k in range(40):  # the limits let it turn only so fast
            now = k * PERIOD_S
            flown = replace(reference, time_s=now)
            vehicle = vehicle_state(now, velocity_ned_m_s=(1.4, 0.1, 0.2), imu_age_s=0.2)
            pad = replace(pad_state(now, velocity=(1.5, 0.0, 0.0)), acceleration_ned_m_s2=(0.0, -0.45, 0.3))
            phase = Phase.TOUCHDOWN
            setpoint, _ = answered(fly, now, reference=flown, vehicle=vehicle, pad=pad, phase=phase)
        followed = acceleration != ZERO3
        assert setpoint.velocity_ned_m_s[:2] == pytest.approx((1.5, 0.0) if followed else (1.4, 0.1))
        assert setpoint.attitude is None
        assert setpoint.acceleration_ned_m_s2 == pytest.approx(acceleration, abs=1e-9)
        assert setpoint.holds_horizontal_velocity is (kind != "acceleration")


def test_without_the_imu_it_stays_with_a_pad_that_rises() -> None:
    fly, reference = controller(setpoint="acceleration"), hover_reference(0.0)
    vehicle = vehicle_state(0.0, imu_age_s=0.2)
    sinking = replace(reference, velocity_m_s=np.full_like(reference.velocity_m_s, 0.2))
    pad = replace(pad_state(0.0, velocity=(1.5, 0.0, -0.5)), acceleration_ned_m_s2=(0.0, -0.4, 0.0))
    setpoint, _ = answered(fly, reference=sinking, vehicle=vehicle, pad=pad, phase=Phase.TOUCHDOWN)
    assert setpoint.velocity_ned_m_s == pytest.approx((1.5, 0.0, -0.2))
    assert setpoint.acceleration_ned_m_s2[1] == pytest.approx(-0.4)


def test_without_an_estimate_only_what_presses_it_onto_the_pad_is_sent() -> None:
    fly = controller()
    plan = plan_step(0.0, hover_reference(0.0))
    assert fly.step(plan, None, None, 0.0) is None
    answer = fly.step(replace(plan, on_ground=True), None, None, 0.0)
    assert answer is not None
    assert answer[0].velocity_ned_m_s[2] > 0.0


def test_without_the_imu_it_goes_on_tilting_against_the_wind() -> None:
    fly = controller(setpoint="acceleration")
    tilt = quat_from_euler(0.0, -0.1, 0.0)  # nose down, and yet no acceleration
    for k in range(90):
        now = k * PERIOD_S
        answered(fly, now, vehicle=vehicle_state(now, attitude=tilt))
    for _ in range(15):
        now += PERIOD_S
        setpoint, report = answered(fly, now, vehicle=vehicle_state(now, attitude=tilt, imu_age_s=0.2))
    assert report.blind
    assert attitude_from_acceleration(setpoint.acceleration_ned_m_s2, 0.0) == pytest.approx(tilt, abs=0.02)


def test_a_stopwatch_times_the_solve_and_none_is_needed() -> None:
    ticks = count(1.0, 0.25)  # read before and after; at rest nothing has to be searched for
    assert answered(controller(lambda: next(ticks)))[1].solve_s == pytest.approx(0.25)
    assert answered(controller())[1].solve_s == 0.0


def _all_finite(setpoint: Setpoint) -> bool:
    numbers = [*setpoint.velocity_ned_m_s, *setpoint.acceleration_ned_m_s2, setpoint.heading_rad]
    numbers += [*(setpoint.attitude or ()), setpoint.thrust or 0.0]
    return all(map(math.isfinite, numbers))


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
def test_a_solver_that_is_always_too_late_is_flown_by_its_last_plan_and_then_stopped(kind: str) -> None:
    seconds, slow = count(0.0, 1.0), [False]
    fly = controller(lambda: next(seconds) if slow[0] else 0.0, setpoint=kind)
    reports = []
    for k in range(6 + FAILURES_TO_STOP):
        now_s = k * PERIOD_S
        slow[0] = k >= 5
        # what no solver settles in one slice: a reference that jumps, from beyond the limits
        wild = reference_rows(now_s, _jumping) if slow[0] else hover_reference(now_s)
        speed = (7.0 * (-1.0) ** k, 3.0, 2.0) if slow[0] else ZERO3
        vehicle = vehicle_state(now_s, velocity_ned_m_s=speed)
        setpoint, report = answered(fly, now_s, reference=wild, vehicle=vehicle)
        reports.append(report)
    assert all(report.solved and not report.late for report in reports[:5])
    assert not any(report.solved for report in reports[5:])
    assert [report.stopped for report in reports] == [False] * (4 + FAILURES_TO_STOP) + [True] * 2
    assert setpoint.velocity_ned_m_s == ZERO3
    # by attitude as well: only the autopilot's own loops stop what no plan flies
    assert (setpoint.attitude, setpoint.thrust) == (None, None)
    assert setpoint.holds_horizontal_velocity


def _jumping(time_s: float) -> tuple[Vector3, Vector3, Vector3]:
    return (40.0 * round(math.sin(7.0 * time_s)), -40.0 * round(math.cos(5.0 * time_s)), -9.0), ZERO3, ZERO3


def test_what_was_no_number_at_the_very_first_is_survived_too() -> None:
    fly = controller(setpoint="acceleration")
    for k in range(40):
        now = k * PERIOD_S
        vehicle = (
            vehicle_state(now, acceleration_ned_m_s2=(math.nan, 0.0, 0.0)) if k < 5 else vehicle_state(now)
        )
        setpoint, report = answered(fly, now, vehicle=vehicle)
        assert not report.stopped
        assert _all_finite(setpoint)


@pytest.mark.parametrize("kind", ["acceleration", "attitude"])
def test_taking_over_keeps_the_tilt_however_long_the_setpoints_were_not_obeyed(kind: str) -> None:
    fly = controller(setpoint=kind)
    tilting = attitude_from_acceleration((1.5, -0.8, 0.0), 0.0)
    for k in range(40):
        now, obeyed = k * PERIOD_S, k >= 30
        vehicle = vehicle_state(now, attitude=tilting)
        setpoint, report = answered(fly, now, vehicle=vehicle, heard={"obeyed": obeyed})
        assert setpoint.acceleration_ned_m_s2 == pytest.approx((1.5, -0.8, 0.0), abs=0.05)
        assert report.obeyed is obeyed


@pytest.mark.parametrize("kind", ["acceleration", "attitude"])
def test_an_autopilot_that_is_not_heard_may_obey_and_its_setpoints_stay_within_the_jerk(kind: str) -> None:
    """The way to us alone may be lost. Once it is heard again, it is flown on from how it moves."""
    fly = controller(setpoint=kind)
    tilting = attitude_from_acceleration((1.5, -0.8, 0.0), 0.0)
    limits, last = ControlConfig().limits, None
    for k in range(90):
        now, silent_s = k * PERIOD_S, k * PERIOD_S if k < 60 else 0.0
        vehicle = vehicle_state(now, attitude=tilting)
        setpoint, _ = answered(fly, now, vehicle=vehicle, heard={"link": LinkHealth(silent_s)})
        asked = setpoint.acceleration_ned_m_s2
        if last is not None:
            assert norm(subtract(asked, last)) <= 1.01 * limits.jerk_m_s3 * PERIOD_S
        last = asked


@pytest.mark.parametrize("kind", ["acceleration", "attitude", "velocity"])
def test_what_a_silent_autopilot_does_not_do_is_no_disturbance(kind: str) -> None:
    """It may hold by itself since the link was lost; what is asked for in vain would throw it afterwards."""
    heeded, believed = controller(setpoint=kind), controller(setpoint=kind)
    for k in range(150):
        now = k * PERIOD_S
        pad, silent_s = pad_state(now, (3.0, 0.0, 3.0)), now - 0.3 if 0.3 <= now < 4.9 else 0.0
        _, unheard = answered(heeded, now, pad=pad, heard={"link": LinkHealth(silent_s)})
        _, heard = answered(believed, now, pad=pad)
    assert norm(heard.disturbance_ned_m_s2) > 1.0
    assert norm(unheard.disturbance_ned_m_s2) < 0.2


@pytest.mark.parametrize("obeyed", [False, True])
def test_a_tilt_limit_that_is_lowered_after_the_controller_was_made_is_kept(obeyed: bool) -> None:
    setup = AutopilotSetup(tilt_deg=45.0)
    fly = Controller(ControlConfig(), vehicle_config(), autopilot_kind="ardupilot", setup=setup)
    far, tilts = pad_state(0.0, (60.0, 0.0, 2.0)), []
    for k in range(60):
        now = k * PERIOD_S
        if k == 30:
            assert fly.fit(replace(setup, tilt_deg=15.0))
        assert not fly.fit(replace(setup, tilt_deg=15.0) if k >= 30 else setup)
        heard = {"obeyed": obeyed or k >= 30}
        setpoint, report = answered(fly, now, pad=replace(far, time_s=now), heard=heard)
        assert setpoint.attitude is not None
        assert report.solved
        tilts.append(math.degrees(tilt_from_quat(setpoint.attitude)))
    assert not obeyed or tilts[29] > 20.0
    assert 13.0 < max(tilts[40:]) <= 15.0
    # as the MPC plans it, not by the last gate, which holds back what was planned with more
    assert "tilt" not in report.limited
    # AND in flight without a jump
    most = math.degrees(ControlConfig().limits.jerk_m_s3 * PERIOD_S / GRAVITY_M_S2)
    assert not obeyed or max(abs(b - a) for a, b in pairwise(tilts)) <= 1.01 * most
