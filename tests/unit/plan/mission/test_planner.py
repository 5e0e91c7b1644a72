"""The planner in a closed loop: whole missions that go well."""

import math

import numpy as np
import pytest

from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import ActionKind, Phase, PlanStep
from companion.config import MissionConfig, PlanConfig
from tests.unit.plan.mission.planner_world import GOOD, world
from tests.unit.plan.pad_paths import Path, circle, figure_eight, heave, line, still
from tests.unit.plan.plan_autopilot import HOME, PlanAutopilot
from tests.unit.plan.plan_harness import LEG_M, ORIGIN_NED_M, PlanFlight, PlanWorld

PADS: dict[str, Path] = {
    "still": still(),
    "line": line(),
    "circle": circle(),
    "figure eight": figure_eight(),
    "heave": heave(),
}


def breeze(t: float) -> Vector3:
    """Gusts as a disturbance of acceleration (m/s²), after what a controller already takes out."""
    return (
        0.12 * math.sin(1.3 * t + 0.4) + 0.1 * math.sin(3.1 * t),
        0.12 * math.sin(1.1 * t + 2.0),
        0.1 * math.sin(2.0 * t + 1.0),
    )


def continuous(flight: PlanFlight) -> tuple[float, float, float]:
    """Largest steps of the reference's position, velocity and acceleration between cycles of one phase.

    Rows lie 0.1 s apart, cycles 0.033 s: what lies between is interpolated, hence not quite 0.
    """
    worst = [0.0, 0.0, 0.0]
    for before, after in zip(flight.steps, flight.steps[1:], strict=False):
        a, b = before.reference, after.reference
        if a is None or b is None or a.origin != b.origin or before.on_ground != after.on_ground:
            continue
        k = (b.time_s - a.time_s) / a.step_s
        for i, name in enumerate(("position_m", "velocity_m_s", "acceleration_m_s2")):
            rows = getattr(a, name)
            expected = rows[0] * (1.0 - k) + rows[1] * k
            worst[i] = max(worst[i], float(np.linalg.norm(getattr(b, name)[0] - expected)))
    return worst[0], worst[1], worst[2]


@pytest.mark.parametrize("name", list(PADS))
def test_it_lands_softly_on_the_middle_of_a_pad(name: str) -> None:
    flight = world(PADS[name]).fly(90.0)
    assert [phase for _, phase in flight.phases] == GOOD
    assert flight.touch_lateral_m < 0.03
    assert 0.1 < flight.touch_down_m_s < 0.3
    assert flight.touch_across_m_s < 0.05
    assert flight.end_s < 60.0


@pytest.mark.parametrize("name", list(PADS))
def test_it_lands_with_noise_and_gusts(name: str) -> None:
    w = world(PADS[name])
    w.noise_m, w.gust, w.rng = 0.02, breeze, np.random.default_rng(7)
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    assert flight.touch_lateral_m < 0.12
    assert flight.touch_down_m_s < 0.4
    assert flight.touch_across_m_s < 0.3


def test_it_lands_under_ardupilot_where_setpoints_are_obeyed_at_once() -> None:
    w = world()
    w.autopilot = PlanAutopilot(autopilot_kind="ardupilot", mode="STABILIZE")
    assert w.fly(90.0).phase is Phase.LANDED


def test_the_same_flight_twice_gives_the_same_references_to_the_bit() -> None:
    flights = []
    for _ in range(2):
        w = world(figure_eight())
        w.noise_m, w.rng = 0.02, np.random.default_rng(5)
        flights.append(w.fly(60.0))
    for a, b in zip(flights[0].steps, flights[1].steps, strict=True):
        assert a.phase is b.phase
        assert (a.reference is None) == (b.reference is None)
        if a.reference is not None and b.reference is not None:
            assert np.array_equal(a.reference.position_m, b.reference.position_m)


def test_the_reference_never_steps_once_over_the_pad() -> None:
    flight = world().fly(90.0)
    flight.steps = [s for s in flight.steps if s.time_s > flight.entered(Phase.APPROACH) + 0.05]
    position, velocity, acceleration = continuous(flight)
    assert position < 0.02
    assert velocity < 0.03
    assert acceleration < 0.08


def test_the_vehicle_goes_where_the_waypoint_is_from_home_not_from_our_origin() -> None:
    asked: list[Vector3] = []
    w = world(still(200.0, 200.0))

    def each(_: PlanWorld, step: PlanStep) -> None:
        asked.extend(a.position for a in step.actions if a.kind is ActionKind.GO_TO and a.position)

    w.each = each
    w.fly(40.0, until=lambda x: x.flight.phases != [] and x.flight.phase is Phase.SEARCH)
    latitude, longitude, height = asked[0]
    assert ned_from_geodetic(latitude, longitude, HOME[2], HOME)[:2] == pytest.approx((10.0, 0.0), abs=1e-3)
    assert height == 7.0
    assert math.hypot(w.position[0] - 10.0, w.position[1]) < 1.5
    assert math.hypot(*ORIGIN_NED_M) > 2.0


