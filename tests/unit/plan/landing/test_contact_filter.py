"""The probability of contact: two modes, what tells of them and what does not."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from companion.base.messages import PadState, RangeSample
from companion.plan.landing.contact_filter import ContactFilter, FeetMotion, feet_motion
from tests.unit.plan.landing.touchdown_attempt import CONFIG, CYCLE_S
from tests.unit.plan.landing.touchdown_attempt import sight as unsure_sight
from tests.unit.plan.plan_harness import LEG_M, VEHICLE

# of the height, to 10 cm
UNSURE = tuple(tuple((0.01, 1e-4)[row // 3] * (row == column) for column in range(6)) for row in range(6))


def position_covariance(std_m: float) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(std_m**2 if row == column else 0.0 for column in range(6)) for row in range(6))


def sight(**given: Any) -> PadState:
    return replace(unsure_sight(**given), covariance=position_covariance(1e-3))


def feet(seen: PadState | None, echo: RangeSample | None = None, **given: Any) -> FeetMotion:
    known: dict[str, Any] = {"config": CONFIG, "vehicle": VEHICLE, "obeys": True, "felt": True, **given}
    return feet_motion(seen, 0.2, echo, 10.0, **known)


def test_the_feet_are_as_high_as_the_surer_of_camera_and_echo_has_them() -> None:
    clear, unsure = sight(height=LEG_M + 0.05), replace(sight(height=LEG_M + 0.05), covariance=UNSURE)
    echo, old = RangeSample(9.9, 0.12), RangeSample(9.0, 0.12)
    by_echo_m = 0.12 + VEHICLE.range_position_body_m[2] - LEG_M
    assert feet(clear, echo).over_m == pytest.approx(0.05)
    assert feet(unsure, echo).over_m == pytest.approx(by_echo_m)
    assert feet(unsure, old).over_m == pytest.approx(0.05)
    assert feet(replace(clear, seen_time_s=-1.0), old).over_m is None
    assert feet(None, None).over_m is None


def test_a_sink_that_nothing_feels_nobody_asked_for_or_nothing_is_sure_of_tells_nothing() -> None:
    seen = sight(height=0.3, velocity=(0.0, 0.0, 0.2))
    assert feet(seen).sink_m_s == pytest.approx(0.2)
    assert feet(seen, felt=False).sink_m_s is None
    assert feet(seen, obeys=False).sink_m_s is None
    assert feet(replace(seen, covariance=position_covariance(0.15))).sink_m_s is None
    assert feet(replace(seen, relative_position_ned_m=(0.0, 0.0, math.nan))).over_m is None


def fall_on(
    contact: ContactFilter, over_m: float, sinks_m_s: Sequence[float], *, std_m_s: float = 0.01
) -> int:
    """Sink at 0.2 m/s onto what is so much higher than the file says, then as given; cycles until found."""
    now_s, height_m = 0.0, over_m + 0.2
    while height_m > over_m:
        now_s, height_m = now_s + CYCLE_S, height_m - 0.2 * CYCLE_S
        contact.update(FeetMotion(height_m, 0.002, 0.2, std_m_s, 0.2), now_s)
        assert contact.probability < 0.5
    for k, sink_m_s in enumerate(sinks_m_s):
        now_s += CYCLE_S
        contact.update(FeetMotion(over_m, 0.002, sink_m_s, std_m_s, 0.2), now_s)
        if contact.probability >= 0.5:
            return k + 1
    return 0


@pytest.mark.parametrize("over_m", [-0.04, -0.02, 0.0, 0.02, 0.04, 0.06])
def test_a_sink_that_stops_where_the_legs_may_end_is_found_in_two_cycles(over_m: float) -> None:
    assert 0 < fall_on(ContactFilter(0.022), over_m, [0.0] * 10) <= 2


def test_the_same_far_over_what_the_file_says_is_found_later_and_beyond_a_hand_never() -> None:
    assert fall_on(ContactFilter(0.022), 0.09, [0.0] * 60) > 2
    assert fall_on(ContactFilter(0.022), 0.11, [0.0] * 60) == 0


def test_a_gust_that_slows_the_sink_near_the_pad_is_none() -> None:
    slows = [0.2 - 0.02 * k for k in range(8)]
    assert fall_on(ContactFilter(0.022), 0.03, slows + slows[::-1]) == 0


@pytest.mark.parametrize("over_m", [-0.101, -0.15, -0.25, -0.6])
def test_legs_shorter_than_told_are_found_by_the_stop_alone(over_m: float) -> None:
    for leg_std_m in (0.005, 0.022):
        contact = ContactFilter(leg_std_m)
        for k, sink_m_s in enumerate([0.2, 0.2, 0.2, *[0.0] * 30]):
            contact.update(FeetMotion(over_m, 0.002, sink_m_s, 0.01, 0.2), k * CYCLE_S)
        assert contact.probability > 0.9


def test_a_deck_whose_sink_is_hardly_known_is_found_later() -> None:
    sure, unsure = (fall_on(ContactFilter(0.022), 0.03, [0.0] * 60, std_m_s=m) for m in (0.01, 0.1))
    assert sure < unsure


def test_what_lifts_the_feet_again_is_no_contact() -> None:
    contact = ContactFilter(0.022)
    assert fall_on(contact, 0.0, [0.0] * 10)
    for k in range(10):
        contact.update(FeetMotion(0.02 * k, 0.002, -0.3, 0.01, 0.2), 10.0 + k * CYCLE_S)
    assert contact.probability < 0.5
