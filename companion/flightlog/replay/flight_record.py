"""What a recorded flight holds, whatever wrote it: the sensors' samples in the order in which they arrived,
and tracks to hold the replay against.

Times are seconds of the log's own clock; a sample's `time_s` is when it was measured, an event's
`arrival_s` when the estimators could have had it. NED and FRD, SI units, µT.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

import numpy as np

from companion.base.geometry import FloatArray, Vector3
from companion.base.messages import (
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadSighting,
    PadState,
    RangeSample,
    VehicleState,
)
from companion.config import CameraConfig, CompanionConfig, VehicleConfig
from companion.pad import Pad

# between samples further apart than this a track knows nothing
TRACK_GAP_S: Final = 0.5

Sample = ImuSample | MagSample | GpsFix | RangeSample | PadSighting | AutopilotAttitude
TrackName = Literal["attitude", "velocity", "position", "pad_position", "pad_velocity"]
Source = Literal["recorded", "truth"]
LogKind = Literal["companion", "ardupilot", "px4"]


@dataclass(frozen=True, slots=True)
class Ask:
    """The estimators were asked for their states here, at this time (a control cycle of the app)."""

    time_s: float


class RecordedEvent(NamedTuple):
    """Something that reached the estimators."""

    arrival_s: float
    item: Sample | Ask


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
        after = np.searchsorted(self.time_s, times_s)
        inside = (times_s >= self.time_s[0]) & (times_s <= self.time_s[-1])
        after = np.clip(after, 1, len(self.time_s) - 1)
        exact = self.time_s[np.clip(np.searchsorted(self.time_s, times_s), 0, len(self) - 1)] == times_s
        near = self.time_s[after] - self.time_s[after - 1] <= TRACK_GAP_S
        mask: FloatArray = inside & (near | exact)
        return mask

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


@dataclass(frozen=True, slots=True)
class RecordedReference:
    """What the replay is held against.

    `origin` (latitude deg, longitude deg, altitude m) is where the position track counts from; None when
    the log does not say, and then only the shape of the path can be compared.
    """

    tracks: dict[TrackName, RecordedTrack]
    origin: Vector3 | None = None


@dataclass(frozen=True, slots=True)
class ReplaySetup:
    """What the app's estimators are made from, and the camera whose sightings they took."""

    config: CompanionConfig
    vehicle: VehicleConfig
    pad: Pad
    camera: CameraConfig | None = None


@dataclass(frozen=True, slots=True)
class RecordingPlace:
    """Where and when a log was recorded, for the Earth's field: altitude over the sea will do."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    year: float | None


@dataclass(slots=True)
class FlightRecord:
    """A whole log.

    `states` are the app's own estimates as recorded, to the bit (ours only). `cut` says where a log that
    ends in the middle of something does so; `notes` is what else a reader of the results should know.
    """

    kind: LogKind
    events: list[RecordedEvent]
    references: dict[Source, RecordedReference]
    rig: ReplaySetup | None = None
    states: list[VehicleState | PadState] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    place: RecordingPlace | None = None
    antenna_position_body_m: Vector3 | None = None
    cut: str | None = None
    notes: list[str] = field(default_factory=list)
