"""What a recorded flight holds, whatever wrote it: the sensors' samples in the order in which they arrived,
and tracks to hold the replay against.

Times are seconds of the log's own clock; a sample's `time_s` is when it was measured, an event's
`arrival_s` when the estimators could have had it. NED and FRD, SI units, µT.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from companion.base.geometry import Vector3
from companion.base.messages import (
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadObservation,
    PadState,
    RangeSample,
    VehicleState,
)
from companion.config import CameraConfig, CompanionConfig, ConfigError, VehicleConfig
from companion.flightlog.errors import RecordedTrack, track_of
from companion.pad import Pad

Sample = ImuSample | MagSample | GpsFix | RangeSample | AutopilotAttitude | PadObservation
TrackName = Literal["attitude", "velocity", "position", "pad_position", "pad_velocity"]
Source = Literal["recorded", "truth"]
LogKind = Literal["companion", "ardupilot", "px4"]
SECONDS_PER_YEAR: Final = 365.2425 * 86_400.0
# µT in one of each unit of a magnetic field
UT_PER: Final = {"T": 1e6, "G": 100.0, "mT": 1e3, "uT": 1.0, "mG": 0.1, "nT": 1e-3}


@dataclass(frozen=True, slots=True)
class Ask:
    """The estimators were asked for their states here, at this time (a control cycle of the app)."""

    time_s: float


class RecordedEvent(NamedTuple):
    """Something that reached the estimators."""

    arrival_s: float
    item: Sample | Ask


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

    `settings` are what it was made under, by name, and `states` the app's own estimates as recorded,
    to the bit (ours only). `cut` says where a log that
    ends in the middle of something does so; `notes` is what else a reader of the results should know.
    """

    kind: LogKind
    events: list[RecordedEvent]
    references: dict[Source, RecordedReference]
    rig: ReplaySetup | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    states: list[VehicleState | PadState] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    place: RecordingPlace | None = None
    antenna_position_body_m: Vector3 | None = None
    cut: str | None = None
    notes: list[str] = field(default_factory=list)


@contextmanager
def damage_reported(path: Path, kind: str) -> Iterator[None]:
    """Report in one line what Python raises where a library meets garbage, whatever that is.

    Raises:
        ConfigError: it raised something, or what is within did.
        OSError: the file cannot be read at all.
    """
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except OSError:
        raise
    except Exception as error:
        raise ConfigError(
            f"{path}: not a {kind} that can be read: {type(error).__name__}: {error}; "
            "expected one as the autopilot wrote it"
        ) from error


def known_tracks(**samples: Iterable[tuple[float, Sequence[float]]]) -> dict[TrackName, RecordedTrack]:
    """The tracks by name of (time, row) pairs, of those that have any; see `track_of`."""
    tracks = {name: track_of(pairs) for name, pairs in samples.items()}
    return {name: track for name, track in tracks.items() if track is not None}  # type: ignore[misc]


def tracks_of_states(
    vehicles: Sequence[VehicleState], pads: Sequence[PadState]
) -> dict[TrackName, RecordedTrack]:
    """The tracks of the estimates; the position's once it has an origin."""
    return known_tracks(
        attitude=((v.time_s, v.attitude) for v in vehicles),
        velocity=((v.time_s, v.velocity_ned_m_s) for v in vehicles),
        position=((v.time_s, v.position_ned_m) for v in vehicles if v.origin is not None),
        pad_position=((p.time_s, p.relative_position_ned_m) for p in pads),
        pad_velocity=((p.time_s, p.velocity_ned_m_s) for p in pads),
    )


def known_references(
    recorded: RecordedReference, truth: RecordedReference
) -> dict[Source, RecordedReference]:
    """Those of the two that have tracks."""
    found: dict[Source, RecordedReference] = {"recorded": recorded, "truth": truth}
    return {source: reference for source, reference in found.items() if reference.tracks}


def antenna_by(parameters: Mapping[str, float], *prefixes: str) -> Vector3 | None:
    """Where the GPS antenna is by an autopilot's parameters, of the first names that it has; FRD (m)."""
    for prefix in prefixes:
        if f"{prefix}X" in parameters:
            x, y, z = (float(parameters.get(f"{prefix}{axis}", 0.0)) for axis in "XYZ")
            return (x, y, z)
    return None
