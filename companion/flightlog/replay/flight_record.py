"""What a recorded flight holds, whatever wrote it: the sensors' samples in the order in which they arrived,
and tracks to hold the replay against.

Times are seconds of the log's own clock; a sample's `time_s` is when it was measured, an event's
`arrival_s` when the estimators could have had it. NED and FRD, SI units, µT.
"""

from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

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
from companion.config import CameraConfig, CompanionConfig, VehicleConfig
from companion.flightlog.errors import RecordedTrack
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
