"""The probability of contact: two modes, what tells of them and what does not."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from companion.base.messages import PadState, RangeSample
from companion.plan.landing.contact import FRESH_S, RESPONDS_S, WITHIN_HAND_M
from companion.plan.landing.contact_filter import ContactFilter, FeetMotion, feet_motion, lowest_foot_m
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
    known: dict[str, Any] = {"config": CONFIG, "vehicle": VEHICLE, "obeys": True, "felt_s": 10.0, **given}
    return feet_motion(seen, 0.2, echo, 10.0, **known)


def test_the_feet_are_as_high_as_the_surer_of_camera_and_echo_has_them() -> None:
    clear, unsure = sight(height=LEG_M + 0.05), replace(sight(height=LEG_M + 0.05), covariance=UNSURE)
    echo, old = RangeSample(9.9, 0.12), RangeSample(9.0, 0.12)
    near = RangeSample(9.9, 0.02)  # 13 cm nearer than the camera has the pad, to 3 cm
    fairly = replace(clear, covariance=position_covariance(0.03))
    assert feet(fairly, near).over_m == pytest.approx(0.05)
    by_echo_m = 0.12 + VEHICLE.range_position_body_m[2] - LEG_M
    assert feet(clear, echo).over_m == pytest.approx(0.05)
    assert feet(unsure, echo).over_m == pytest.approx(by_echo_m)
    assert feet(unsure, old).over_m == pytest.approx(0.05)
    assert feet(replace(clear, seen_time_s=-1.0), old).over_m == pytest.approx(0.05)
    assert feet(replace(clear, seen_time_s=-2.0), old).over_m is None
    assert feet(None, None).over_m is None


@pytest.mark.parametrize("age_s", [0.1, 0.6, 1.0])
def test_an_echo_that_the_pads_last_sightings_refute_is_not_the_height_of_the_feet(age_s: float) -> None:
    stuck = RangeSample(9.9, LEG_M - VEHICLE.range_position_body_m[2])  # as if it stood
    high = replace(sight(height=LEG_M + 0.2), covariance=position_covariance(0.04), seen_time_s=-age_s)
    assert feet(high, stuck).over_m == pytest.approx(0.2)
    # what it says of a height that is known to 10 cm may be true
    assert feet(replace(high, covariance=UNSURE), stuck).over_m == pytest.approx(0.0)


@pytest.mark.parametrize(("tilt_deg", "counts_deg"), [(0.0, 0.0), (8.0, 8.0), (40.0, 15.0)])
def test_the_foot_that_hangs_lowest_is_the_one_that_touches(tilt_deg: float, counts_deg: float) -> None:
    hangs = lowest_foot_m(VEHICLE, math.radians(tilt_deg))
    found = feet(sight(height=LEG_M + 0.1), hangs_m=hangs)
    hangs_m = VEHICLE.foot_reach_m * math.sin(math.radians(counts_deg))
    assert found.over_m == pytest.approx(0.1 - hangs_m)


def test_a_sink_that_nobody_asked_for_tells_nothing_until_a_height_has_the_feet_down() -> None:
    seen = sight(height=0.3, velocity=(0.0, 0.0, 0.2))
    assert feet(seen).sink_m_s == pytest.approx(0.2)
    assert feet(seen, obeys=False).sink_m_s is None
    assert feet(sight(height=LEG_M + 0.01), obeys=False).sink_m_s == 0.0
    assert feet(replace(seen, relative_position_ned_m=(0.0, 0.0, math.nan))).over_m is None


def fall_on(
    contact: ContactFilter, over_m: float, sinks_m_s: Sequence[float], *, std_m_s: float = 0.01
) -> int:
    """Sink at 0.2 m/s onto what is so much higher than the file says, then as given; cycles until found."""
    now_s, height_m = 0.0, over_m + 0.2
    while height_m > over_m:
        now_s, height_m = now_s + CYCLE_S, height_m - 0.2 * CYCLE_S
        contact.update(FeetMotion(height_m, 0.002, 0.2, std_m_s, now_s, 0.2), now_s)
        assert contact.probability < 0.5
    for k, sink_m_s in enumerate(sinks_m_s):
        now_s += CYCLE_S
        contact.update(FeetMotion(over_m, 0.002, sink_m_s, std_m_s, now_s, 0.2), now_s)
        if contact.probability >= 0.5:
            return k + 1
    return 0


@pytest.mark.parametrize("over_m", [-0.04, -0.02, 0.0, 0.02, 0.04, 0.06])
def test_a_sink_that_stops_where_the_legs_may_end_is_found_in_two_cycles(over_m: float) -> None:
    assert 0 < fall_on(ContactFilter(CONFIG, 0.022), over_m, [0.0] * 10) <= 2


def test_the_same_far_over_what_the_file_says_is_found_later_and_beyond_a_hand_never() -> None:
    assert fall_on(ContactFilter(CONFIG, 0.022), 0.09, [0.0] * 60) > 2
    assert fall_on(ContactFilter(CONFIG, 0.022), 0.11, [0.0] * 60) == 0


def test_a_gust_that_slows_the_sink_near_the_pad_is_none() -> None:
    slows = [0.2 - 0.02 * k for k in range(8)]
    assert fall_on(ContactFilter(CONFIG, 0.022), 0.03, slows + slows[::-1]) == 0


@pytest.mark.parametrize("over_m", [-0.101, -0.15, -0.25, -0.6])
def test_legs_shorter_than_told_are_found_by_the_stop_alone(over_m: float) -> None:
    for leg_std_m in (0.005, 0.022):
        contact = ContactFilter(CONFIG, leg_std_m)
        for k, sink_m_s in enumerate([0.2, 0.2, 0.2, *[0.0] * 30]):
            contact.update(FeetMotion(over_m, 0.002, sink_m_s, 0.01, k * CYCLE_S, 0.2), k * CYCLE_S)
        assert contact.contact


def test_a_deck_whose_sink_is_hardly_known_is_found_later() -> None:
    sure, unsure = (fall_on(ContactFilter(CONFIG, 0.022), 0.03, [0.0] * 60, std_m_s=m) for m in (0.01, 0.1))
    assert 0 < sure < unsure


def test_what_lifts_the_feet_again_is_no_contact() -> None:
    contact = ContactFilter(CONFIG, 0.022)
    assert fall_on(contact, 0.0, [0.0] * 10)
    for k in range(10):
        now_s = 10.0 + k * CYCLE_S
        contact.update(FeetMotion(0.02 * k, 0.002, -0.3, 0.01, now_s, 0.2), now_s)
    assert contact.probability < 0.5
    assert contact.unloading == 0.0


@pytest.mark.parametrize(
    ("over_m", "waits_s"), [(-0.1, 0.0), (0.02, 0.0), (0.03, RESPONDS_S), (0.07, RESPONDS_S)]
)
def test_where_no_height_has_the_feet_down_contact_waits_until_the_vehicle_would_have_fallen(
    over_m: float, waits_s: float
) -> None:
    contact, found_s = ContactFilter(CONFIG, 0.022), 0.0
    stood_s = (31 + fall_on(contact, over_m, [0.0] * 30)) * CYCLE_S
    for k in range(30):
        if not contact.contact:
            found_s = (k + 1) * CYCLE_S
        now_s = stood_s + k * CYCLE_S
        contact.update(FeetMotion(over_m, 0.002, 0.0, 0.01, now_s, 0.2), now_s)
    assert contact.contact
    # it is not sure at once that it stands
    assert -2.5 * CYCLE_S <= found_s - CONFIG.contact_s - waits_s <= 5.0 * CYCLE_S


# nothing tells of a sink; or it is predicted, upward, by what a failing IMU felt last
@pytest.mark.parametrize("sink_m_s", [None, -0.24])
@pytest.mark.parametrize(("over_m", "stands"), [(0.0, True), (0.07, False)])
def test_what_the_imu_felt_last_counts_for_a_moment_and_then_nothing_stands(
    over_m: float, stands: bool, sink_m_s: float | None
) -> None:
    contact, lasts = ContactFilter(CONFIG, 0.022), list[bool]()
    found = fall_on(contact, over_m, [0.0] * 30)
    assert found
    felt_s, before, found_contact = (31 + found) * CYCLE_S, contact.probability, False
    for k in range(30):
        now_s = felt_s + k * CYCLE_S
        predicted_m = over_m - (sink_m_s or 0.0) * k * CYCLE_S
        contact.update(FeetMotion(predicted_m, 0.002, sink_m_s, 0.01, felt_s - CYCLE_S, 0.2), now_s)
        lasts.append(contact.probability == before)
        found_contact |= contact.contact
    assert lasts == [True] * lasts.index(False) + [False] * (30 - lasts.index(False))
    most_s = lasts.index(False) * CYCLE_S  # sooner where a prediction, too, has the feet far over the pad
    assert most_s >= FRESH_S - 2.0 * CYCLE_S or predicted_m > WITHIN_HAND_M
    assert most_s <= FRESH_S + 2.0 * CYCLE_S
    assert found_contact is stands
    assert (contact.probability, contact.unloading) == (0.0, 0.0)


@pytest.mark.parametrize("silent_s", [0.2, 1.5])
def test_what_stood_and_is_surely_higher_than_legs_are_wrong_flies(silent_s: float) -> None:
    contact = ContactFilter(CONFIG, 0.022)
    assert fall_on(contact, 0.05, [0.0] * 30)
    for k in range(30):
        now_s = 2.0 + silent_s + k * CYCLE_S
        contact.update(FeetMotion(0.15, 0.002, 0.0, 0.01, now_s, 0.2), now_s)
        assert contact.probability == 0.0


def test_the_autopilots_word_counts_where_a_height_has_the_feet_down() -> None:
    for over_m, stands in ((0.01, True), (0.03, False)):
        contact = ContactFilter(CONFIG, 0.022)
        for k in range(10):
            now_s = k * CYCLE_S
            contact.update(FeetMotion(over_m, 0.002, None, 0.01, 0.0, 0.2), now_s, landed=True)
        assert contact.contact is stands


@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
def test_a_descent_that_slows_is_no_contact_at_any_rate(rate_hz: float) -> None:
    contact, now_s, over_m = ContactFilter(CONFIG, 0.022), 0.0, 0.2
    while over_m > -0.01:
        sink_m_s = 0.2 if over_m > 0.03 else 0.1
        now_s, over_m = now_s + 1.0 / rate_hz, over_m - sink_m_s / rate_hz
        contact.update(FeetMotion(over_m, 0.002, sink_m_s, 0.01, now_s, 0.2), now_s)
        assert not contact.touching


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 60.0, 100.0])
@pytest.mark.parametrize("stopped_m", [0.0, 0.03])
def test_feet_that_stand_are_found_at_any_rate(rate_hz: float, stopped_m: float) -> None:
    contact, now_s, over_m = ContactFilter(CONFIG, 0.022), 0.0, 0.2
    while over_m > stopped_m:
        now_s, over_m = now_s + 1.0 / rate_hz, over_m - 0.2 / rate_hz
        contact.update(FeetMotion(over_m, 0.002, 0.2, 0.01, now_s, 0.2), now_s)
    stopped_s = now_s
    while not contact.contact and now_s < stopped_s + 2.0:
        now_s += 1.0 / rate_hz
        contact.update(FeetMotion(stopped_m, 0.002, 0.0, 0.01, now_s, 0.2), now_s)
    assert now_s - stopped_s < CONFIG.contact_s + RESPONDS_S + 0.25


@pytest.mark.parametrize("std_m_s", [0.1, 0.5, 1.0])
def test_a_height_alone_is_no_contact_however_little_is_known_of_the_sink(std_m_s: float) -> None:
    contact = ContactFilter(CONFIG, 0.022)
    for k in range(45):
        over_m = 0.2 - 0.2 * k * CYCLE_S
        contact.update(FeetMotion(over_m, 0.002, 0.2, std_m_s, k * CYCLE_S, 0.2), k * CYCLE_S)
        assert contact.unloading == 0.0
