"""The thrust that holds the vehicle is measured in a fraction of a second, and how well it is known too."""

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.control.response.hover_thrust import (
    KNOWN_STD,
    LEAST_SHARE,
    MOST_SHARE,
    TOLD_STD,
    HeldThrust,
    HoverThrust,
)

PERIOD_S = 1.0 / 30.0
BANDWIDTH_RAD_S = 0.6


def fly(estimate: HoverThrust, true: float, thrust: float, seconds: float, noise_g: float = 0.0) -> None:
    """A thrust that acts for a while on a vehicle that `true` would hold."""
    rng = np.random.default_rng(1)
    for _ in range(round(seconds / PERIOD_S)):
        felt_g = thrust / true + noise_g * float(rng.normal())
        made_g = thrust / estimate.value
        estimate.correct(GRAVITY_M_S2 * (1.0 - felt_g), GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S)


@pytest.mark.parametrize("share", [0.5, 0.7, 1.0, 1.3, 1.6])
@pytest.mark.parametrize("thrust_share", [0.8, 1.0, 1.2])
def test_whatever_was_told_it_is_right_within_half_a_second_in_hover_or_not(
    share: float, thrust_share: float
) -> None:
    estimate, true = HoverThrust(0.45, BANDWIDTH_RAD_S, TOLD_STD), 0.45 * share
    fly(estimate, true, thrust_share * true, 0.5)
    assert estimate.value == pytest.approx(true, rel=0.08)
    assert estimate.std <= KNOWN_STD


def test_the_covariance_says_how_far_off_it_is() -> None:
    errors, stds = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = 0.5 * float(np.clip(1.0 + 0.4 * rng.normal(), 0.4, 2.0))
        estimate = HoverThrust(0.5, BANDWIDTH_RAD_S, TOLD_STD)
        air_g, share = 0.0, math.exp(-PERIOD_S / 0.5)
        for _ in range(30):
            air_g = share * air_g + 0.05 * math.sqrt(1.0 - share**2) * float(rng.normal())
            felt_g, made_g = 1.0 + air_g, true / estimate.value
            estimate.correct(-GRAVITY_M_S2 * (felt_g - 1.0), GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S)
        errors.append(estimate.value / true - 1.0)
        stds.append(estimate.std)
    assert 0.5 < float(np.std(errors)) / float(np.mean(stds)) < 1.5


def test_settled_it_follows_a_change_as_fast_as_asked_and_passes_over_what_is_no_number() -> None:
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S)
    fly(estimate, 0.5, 0.5, 20.0, noise_g=0.02)
    fly(estimate, 0.6, 0.6, 1.0 / BANDWIDTH_RAD_S)
    assert 0.55 < estimate.value < 0.59
    before = estimate.value
    assert estimate.correct(math.nan, 0.0, PERIOD_S) == 1.0
    assert estimate.correct(0.0, math.inf, PERIOD_S) == 1.0
    assert estimate.value == before


def test_falling_freely_nothing_is_learnt_and_the_estimate_stays_one() -> None:
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S, TOLD_STD)
    for acceleration in (GRAVITY_M_S2, 5.0 * GRAVITY_M_S2):
        estimate.correct(acceleration, GRAVITY_M_S2, 1.0)
        assert estimate.value == pytest.approx(0.5)
    estimate.correct(5.0 * GRAVITY_M_S2, 0.0, 1.0)
    assert 0.5 < estimate.value < math.inf


def test_what_is_not_measured_or_contradicts_all_that_was_told_is_doubted_with_its_figures() -> None:
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S, TOLD_STD)
    assert "uncertain: 100 %, limit 10 %" in estimate.doubt({"vehicle": 0.5})
    fly(estimate, 0.65, 0.65, 2.0)
    assert estimate.doubt({"vehicle": 0.65 / MOST_SHARE + 0.02, "parameter": None}) == ""
    assert estimate.doubt({"vehicle": 0.2, "parameter": 0.65 / LEAST_SHARE - 0.02}) == ""
    words = estimate.doubt({"vehicle": 0.3, "parameter": 0.35})
    assert words.startswith("hover thrust: 0.65 measured, vehicle 0.30, parameter 0.35 configured;")
    assert estimate.doubt({"vehicle": 0.0})


@pytest.mark.parametrize(("true_share", "believed"), [(1.6, True), (0.5, True), (2.1, False), (0.38, False)])
def test_at_the_bounds_themselves_it_is_believed_however_the_air_errs(
    true_share: float, believed: bool
) -> None:
    found = []
    for air_g in (-0.06, 0.0, 0.06):  # a steady downdraught or updraught of what a mean wind makes
        estimate, true = HoverThrust(0.45, BANDWIDTH_RAD_S, TOLD_STD), 0.45 * true_share
        for _ in range(60):
            made_g = true * (1.0 - air_g) / estimate.value
            estimate.correct(0.0, GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S)
        found.append(estimate.doubt({"vehicle": 0.45}) == "")
    assert found == [believed] * 3


def test_a_reported_thrust_counts_once_it_acts_and_not_over_a_gap() -> None:
    held = HeldThrust(0.05, 0.05)
    assert held.step(0.5, PERIOD_S) is None
    assert held.step(0.5, PERIOD_S) == pytest.approx(0.5)
    late = held.step(0.8, PERIOD_S)
    assert late is not None
    assert 0.5 < late < 0.62
    assert held.step(None, PERIOD_S) is None
    assert held.step(0.8, PERIOD_S) is None
    assert held.step(0.8, PERIOD_S) == pytest.approx(0.8)
