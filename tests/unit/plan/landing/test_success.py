"""The probability of a contact within the limits: as often as it says, and by what speaks against it."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt
import pytest

from companion.base.geometry import ZERO3
from companion.base.messages import PadState
from companion.base.motion import Motion
from companion.config import GuidanceConfig, TouchdownConfig
from companion.plan.landing.contact import RESPONDS_S
from companion.plan.landing.contact_filter import SINK_TAU_S
from companion.plan.landing.levelling import FASTEST_DRIFT
from companion.plan.landing.success import SuccessEstimate
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.plan.landing.touchdown_attempt import CONFIG, CYCLE_S, WAIT_M, sight

Array = npt.NDArray[np.float64]
SINK_M_S = CONFIG.contact_speed_m_s
HOVERS = Motion((0.0, 0.0, -WAIT_M))


def over_pad() -> ReferenceGenerator:
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 0.4, 20, 0.1)
    generator.start("pad", Motion((0.0, 0.0, -WAIT_M)), 0.0)
    return generator


def watched(config: TouchdownConfig = CONFIG, *, for_s: float = 20.0) -> SuccessEstimate:
    """Of a vehicle that has followed the pad without an error for so long."""
    success, generator = SuccessEstimate(config), over_pad()
    for k in range(round(for_s / CYCLE_S)):
        success.note(sight(), None, generator, k * CYCLE_S)
    return success


def factors(
    success: SuccessEstimate,
    seen: PadState,
    ahead_s: float = 0.0,
    *,
    sink_m_s: float = SINK_M_S,
    drift: tuple[float, float] = (0.0, 0.0),
    slack: float = 1.0,
    contact: Motion = HOVERS,
) -> dict[str, float]:
    return success.factors(
        seen, HOVERS, ahead_s, sink_m_s=sink_m_s, contact=contact, drift=drift, slack=slack
    )  # fmt: skip


FLIGHTS: Final = 600
SHAKES_M: Final = np.exp(np.random.default_rng(6).normal(math.log(0.035), 0.4, (FLIGHTS, 1)))


def shaken(
    rng: np.random.Generator, loop_s: float, offset: Array, speed: Array, cycles: int
) -> tuple[Array, Array]:
    """Offsets and speeds (m, m/s) some cycles later, a row a flight, a column an axis.

    They respond, a critically damped second order with that time constant, to white accelerations that shake
    each as in SHAKES_M.
    """
    rate = 1.0 / loop_s
    kick_m_s = math.sqrt(4.0 * rate**3 * CYCLE_S) * SHAKES_M
    for _ in range(cycles):
        acceleration = -(rate**2) * offset - 2.0 * rate * speed
        speed = speed + CYCLE_S * acceleration + kick_m_s * rng.standard_normal(offset.shape)
        offset = offset + CYCLE_S * speed
    return offset, speed


def moving(offset: Array, speed: Array) -> PadState:
    """The pad below a vehicle that is so far off, and moves so."""
    (north, east), (vn, ve) = offset.tolist(), speed.tolist()
    place, velocity = (-north, -east, WAIT_M), (-vn, -ve, 0.0)
    return replace(sight(), relative_position_ned_m=place, relative_velocity_ned_m_s=velocity)


# of the bundled autopilots, and of one that wanders
@pytest.mark.parametrize("loop_s", [SINK_TAU_S, 0.6])
def test_it_comes_true_as_often_as_it_says(loop_s: float) -> None:
    """Gusts of unknown strength shake the vehicles, up to their limits: only their motion tells how much."""
    rng, generator = np.random.default_rng(7), over_pad()
    estimates = [SuccessEstimate(CONFIG) for _ in range(FLIGHTS)]
    offset = speed = np.zeros((FLIGHTS, 2))
    for k in range(round(8.0 / CYCLE_S)):
        offset, speed = shaken(rng, loop_s, offset, speed, 1)
        for success, *row in zip(estimates, offset, speed, strict=True):
            success.note(moving(*row), None, generator, k * CYCLE_S)
    for ahead_s in (0.6, 0.9, 2.2):
        said = np.array(
            [
                factors(success, moving(*row), ahead_s)["lateral offset"]
                for success, *row in zip(estimates, offset, speed, strict=True)
            ]
        )
        # it goes on as it is until it responds
        cycles = round((ahead_s - RESPONDS_S) / CYCLE_S)
        later, _ = shaken(rng, loop_s, offset + RESPONDS_S * speed, speed, cycles)
        within = np.linalg.norm(later, axis=1) <= CONFIG.break_off_lateral_m
        for least, most in ((0.0, 0.6), (0.6, 0.8), (0.8, 1.0)):
            rows = (said >= least) & (said <= most)
            assert rows.sum() >= 40
            likely, chance = said[rows].mean(), 0.5 / math.sqrt(rows.sum())
            assert within[rows].mean() == pytest.approx(likely, abs=0.05 + 2.0 * chance)


def test_nothing_is_known_at_first_and_a_few_seconds_tell() -> None:
    at_first, soon, later = (
        math.prod(factors(watched(for_s=for_s), sight(), 2.2).values()) for for_s in (0.0, 1.0, 6.0)
    )
    assert at_first < soon < 0.5
    assert later > 0.9


@pytest.mark.parametrize(
    ("what", "good", "bad"),
    [
        ("lateral offset", sight(aside=0.065), sight(aside=0.075)),
        ("lateral speed", sight(velocity=(0.23, 0.0, 0.0)), sight(velocity=(0.0, 0.25, 0.0))),
        ("sink", sight(velocity=(0.0, 0.0, 0.41)), sight(velocity=(0.0, 0.0, 0.43))),
        ("pad tilt", replace(sight(), tilt_swing_rad=0.1, tilt_rad=(0.0, math.radians(4.9))),
         replace(sight(), tilt_swing_rad=0.1, tilt_rad=(math.radians(5.1), 0.0))),
    ],
)  # fmt: skip
def test_at_the_contact_each_limit_counts_on_both_sides(what: str, good: PadState, bad: PadState) -> None:
    success = watched()
    assert all(factor > 0.99 for factor in factors(success, good).values())
    found = factors(success, bad)
    assert found.pop(what) < 0.01
    assert all(factor > 0.99 for factor in found.values())


def test_an_offset_stays_until_the_vehicle_responds_and_is_corrected_in_a_second() -> None:
    aside = sight(aside=0.1)
    until_s, later_s = RESPONDS_S, 1.2
    likely = [factors(watched(), aside, ahead_s)["lateral offset"] for ahead_s in (until_s, later_s)]
    assert likely[0] < 0.01
    assert likely[1] > 0.99


def test_a_speed_away_from_the_pad_is_an_offset_to_come() -> None:
    away, back = (sight(0.05, velocity=(v, 0.0, 0.0)) for v in (0.2, -0.2))
    likely = [factors(watched(), seen, RESPONDS_S)["lateral offset"] for seen in (away, back)]
    assert likely[0] < 0.01
    assert likely[1] > 0.99


@pytest.mark.parametrize("std_m", [0.001, 0.03])
def test_an_offset_that_may_be_the_estimates_own_noise_proves_little(std_m: float) -> None:
    covariance = tuple(tuple(std_m**2 if i == j else 0.0 for j in range(6)) for i in range(6))
    aside = replace(sight(aside=0.08), covariance=covariance)
    likely = factors(watched(), aside)["lateral offset"]
    assert (likely < 0.01) if std_m < 0.01 else (0.2 < likely < 0.5)


def test_what_a_level_vehicle_drifts_by_makes_its_speed_and_offset_unsure_and_nothing_else() -> None:
    calm, wind = (factors(watched(), sight(), 2.0, drift=drift) for drift in ((0.0, 0.0), (0.24, 0.035)))
    assert wind.pop("lateral speed") == pytest.approx(0.683, abs=0.01)  # one standard deviation
    assert wind.pop("lateral offset") == pytest.approx(0.954, abs=0.01)  # two
    assert min(calm.pop("lateral speed"), calm.pop("lateral offset")) > 0.99
    assert wind == calm


@pytest.mark.parametrize("limit", ["lateral offset", "lateral speed"])
def test_a_reference_that_will_touch_aside_or_too_fast_is_no_success(limit: str) -> None:
    """However well the vehicle follows it, at a limit it is a coin's toss."""
    aside = {
        "lateral offset": Motion((CONFIG.break_off_lateral_m, 0.0, 0.0)),
        "lateral speed": Motion(ZERO3, (0.0, FASTEST_DRIFT * CONFIG.lateral_speed_m_s, 0.0)),
    }[limit]
    likely = factors(watched(), sight(), 2.0, contact=aside)
    assert likely.pop(limit) == pytest.approx(0.5, abs=0.05)
    assert min(likely.values()) > 0.99


def test_slack_widens_the_limit_aside_alone() -> None:
    strict, slack = (factors(watched(), sight(aside=0.09), slack=scale) for scale in (1.0, 1.6))
    assert strict.pop("lateral offset") < 0.01
    assert slack.pop("lateral offset") > 0.99
    assert strict == slack


def test_a_firmer_sink_leaves_less_to_spare() -> None:
    gusty = SuccessEstimate(CONFIG)  # nothing is known: the sink may scatter by all that it has to spare
    gentle, firm = (factors(gusty, sight(), 2.0, sink_m_s=sink)["sink"] for sink in (0.19, 0.32))
    assert gentle == pytest.approx(0.841, abs=0.01)
    assert firm < gentle


def test_while_the_pad_is_unseen_nothing_is_learnt() -> None:
    success, generator = watched(), over_pad()
    before = factors(success, sight(), 2.0)
    for k in range(60):
        success.note(sight(aside=0.3, age=0.5), None, generator, 20.0 + k * CYCLE_S)
        success.note(None, None, generator, 20.0 + k * CYCLE_S)
    assert factors(success, sight(), 2.0) == before
