"""Quantities over time, and sightings and estimates against the truth. SI units, times of the app's clock."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import PadSighting, PadState, Truth

# the pad's velocity counts once it has been in view for this long, and while it is
SEEN_FOR_S: Final = 2.0
SEEN_GAP_S: Final = 0.5
# between samples further apart than this a track knows nothing
TRACK_GAP_S: Final = 0.5


class RecordedTrack:
    """A quantity over time: quaternions (n, 4) or vectors (n, 3); interpolated, but not across gaps."""

    def __init__(self, times_s: Sequence[float] | FloatArray, rows: Sequence[Sequence[float]]) -> None:
        """Take rows in any order; of several at one time the last counts."""
        times, values = np.asarray(times_s, dtype=float), np.asarray(rows, dtype=float)
        newest_first = np.unique(times[::-1], return_index=True)[1]
        self.time_s: FloatArray = times[::-1][newest_first]
        self.values: FloatArray = values[::-1][newest_first]
        if self.values.shape[1] == 4:
            self._make_continuous()

    def __len__(self) -> int:
        return len(self.time_s)

    def covers(self, times_s: FloatArray) -> FloatArray:
        """Mask (n,) of the times that have a sample on both sides, near enough to interpolate between."""
        inside = (times_s >= self.time_s[0]) & (times_s <= self.time_s[-1])
        after = np.minimum(np.searchsorted(self.time_s, times_s), len(self) - 1)
        exact = self.time_s[after] == times_s
        near = np.diff(self.time_s)[np.maximum(after, 1) - 1] <= TRACK_GAP_S
        return np.asarray(inside & (near | exact))

    def at(self, times_s: FloatArray) -> FloatArray:
        """Rows at times within the track; quaternions are of unit length."""
        columns = [np.interp(times_s, self.time_s, column) for column in self.values.T]
        rows: FloatArray = np.stack(columns, axis=1)
        if rows.shape[1] == 4:
            rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        return rows

    def _make_continuous(self) -> None:
        """Flip signs so that neighbours lie on the same half of the sphere."""
        products = np.sum(self.values[1:] * self.values[:-1], axis=1)
        flips = np.cumprod(np.where(products < 0.0, -1.0, 1.0))
        self.values[1:] *= flips[:, None]


def track_of(samples: Iterable[tuple[float, Sequence[float]]]) -> RecordedTrack | None:
    """A track of (time, row) pairs; None of fewer than two, or when a row is not finite in all of them."""
    kept = [(time_s, row) for time_s, row in samples if np.isfinite(row).all()]
    if len(kept) < 2:
        return None
    return RecordedTrack([time_s for time_s, _ in kept], [row for _, row in kept])


class TruthTrack:
    """The truth as tracks, interpolated at any times within the flight."""

    def __init__(self, truth: Sequence[Truth]) -> None:
        """Take the records in order of time (at least two).

        Raises:
            ValueError: fewer than two records.
        """
        if len(truth) < 2:
            raise ValueError("a truth track needs at least two records")
        self.time_s = np.array([t.time_s for t in truth])
        columns: dict[str, list[Sequence[float]]] = {
            "position": [t.vehicle_position_ned_m for t in truth],
            "velocity": [t.vehicle_velocity_ned_m_s for t in truth],
            "pad_position": [t.pad_position_ned_m for t in truth],
            "pad_velocity": [t.pad_velocity_ned_m_s for t in truth],
            "in_contact": [(float(t.in_contact),) for t in truth],
            "attitude": [t.vehicle_attitude for t in truth],
        }
        self._tracks = {name: RecordedTrack(self.time_s, rows) for name, rows in columns.items()}

    def at(self, name: str, times_s: FloatArray) -> FloatArray:
        """Interpolate a column: position, velocity, pad_position, pad_velocity, in_contact, attitude."""
        return self._tracks[name].at(times_s)

    def covers(self, times_s: FloatArray) -> Any:
        """Boolean mask of the times that lie within the track."""
        return (times_s >= self.time_s[0]) & (times_s <= self.time_s[-1])


def sighting_errors_body_m(
    sightings: Sequence[PadSighting], track: TruthTrack
) -> tuple[FloatArray, FloatArray]:
    """Times (n,) and errors (n, 3) of the sightings' pad position in true body axes (m)."""
    times = np.array([s.time_s for s in sightings])
    inside = track.covers(times)
    times = times[inside]
    measured = np.array([s.pad_position_body_m for s in sightings]).reshape(-1, 3)[inside]
    relative = track.at("pad_position", times) - track.at("position", times)
    attitudes = track.at("attitude", times)
    expected = [matrix_from_quat(tuple(q)).T @ r for q, r in zip(attitudes, relative, strict=True)]
    return times, measured - np.array(expected).reshape(-1, 3)


def estimate_errors(kept: Mapping[str, Sequence[Any]], track: TruthTrack) -> dict[str, FloatArray]:
    """Errors of the estimators against the truth, airborne only.

    Returns arrays: `time_s` (n,), `attitude_deg` (n,), `velocity_m_s` (n, 3) of the vehicle; `pad_time_s`
    (m,), `pad_position_m` (m, 3), `pad_velocity_m_s` (m, 3) of the pad once it has been seen for 2 s.
    """
    times, attitude, velocity = _vehicle_errors(kept.get("vehicle", ()), track)
    pads = [pad for pad in settled(kept.get("pad", ())) if track.covers(np.array([pad.time_s]))[0]]
    pad_times = np.array([pad.time_s for pad in pads])
    position = np.array([pad.relative_position_ned_m for pad in pads]).reshape(-1, 3)
    pad_velocity = np.array([pad.velocity_ned_m_s for pad in pads]).reshape(-1, 3)
    return {
        "time_s": times,
        "attitude_deg": attitude,
        "velocity_m_s": velocity,
        "pad_time_s": pad_times,
        "pad_position_m": position - (track.at("pad_position", pad_times) - track.at("position", pad_times)),
        "pad_velocity_m_s": pad_velocity - track.at("pad_velocity", pad_times),
    }


def _vehicle_errors(vehicles: Sequence[Any], track: TruthTrack) -> tuple[FloatArray, FloatArray, FloatArray]:
    times = np.array([v.time_s for v in vehicles])
    attitudes = np.array([v.attitude for v in vehicles]).reshape(-1, 4)
    velocities = np.array([v.velocity_ned_m_s for v in vehicles]).reshape(-1, 3)
    inside = track.covers(times)
    airborne = inside & (track.at("in_contact", times)[:, 0] < 0.5)
    times, attitudes, velocities = times[airborne], attitudes[airborne], velocities[airborne]
    cosine = np.abs(np.sum(attitudes * track.at("attitude", times), axis=1))
    attitude_deg = np.degrees(2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)))
    return times, attitude_deg, velocities - track.at("velocity", times)


def settled(pads: Sequence[PadState]) -> list[PadState]:
    """The states from 2 s after the pad came into view, for as long as it stays there."""
    settled: list[PadState] = []
    since: float | None = None
    for pad in pads:
        if pad.time_s - pad.seen_time_s > SEEN_GAP_S:
            since = None
            continue
        since = pad.time_s if since is None else since
        if pad.time_s - since >= SEEN_FOR_S:
            settled.append(pad)
    return settled
