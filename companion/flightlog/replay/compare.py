"""What a replay came to: errors against the recording and the truth, as the contract of `replay.json`.

Attitude errors are BROAD's (Laidig et al. 2021): the rotation between the two in NED, and its parts about
the vertical (heading) and off it (inclination). A position whose origin the log does not show is compared
in shape: without the mean difference.
"""

import math
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray, Vector3, ned_from_geodetic, norm
from companion.base.message_json import encode
from companion.flightlog.errors import RecordedTrack, settled
from companion.flightlog.replay.flight_record import (
    FlightRecord,
    LogKind,
    RecordedReference,
    Source,
    TrackName,
    tracks_of_states,
)
from companion.flightlog.replay.plausible import implausible
from companion.flightlog.replay.run import Replayed
from companion.flightlog.result import ResultPart, six_decimals

_STATES_OF_AN_ANSWER: Final = 2  # the vehicle's and the pad's


class ErrorFigures(ResultPart):
    """Of the lengths of the errors."""

    rms: float
    p95: float
    worst: float
    samples: int


class ReplayErrors(ResultPart):
    """Replay minus reference; None where one of the two has nothing."""

    attitude_deg: ErrorFigures | None
    inclination_deg: ErrorFigures | None
    heading_deg: ErrorFigures | None
    velocity_m_s: ErrorFigures | None
    position_m: ErrorFigures | None
    pad_position_m: ErrorFigures | None
    pad_velocity_m_s: ErrorFigures | None


class Biases(ResultPart):
    """What the EKF makes of the sensors at the end."""

    gyro_rad_s: Vector3
    accel_m_s2: Vector3


class FieldUsed(ResultPart):
    """The Earth's field that the estimators expected, and who says so."""

    ned_ut: Vector3
    source: str


class Repetition(ResultPart):
    """Whether the states are the recorded ones to the bit; else from when on they are not."""

    identical: bool
    states: int
    differs_from_s: float | None


class ReplayResult(ResultPart):
    """The whole contract."""

    log: str
    kind: LogKind
    duration_s: float
    aligned_after_s: float | None
    settings: str
    field: FieldUsed
    samples: dict[str, int]
    refused: dict[str, int]
    errors: dict[Source, ReplayErrors]
    biases: Biases | None
    repetition: Repetition | None
    notes: tuple[str, ...]


Series = tuple[FloatArray, FloatArray]


class Comparison:
    """Differences between a replay and one reference: (times (n,), rows) of each quantity."""

    def __init__(self, replayed: Replayed, reference: RecordedReference) -> None:
        ours = tracks_of(replayed)
        self.tracks = {
            name: (ours[name], track)
            for name, track in _moved(reference, _origin(replayed)).items()
            if name in ours
        }
        self.position_is_shape = reference.origin is None or _origin(replayed) is None

    def attitude_deg(self) -> Series:
        """Total, inclination and heading errors (n, 3), the first two not negative."""
        if "attitude" not in self.tracks:
            return np.zeros(0), np.zeros((0, 3))
        times, ours, theirs = _paired(*self.tracks["attitude"])
        return times, attitude_errors_deg(ours, theirs)

    def vector(self, name: TrackName) -> Series:
        """Replay minus reference (n, 3) of any other quantity."""
        if name not in self.tracks:
            return np.zeros(0), np.zeros((0, 3))
        times, ours, theirs = _paired(*self.tracks[name])
        difference = ours - theirs
        if name == "position" and self.position_is_shape and len(difference):
            difference = difference - difference.mean(axis=0)
        return times, difference

    def errors(self) -> ReplayErrors:
        _, attitude = self.attitude_deg()
        return ReplayErrors(
            attitude_deg=_figures(attitude[:, 0]),
            inclination_deg=_figures(attitude[:, 1]),
            heading_deg=_figures(attitude[:, 2]),
            velocity_m_s=_figures(_lengths(self.vector("velocity"))),
            position_m=_figures(_lengths(self.vector("position"))),
            pad_position_m=_figures(_lengths(self.vector("pad_position"))),
            pad_velocity_m_s=_figures(_lengths(self.vector("pad_velocity"))),
        )


