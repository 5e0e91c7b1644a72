"""The verdict: every outcome, and both sides of each bound."""

from __future__ import annotations

import dataclasses
from math import nan
from typing import Any

import numpy as np
import pytest

from companion.base.messages import Outcome, Phase
from sitl.pad.motion import build_pad_motion
from sitl.pad.paths import StaticMotion
from sitl.scenario.scenario import PassBounds
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.contact import NO_CONTACT, ContactLoad
from sitl.world.score import BOUNCE_M, TouchdownDetector, TouchdownState, Verdict, judge

GOOD = TouchdownState(
    time_s=40.0,
    lateral_error_m=0.04,
    vertical_speed_m_s=0.3,
    horizontal_speed_m_s=0.1,
    tilt_deg=2.0,
    yaw_error_deg=-5.0,
    pad_speed_m_s=1.0,
    impact_speed_m_s=0.32,
    on_pad=True,
    offset_pad_m=(0.04, 0.0),
)


def judged(*contacts: TouchdownState, crashed: bool = False, flown: bool = True, **values: Any) -> Verdict:
    watch = TouchdownDetector()
    watch.contacts, watch.crashed, watch.flown = list(contacts), crashed, flown
    flight = {"at_rest_on_pad": True, "disarmed": True, "final_phase": Phase.LANDED}
    return judge(watch, PassBounds(), **{**flight, **values})


def test_a_good_landing_is_landed_and_reported() -> None:
    verdict = judged(GOOD)
    assert verdict.outcome is Outcome.LANDED
    assert verdict.failures == ()
    assert list((verdict.touchdown or {}).values()) == [0.04, 0.3, 0.1, 2.0, -5.0]


@pytest.mark.parametrize(
    ("field", "bound"),
    [
        ("lateral_error_m", 0.15),
        ("vertical_speed_m_s", 0.4),
        ("horizontal_speed_m_s", 0.3),
        ("tilt_deg", 10.0),
    ],
)
def test_each_bound_holds_up_to_itself_and_no_further(field: str, bound: float) -> None:
    assert judged(dataclasses.replace(GOOD, **{field: bound})).outcome is Outcome.LANDED  # type: ignore[arg-type]
    over = judged(dataclasses.replace(GOOD, **{field: bound * 1.01}))  # type: ignore[arg-type]
    assert over.outcome is Outcome.MISSED
    assert len(over.failures) == 1
    assert f"expected at most {bound:g}" in over.failures[0]
    unknown = judged(dataclasses.replace(GOOD, **{field: nan}))  # type: ignore[arg-type]
    assert unknown.outcome is Outcome.MISSED


@pytest.mark.parametrize(
    ("touchdown", "values", "outcome"),
    [
        (GOOD, {"crashed": True}, Outcome.CRASHED),
        (None, {"crashed": True}, Outcome.CRASHED),
        (None, {"final_phase": Phase.ABORT}, Outcome.ABORTED),
        (dataclasses.replace(GOOD, on_pad=False), {"final_phase": Phase.ABORT}, Outcome.ABORTED),
        (None, {"final_phase": Phase.SEARCH}, Outcome.TIMEOUT),
        (GOOD, {"disarmed": False}, Outcome.TIMEOUT),
        (GOOD, {"at_rest_on_pad": False}, Outcome.MISSED),
        (dataclasses.replace(GOOD, on_pad=False), {}, Outcome.MISSED),
    ],
)
def test_each_ending_has_its_outcome_and_a_reason(
    touchdown: TouchdownState | None, values: dict[str, Any], outcome: Outcome
) -> None:
    verdict = judged(*([] if touchdown is None else [touchdown]), **values)
    assert verdict.outcome is outcome
    assert verdict.outcome is not Outcome.LANDED
    assert verdict.failures
    assert (verdict.touchdown is None) == (touchdown is None)


GENTLE = dataclasses.replace(GOOD, time_s=20.0, vertical_speed_m_s=0.1, on_pad=False, lateral_error_m=6.0)


def test_a_gentle_touch_before_the_landing_is_a_failed_flight_with_its_place_and_speeds() -> None:
    """The vehicle fell at the grant of control, brushed the ground, flew on and landed in the middle."""
    verdict = judged(GENTLE, GOOD)
    assert verdict.outcome is Outcome.MISSED
    assert verdict.failures == (
        "touched the ground 6.0 m from the pad's centre at 0.10 m/s down, 0.10 m/s sideways: "
        "before the landing",
    )
    assert [(c.time_s, c.surface, bool(c.violations)) for c in verdict.contacts] == [
        (20.0, "ground", True),
        (40.0, "pad", False),
    ]


def test_hops_of_the_take_off_count_when_they_are_harder_than_allowed() -> None:
    hop = dataclasses.replace(GENTLE, before_flight=True)
    assert judged(hop, GOOD).outcome is Outcome.LANDED
    slides = dataclasses.replace(hop, horizontal_speed_m_s=1.3)
    assert judged(slides, GOOD).outcome is Outcome.LANDED
    hard = dataclasses.replace(hop, vertical_speed_m_s=0.9)
    assert judged(hard, GOOD).outcome is Outcome.MISSED