def test_setpoints_stream_before_control_is_asked_and_none_before_the_search() -> None:
    flight = world().fly(90.0)
    first = next(s.time_s for s in flight.steps if s.reference is not None)
    asked = next(s.time_s for s in flight.steps for a in s.actions if a.kind is ActionKind.TAKE_CONTROL)
    assert first == pytest.approx(flight.entered(Phase.SEARCH), abs=0.04)
    assert asked - first >= 0.5


def test_over_the_pad_it_stays_above_the_floor_it_tells_the_controller() -> None:
    flight = world(heave()).fly(90.0)
    for step, height in zip(flight.steps, flight.heights_m, strict=True):
        if step.phase in {Phase.APPROACH, Phase.DESCEND}:
            assert step.reference is not None
            assert step.reference.minimum_height_m is not None
            assert LEG_M < step.reference.minimum_height_m < height
        elif step.reference is not None:
            assert step.reference.minimum_height_m is None


def test_a_descent_tells_the_controller_its_cone_until_it_is_committed() -> None:
    flight = world(line()).fly(90.0)
    told = {
        phase: [s.reference.cone for s in flight.steps if s.phase is phase and s.reference is not None]
        for phase in (Phase.SEARCH, Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN)
    }
    assert not any(told[Phase.SEARCH] + told[Phase.APPROACH])
    # the cycle in which a phase ends is already steered by the next
    assert all(told[Phase.DESCEND])
    assert told[Phase.TOUCHDOWN][0] is not None
    assert told[Phase.TOUCHDOWN][-1] is None


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_it_lands_in_the_pads_heading(heading_deg: float) -> None:
    w = PlanWorld(still(), heading=lambda _t: math.radians(heading_deg))
    flight = w.fly(90.0)
    last = next(s.reference for s in reversed(flight.steps) if s.reference is not None)
    assert math.remainder(last.heading_rad - math.radians(heading_deg), math.tau) == pytest.approx(
        0.0, abs=0.02
    )


def test_it_keeps_its_heading_when_it_shall_not_align() -> None:
    flight = world(still(), PlanConfig(mission=MissionConfig(align_heading=False))).fly(90.0)
    headings = [s.reference.heading_rad for s in flight.steps if s.reference]
    assert headings == pytest.approx([1.2] * len(headings))


def test_on_the_pad_it_says_so_and_disarms_once_the_autopilot_agrees() -> None:
    w = world()
    flight = w.fly(90.0)
    contact = next(s.time_s for s in flight.steps if s.on_ground)
    assert flight.touch_s is not None
    assert abs(contact - flight.touch_s) < 0.25
    disarm = next(t for t, kind in w.autopilot.heard if kind is ActionKind.DISARM)
    assert disarm > contact
    assert not w.autopilot.armed
    assert flight.steps[-1].reference is None
    assert flight.told("contact")


def test_an_autopilot_that_never_finds_itself_landed_is_disarmed_by_force_and_never_ordered_to_land() -> None:
    w = world(heave())
    flight = w.fly(60.0, until=lambda x: x.flight.told("commit") != [])
    w.autopilot.doubts = True
    w.fly(30.0)
    assert flight.phase is Phase.LANDED
    contact = next(s.time_s for s in flight.steps if s.on_ground)
    last = {a.kind: (s.time_s, a.force) for s in flight.steps for a in s.actions}
    assert ActionKind.LAND not in last  # PX4's brakes against a pad that moves, and tips over
    assert last[ActionKind.DISARM][0] - contact == pytest.approx(1.0, abs=0.1)
    assert last[ActionKind.DISARM][1]


def test_a_pad_that_jolts_the_vehicle_now_and_then_is_stood_on_all_the_same() -> None:
    w = world(heave())
    flight = w.fly(60.0, until=lambda x: x.flight.told("commit") != [])
    w.autopilot.doubts = True
    w.jolted = lambda now_s: math.fmod(now_s, 1.8) < 0.05
    w.fly(30.0)
    assert flight.phase is Phase.LANDED
    assert ActionKind.LAND not in {a.kind for s in flight.steps for a in s.actions}


def test_an_autopilot_that_nothing_shows_to_be_down_is_let_land() -> None:
    w = world(still())
    flight = w.fly(60.0, until=lambda x: bool(x.flight.steps) and x.flight.steps[-1].on_ground)
    w.autopilot.doubts = True
    w.blind = lambda _t, _h: True
    w.echo_m = 1.0
    contact = w.now_s
    w.fly(10.0)
    last = {a.kind: s.time_s for s in flight.steps for a in s.actions}
    assert last[ActionKind.LAND] - contact == pytest.approx(4.0, abs=0.1)
    assert ActionKind.DISARM not in last
