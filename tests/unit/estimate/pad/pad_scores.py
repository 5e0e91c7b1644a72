"""Runs a pad filter over a made-up track and says how far off it was, and whether it knew."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.config import PadFilterConfig
from companion.estimate.estimator import ATTITUDE_WANDER_RAD_S
from companion.estimate.gating import Gate, Timeline
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.pad_filter import PadFilter
from companion.estimate.pad.pad_types import CombinedEstimate, HeightMeasurement
from tests.unit.estimate.pad.pad_track import IMU_HZ, SimulatedPadTrack, lever
from tests.unit.estimate.pad.single_model_filter import SingleModelFilter

NewFilter = Callable[[MotionHistory], Any]
BLIND_S: Final = (0.5, 1.0, 2.0)
WARM_S: Final = 2.0
# 95 % band of the mean of 20 runs' normalised squared errors of six states: chi-square of 120 over 20
NEES_BAND: Final = (4.57, 7.60)
WANDER_RAD_S: Final = ATTITUDE_WANDER_RAD_S


def new_filter(motion: MotionHistory) -> PadFilter:
    """The filter that flies."""
    return PadFilter(PadFilterConfig(), motion, 0.65)


def old_filter(motion: MotionHistory) -> SingleModelFilter:
    """The one that it replaced."""
    return SingleModelFilter(motion)


@dataclass(frozen=True)
class Score:
    """Rows are times. Errors (n, 9) of position, velocity, acceleration; `nees` (n,) of the first six.

    `blind_error` and `blind_nees` hold the same after each of BLIND_S without a sighting: (n, 3, 9), (n, 3).
    """

    times_s: FloatArray
    estimate: FloatArray
    error: FloatArray
    nees: FloatArray
    blind_error: FloatArray
    blind_nees: FloatArray

    def rms(self, columns: Sequence[int]) -> float:
        """Of the length of these components' error."""
        return float(np.sqrt(np.mean(np.sum(self.error[:, list(columns)] ** 2, axis=1))))


def score(track: SimulatedPadTrack, make: NewFilter = new_filter) -> Score:
    """Feed the sightings as they arrive; judge at each arrival, once the pad has been seen for 2 s."""
    history = track.motion_history()
    judged = make(history)
    timeline: Timeline[Any, Any] = Timeline(judged, 1.0)
    rows: list[tuple[Any, ...]] = []
    for sight in track.sights:
        timeline.add(sight.time_s, sight.fix)
        now_s = sight.arrival_s
        if now_s < WARM_S or now_s + BLIND_S[-1] > track.duration_s:
            continue
        snapshot = timeline.as_of(now_s)
        estimate = judged.predicted(snapshot, now_s)
        error = _error(track, estimate, now_s)
        # a prediction is not cheap: every seventh will do
        ahead = [judged.predicted(snapshot, now_s + s) for s in BLIND_S] if len(rows) % 7 == 0 else []
        later = [(_error(track, e, now_s + s), e) for e, s in zip(ahead, BLIND_S, strict=False)]
        rows.append(
            (
                now_s,
                estimate.x,
                error,
                _nees(track, estimate, error),
                [e for e, _ in later],
                [_nees(track, e, wrong) for wrong, e in later],
            )
        )
    columns = list(zip(*rows, strict=True))
    blind = [[r for r in column if r] for column in columns[4:]]
    return Score(*(np.array(column) for column in (*columns[:4], *blind)))


def lag_s(track: SimulatedPadTrack, found: Score, axis: int = 2) -> float:
    """By how much the estimated acceleration of the pad trails the true one: where they agree best."""
    steps = np.arange(-10, 81)
    rows = np.rint(found.times_s * IMU_HZ).astype(int)
    misses = [np.sum((found.estimate[:, 6 + axis] - track.pad[2][rows - s, axis]) ** 2) for s in steps]
    return float(steps[int(np.argmin(misses))]) / IMU_HZ


@dataclass(frozen=True)
class Spikes:
    """What echoes did to the height (m) where the pad is seen no more, and what became of false ones."""

    worst_height_error_m: float
    false: int
    false_taken: int
    true_taken_share: float


def with_spikes(
    track: SimulatedPadTrack, blind_s: float = 2.0, spike_share: float = 0.2, false_m: float = 0.25
) -> Spikes:
    """Sink onto the pad with echoes of which some are wild; the last of the way by echoes alone."""
    judged = new_filter(track.motion_history())
    timeline: Timeline[Any, Any] = Timeline(judged, 1.0)
    end_s = track.duration_s - 1.0
    inputs: list[tuple[float, Any, float]] = [
        (s.time_s, s.fix, 0.0) for s in track.sights if s.time_s < end_s - blind_s
    ]
    inputs += [(e.time_s, e.fix, e.error_m) for e in track.echoes(spike_share) if e.time_s < end_s]
    false = false_taken = true = true_taken = 0
    for time_s, fix, error_m in sorted(inputs, key=lambda item: item[0]):
        before = judged.gates.get("range", Gate()).accepted
        timeline.add(time_s, fix)
        taken = judged.gates.get("range", Gate()).accepted - before
        if isinstance(fix, HeightMeasurement):
            wrong = abs(error_m) > false_m
            false, false_taken = false + wrong, false_taken + wrong * taken
            true, true_taken = true + (not wrong), true_taken + (not wrong) * taken
    errors = []
    for time_s in np.arange(end_s - blind_s, end_s, 0.1).tolist():
        estimate = judged.predicted(timeline.as_of(time_s) or judged.snapshot(), time_s)
        errors.append(abs(float(_error(track, estimate, time_s)[2])))
    return Spikes(max(errors), false, false_taken, true_taken / max(true, 1))


def late_frames_cost_m(track: SimulatedPadTrack, late_s: float = 0.25, every: int = 10) -> float:
    """How far (m) the state after a run is from that of the same run with every tenth frame late."""
    ends = []
    for late in (False, True):
        judged = new_filter(track.motion_history())
        timeline: Timeline[Any, Any] = Timeline(judged, 1.0)
        arrivals = [
            (s.arrival_s + (late_s if late and k % every == 0 and k else 0.0), s)
            for k, s in enumerate(track.sights)
        ]
        for _, sight in sorted(arrivals, key=lambda item: item[0]):
            assert timeline.add(sight.time_s, sight.fix)
        estimate = judged.predicted(judged.snapshot(), judged.time_s)
        assert estimate is not None
        ends.append(estimate.x)
    return float(np.abs(ends[0] - ends[1]).max())


def _error(track: SimulatedPadTrack, estimate: Any, time_s: float) -> FloatArray:
    row = round(time_s * IMU_HZ)
    truth = np.concatenate((track.relative[0][row], track.relative[1][row], track.pad[2][row]))
    return np.asarray(estimate.x - truth)


def _nees(track: SimulatedPadTrack, estimate: Any, error: FloatArray) -> float:
    if isinstance(estimate, CombinedEstimate):
        P = estimate.covariance(track.attitude_covariance, WANDER_RAD_S)
    else:
        swings = np.vstack((lever(estimate.x[:3]), lever(estimate.x[3:6])))
        P = estimate.P[:6, :6] + swings @ track.attitude_covariance @ swings.T
    return float(error[:6] @ np.linalg.solve(P, error[:6]))
