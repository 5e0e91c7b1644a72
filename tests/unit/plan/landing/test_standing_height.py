"""The leg height as echo and pad measure it, standing disarmed before take-off."""

from dataclasses import replace

import pytest

from companion.base import second_sources
from companion.base.geometry import ZERO3
from companion.base.messages import AutopilotState, Phase, Quantity
from companion.base.motion import Motion
from companion.config import GuidanceConfig, LandingConfig, TouchdownConfig
from companion.plan.inputs import PlanInputs
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.landing.success import SuccessEstimate
from companion.plan.landing.touchdown import TouchdownSequence
from companion.plan.mission.states import State
from companion.plan.planner import Planner
from companion.plan.steering import touch_down
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import LEG_M, STEP_S, TABLE, VEHICLE, PlanWorld


def stood(
    leg_m: float,
    *,
    echo_m: float | None = None,
    on_pad: bool = False,
    lasts_s: float = 6.0,
) -> tuple[StandingHeight, PlanWorld]:
    """After `lasts_s` on the ground: the true standing height is LEG_M, the file says `leg_m`."""
    w = world(still())
    w.echo_m, w.range_lost = echo_m, echo_m is None
    w.blind = lambda _t, _height: not on_pad
    if on_pad:
        w.pad = lambda _t: (0.0, 0.0, 0.0)
    height = StandingHeight(VEHICLE.model_copy(update={"leg_height_m": leg_m}))
    for _ in range(round(lasts_s / STEP_S)):
        w.acceleration = ZERO3
        height.update(w.inputs(), w.now_s)
        w.autopilot.ready_from_s = 1e9  # it stays on the ground
        w.cycle()
    return height, w


ECHO_M = LEG_M - VEHICLE.range_position_body_m[2]


@pytest.mark.parametrize(("wrong_m", "refused"), [(0.0, False), (0.04, False), (-0.04, False), (0.08, True)])
def test_an_echo_before_take_off_says_whether_the_leg_height_is_right(wrong_m: float, refused: bool) -> None:
    height, _ = stood(LEG_M + wrong_m, echo_m=ECHO_M)
    assert height.measured_m["the rangefinder"][0] == pytest.approx(LEG_M)
    assert [words for _, words in second_sources.refused(height.comparisons)] == (
        [
            "leg height: the vehicle's file 26 cm, measured where it stands 18 cm by the rangefinder: "
            "8.0 ±0.0 cm apart, limit 5: measure from the centre of mass to the feet, and "
            "range_position_body_m"
        ]
        if refused
        else []
    )


# the autopilot, and so that it is disarmed, is heard after a second
@pytest.mark.parametrize(("lasts_s", "measured"), [(2.8, False), (3.2, True)])
def test_what_was_heard_during_two_seconds_of_rest_counts_as_they_end(lasts_s: float, measured: bool) -> None:
    height, _ = stood(LEG_M + 0.03, echo_m=ECHO_M, lasts_s=lasts_s)
    assert bool(height.measured_m) is measured


def test_what_was_measured_on_a_bench_says_nothing_on_the_ground_where_no_echo_comes() -> None:
    height, w = stood(LEG_M, echo_m=ECHO_M + 0.8)
    assert list(second_sources.refused(height.comparisons))
    w.range_lost = True
    for k in range(round(5.0 / STEP_S)):
        w.acceleration = (0.0, 0.0, 1.0) if k < 10 else ZERO3  # carried from there
        height.update(w.inputs(), w.now_s)
        w.cycle()
    assert height.comparisons == ()


def test_the_pad_beneath_says_it_too_and_without_either_it_is_not_refused() -> None:
    by_pad, _ = stood(LEG_M - 0.08, on_pad=True)
    assert by_pad.measured_m["the pad"][0] == pytest.approx(LEG_M, abs=1e-6)
    [(quantity, words)] = second_sources.refused(by_pad.comparisons)
    assert quantity is Quantity.LEG_HEIGHT
    assert "18 cm by the pad: 8.0" in words
    neither, _ = stood(LEG_M - 0.08)
    assert neither.comparisons == ()


def test_what_is_measured_counts_beside_the_file_by_its_variance() -> None:
    neither, _ = stood(LEG_M - 0.03)
    by_echo, _ = stood(LEG_M - 0.03, echo_m=ECHO_M)
    by_pad, _ = stood(LEG_M - 0.03, on_pad=True)
    heights = [height.vehicle.leg_height_m for height in (neither, by_echo, by_pad)]
    assert heights == pytest.approx([LEG_M - 0.03, LEG_M - 0.015, LEG_M - 0.003], abs=1e-6)


def test_a_try_begins_with_what_was_measured_until_then() -> None:
    """Legs 3 cm longer than the file says: it waits higher, and goes level for a sooner contact."""
    height, _ = stood(LEG_M, on_pad=True)
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 0.4, 20, 0.1)
    height.measured_m["the pad"] = (LEG_M + 0.03, 0.0)
    generator.start("pad", Motion((0.0, 0.0, -1.0), ZERO3), 0.0)
    config = TouchdownConfig()
    success = SuccessEstimate(config)
    sequence = TouchdownSequence(config, LandingConfig(), generator, height, 0.5, success, 0.0)
    touch_down(sequence, State.WAIT, None, PlanInputs(None, None, AutopilotState(0.0)), 0.0)
    end = generator.at(20.0).position_m[2]
    assert end == pytest.approx(-(LEG_M + 0.027 + 0.35), abs=1e-3)


def test_carried_or_armed_it_measures_nothing() -> None:
    carried, w = world(still()), StandingHeight(VEHICLE)
    carried.echo_m = 1.2
    for k in range(180):
        carried.cycle()
        carried.autopilot.ready_from_s, carried.autopilot.armed = 1e9, k > 90
        carried.acceleration = (0.0, 0.0, 0.0 if carried.autopilot.armed else 0.6)
        w.update(carried.inputs(), carried.now_s)
    assert w.measured_m == {}


def test_a_wrong_leg_height_is_waited_for_on_the_ground_and_refuses_an_order() -> None:
    height, w = stood(LEG_M + 0.08, echo_m=ECHO_M)
    w.autopilot.ready_from_s = 0.0
    w.planner = Planner(w.config, VEHICLE, 20, 0.1, TABLE, standing_height=height)  # of a later mission
    given = replace(w.inputs(), comparisons=height.comparisons)
    step = w.planner.step(given, w.now_s)
    assert step.phase is Phase.CONNECT
    assert "the vehicle's file 26 cm" in next(n.text for n in step.notices if n.kind == "waiting")
    assert any("the vehicle's file 26 cm" in words for words in w.planner.not_ready(given, w.now_s))
