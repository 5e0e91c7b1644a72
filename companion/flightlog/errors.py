"""Sightings and estimates against the truth. SI units, times of the app's clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import PadSighting, PadState, Truth

# the pad's velocity counts once it has been in view for this long, and while it is
SEEN_FOR_S: Final = 2.0
SEEN_GAP_S: Final = 0.5


class TruthTrack:
    """The truth as arrays, interpolated at any times within the flight."""

    def __init__(self, truth: Sequence[Truth]) -> None:
        """Take the records in order of time (at least two).

        Raises:
            ValueError: fewer than two records.
        """
        if len(truth) < 2:
            raise ValueError("a truth track needs at least two records")
        self.time_s = np.array([t.time_s for t in truth])
        self._columns = {
            "position": np.array([t.vehicle_position_ned_m for t in truth]),
            "velocity": np.array([t.vehicle_velocity_ned_m_s for t in truth]),
            "pad_position": np.array([t.pad_position_ned_m for t in truth]),
            "pad_velocity": np.array([t.pad_velocity_ned_m_s for t in truth]),
            "in_contact": np.array([[float(t.in_contact)] for t in truth]),
            "attitude": _continuous(np.array([t.vehicle_attitude for t in truth])),
        }

    def at(self, name: str, times_s: FloatArray) -> FloatArray:
        """Interpolate a column: position, velocity, pad_position, pad_velocity, in_contact, attitude."""
        column = self._columns[name]
        values = np.stack(
            [np.interp(times_s, self.time_s, column[:, k]) for k in range(column.shape[1])], axis=1
        )
        if name == "attitude":
            values /= np.linalg.norm(values, axis=1, keepdims=True)
        return values

    def covers(self, times_s: FloatArray) -> Any:
        """Boolean mask of the times that lie within the track."""
        return (times_s >= self.time_s[0]) & (times_s <= self.time_s[-1])


def _continuous(quaternions: FloatArray) -> FloatArray:
    """Flip signs so that neighbours lie on the same half of the sphere, for interpolation."""
    flips = np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(flips)[:, None]
    return quaternions


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