def build_result(
    record: FlightRecord, replayed: Replayed, *, log: str, settings: str, field: FieldUsed, repeats: bool
) -> ReplayResult:
    """Put the contract together; `repeats`: the settings are those of the flight, so it should repeat."""
    vehicles = replayed.vehicles
    last = vehicles[-1] if vehicles else None
    start_s = record.events[0].arrival_s
    notes = [record.cut] if record.cut else []
    # ours counts from another zero than the events' stamps: the first sample's own time is the start
    first = next(e.item.time_s for e in record.events)
    return ReplayResult(
        log=log,
        kind=record.kind,
        duration_s=six_decimals(record.events[-1].arrival_s - start_s),
        aligned_after_s=six_decimals(vehicles[0].time_s - first) if vehicles else None,
        settings=settings,
        field=field,
        samples=dict(sorted(replayed.samples.items())),
        refused={kind: count for kind, count in sorted(replayed.refused[-1][1].items()) if count},
        errors={
            source: Comparison(replayed, reference).errors()
            for source, reference in record.references.items()
        },
        biases=None
        if last is None
        else Biases(gyro_rad_s=last.gyro_bias_rad_s, accel_m_s2=last.accel_bias_m_s2),
        repetition=repetition(record, replayed) if repeats and record.states else None,
        notes=(
            *notes,
            *record.notes,
            *implausible(
                last,
                max((norm(v.velocity_ned_m_s) for v in vehicles if v.has_gps), default=0.0),
                replayed.samples,
                replayed.refused[-1][1],
                record.references,
                _origin(replayed),
            ),
        ),
    )


def repetition(record: FlightRecord, replayed: Replayed) -> Repetition:
    """Compare the states as they stand in a log, digit by digit.

    A log that was cut short may lack what the last question in it was answered with.
    """
    pairs = zip(record.states, replayed.states, strict=False)
    first = next((old.time_s for old, new in pairs if encode(old) != encode(new)), None)
    missing = len(replayed.states) - len(record.states)
    cut_off = record.cut is not None and 0 <= missing <= _STATES_OF_AN_ANSWER
    if first is None and missing != 0 and not cut_off:
        longer = max(record.states, replayed.states, key=len)
        first = longer[min(len(record.states), len(replayed.states))].time_s
    return Repetition(identical=first is None, states=len(record.states), differs_from_s=first)


# ---------------------------------------------------------------- tracks


def tracks_of(replayed: Replayed) -> dict[TrackName, RecordedTrack]:
    """The replay's own tracks; the pad's from 2 s after it came into view, while it is in view."""
    return tracks_of_states(replayed.vehicles, settled(replayed.pads))


def _origin(replayed: Replayed) -> Vector3 | None:
    return next((v.origin for v in reversed(replayed.vehicles) if v.origin is not None), None)


def _moved(reference: RecordedReference, origin: Vector3 | None) -> dict[TrackName, RecordedTrack]:
    """The reference's tracks with positions counted from our origin, when both origins are known."""
    tracks = dict(reference.tracks)
    if "position" in tracks and reference.origin is not None and origin is not None:
        shift = np.array(ned_from_geodetic(*reference.origin, origin))
        tracks["position"] = RecordedTrack(tracks["position"].time_s, tracks["position"].values + shift)
    return tracks


def _paired(ours: RecordedTrack, theirs: RecordedTrack) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Both at the times of the sparser one: what is interpolated is the one that knows more."""
    times = min((theirs, ours), key=len).time_s
    times = times[np.logical_and(ours.covers(times), theirs.covers(times))]
    return times, ours.at(times), theirs.at(times)


# ---------------------------------------------------------------- figures


def attitude_errors_deg(ours: FloatArray, theirs: FloatArray) -> FloatArray:
    """Total, inclination and heading errors (n, 3) of quaternions (n, 4), body to NED."""
    w1, x1, y1, z1 = theirs.T
    w2, x2, y2, z2 = ours.T * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    w = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
    x = w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2
    y = w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2
    z = w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
    tilt, turn = np.hypot(x, y), np.hypot(w, z)
    # by arc tangents: an arc cosine near 1 loses half of the digits
    total = 2.0 * np.arctan2(np.hypot(tilt, z), np.abs(w))
    inclination = 2.0 * np.arctan2(tilt, turn)
    heading = 2.0 * np.arctan2(np.where(w < 0.0, -z, z), np.abs(w))
    return np.asarray(np.degrees(np.stack([total, inclination, heading], axis=1)))


def _lengths(series: Series) -> FloatArray:
    return np.asarray(np.linalg.norm(series[1], axis=1))


def _figures(errors: FloatArray) -> ErrorFigures | None:
    if not len(errors):
        return None
    sizes = np.abs(errors)
    return ErrorFigures(
        rms=six_decimals(math.sqrt(float(np.mean(sizes**2)))),
        p95=six_decimals(float(np.percentile(sizes, 95))),
        worst=six_decimals(float(sizes.max())),
        samples=len(sizes),
    )
