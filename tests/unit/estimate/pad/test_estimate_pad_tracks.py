"""The pad filter over made-up tracks: accuracy, honesty, waves, blindness, late frames, wild echoes."""

from functools import lru_cache

import numpy as np
import pytest

from tests.unit.estimate.pad.pad_scores import (
    Score,
    lag_s,
    late_frames_cost_m,
    old_filter,
    score,
    with_spikes,
)
from tests.unit.estimate.pad.pad_track import SimulatedPadTrack

SEEDS = (0, 1, 2)
MOTION_NAMES = ("static", "circle", "figure-8", "heave", "random turns")


def track(motion: str, seed: int) -> SimulatedPadTrack:
    return SimulatedPadTrack(motion, seed, duration_s=14.0, sinks=False)


@lru_cache
def found(motion: str) -> list[Score]:
    return [score(track(motion, seed)) for seed in SEEDS]


def rms(scores: list[Score], *columns: int) -> float:
    return float(np.sqrt(np.mean([one.rms(columns) ** 2 for one in scores])))


@pytest.mark.parametrize("motion", MOTION_NAMES)
def test_velocity_is_known_to_a_few_centimetres_a_second(motion: str) -> None:
    assert rms(found(motion), 3, 4, 5) < 0.08


@pytest.mark.parametrize("motion", MOTION_NAMES)
def test_claimed_uncertainty_is_honest(motion: str) -> None:
    """Six states: 6 on average; three runs of one flight each leave a wide margin."""
    assert 2.0 < np.mean([one.nees.mean() for one in found(motion)]) < 9.0


@pytest.mark.parametrize("motion", MOTION_NAMES)
def test_blind_predictions_do_not_claim_too_much(motion: str) -> None:
    after = np.concatenate([one.blind_nees for one in found(motion)]).mean(axis=0)
    assert after.max() < 9.0


@pytest.mark.parametrize(("motion", "bound_m"), [("static", 0.3), ("circle", 0.4), ("figure-8", 0.6)])
def test_blind_for_two_seconds_the_place_is_kept(motion: str, bound_m: float) -> None:
    errors = np.concatenate([one.blind_error for one in found(motion)])[:, 2, :3]
    assert float(np.sqrt((errors**2).sum(axis=1).mean())) < bound_m


def test_waves_are_followed_closer_than_by_a_single_model() -> None:
    ours = found("heave")
    theirs = [score(track("heave", seed), old_filter) for seed in SEEDS]
    assert rms(ours, 8) < 0.75 * rms(theirs, 8)
    lags = [
        [lag_s(track("heave", s), one) for s, one in zip(SEEDS, all_, strict=True)] for all_ in (ours, theirs)
    ]
    assert np.mean(lags[0]) < 0.2
    assert np.mean(lags[0]) < 0.6 * np.mean(lags[1])


def test_turns_are_predicted_better_than_by_a_single_model() -> None:
    ours = np.concatenate([one.blind_error for one in found("figure-8")])[:, 2, :2]
    theirs = [score(track("figure-8", seed), old_filter) for seed in SEEDS]
    single = np.concatenate([one.blind_error for one in theirs])[:, 2, :2]
    assert (ours**2).mean() < 0.5 * (single**2).mean()


def test_frames_a_quarter_of_a_second_late_change_nothing() -> None:
    assert late_frames_cost_m(track("figure-8", 0)) == 0.0


def test_wild_echoes_are_refused_and_true_ones_carry_the_height() -> None:
    spikes = with_spikes(SimulatedPadTrack("heave", 0))
    assert spikes.false > 5
    assert spikes.false_taken == 0
    assert spikes.true_taken_share > 0.95
    assert spikes.worst_height_error_m < 0.1