@pytest.mark.parametrize(
    ("contacts", "values", "outcome"),
    [
        ([GENTLE, GOOD], {"final_phase": Phase.ABORT}, Outcome.ABORTED),
        ([GENTLE, GOOD], {"crashed": True}, Outcome.CRASHED),
        ([GENTLE], {"flown": False, "final_phase": Phase.SEARCH}, Outcome.TIMEOUT),
    ],
)
def test_whatever_the_outcome_a_touch_that_counts_is_told(
    contacts: list[TouchdownState], values: dict[str, Any], outcome: Outcome
) -> None:
    verdict = judged(*contacts, **values)
    assert verdict.outcome is outcome
    assert any("before the landing" in failure for failure in verdict.failures)


PAD = build_pad_motion(StaticMotion(kind="static"), 0.0, 0.0, np.random.default_rng(0)).at(0.0)
ON_PAD = ContactLoad(on_board=4)


class Watched:
    """A detector, told of a vehicle whose feet are at some height over the pad, sinking at some speed."""

    def __init__(self) -> None:
        self.detector = TouchdownDetector()
        self._time_s = 0.0

    def at(self, height_m: float, sink_m_s: float = 0.0, load: ContactLoad | None = None) -> Watched:
        self._time_s += 0.01
        north, east, _ = PAD.position_ned_m
        state = QuadrotorState((north, east, -0.18 - height_m), (0.0, 0.0, sink_m_s))
        touches = load or (ON_PAD if height_m <= 0.0 else NO_CONTACT)
        self.detector.step(self._time_s, state, PAD, touches)
        self.detector.airborne(height_m)
        return self


def test_small_bounces_are_one_landing_scored_by_the_worst_of_its_touches() -> None:
    told = Watched().at(0.0).at(3.0).at(0.0, 0.2).at(BOUNCE_M).at(0.0, 0.45).at(0.02).at(0.0, 0.05)
    (landing,) = told.detector.contacts
    assert landing is told.detector.touchdown
    assert (landing.vertical_speed_m_s, landing.touches) == (0.45, 3)
    assert judged(landing).outcome is Outcome.MISSED


def test_what_rises_higher_than_a_bounce_has_flown_on_and_the_next_touch_is_another() -> None:
    told = Watched().at(0.0).at(3.0).at(0.0, 0.3).at(BOUNCE_M + 0.01).at(0.0, 0.2)
    first, second = told.detector.contacts
    assert told.detector.touchdown is second
    assert (first.vertical_speed_m_s, second.vertical_speed_m_s) == (0.3, 0.2)
    verdict = judged(first, second)
    assert verdict.outcome is Outcome.MISSED


def test_standing_is_no_contact_and_a_hop_before_the_flight_is_none_of_the_flight_s() -> None:
    told = Watched().at(0.0).at(0.03).at(0.0, 0.2).at(0.05).at(0.0, 0.1).at(3.0).at(0.0, 0.25)
    hop, landing = told.detector.contacts
    assert hop.before_flight
    assert (hop.vertical_speed_m_s, hop.touches) == (0.2, 2)
    assert not landing.before_flight
    assert judged(hop, landing).outcome is Outcome.LANDED


def test_a_hop_higher_than_a_bounce_is_a_touch_before_the_landing() -> None:
    told = Watched().at(0.0).at(0.5).at(0.0, 0.3)
    assert told.detector.touchdown is None  # it has not flown yet
    told.at(3.0).at(0.0, 0.2)
    assert len(told.detector.contacts) == 2
    assert told.detector.touchdown is told.detector.contacts[-1]


def test_another_flight_begins_with_no_contacts_when_it_takes_off() -> None:
    told = Watched().at(0.0).at(3.0).at(0.0, 0.2)
    told.detector.begin_flight()
    assert told.at(0.0).detector.touchdown is not None  # it still stands where it landed
    assert told.at(1.2).detector.contacts == []
    told.at(0.0, 0.3)
    assert [contact.vertical_speed_m_s for contact in told.detector.contacts] == [0.3]


def test_speeds_are_relative_to_what_is_touched() -> None:
    """Beside a pad that drives at 2 m/s, at its speed: over the ground that is sliding."""
    moving = PAD._replace(velocity_ned_m_s=(2.0, 0.0, 0.0))
    found = {}
    for surface, load in (("pad", ON_PAD), ("ground", ContactLoad(on_ground=1))):
        detector = TouchdownDetector()
        state = QuadrotorState((0.0, 0.0, -0.2), (2.0, 0.0, 0.2))
        detector.step(0.0, state, moving, NO_CONTACT)
        detector.airborne(3.0)
        detector.step(0.01, state, moving, load)
        found[surface] = detector.contacts[0].horizontal_speed_m_s
    assert found == {"pad": pytest.approx(0.0), "ground": pytest.approx(2.0)}
