"""What goes from the app's process to the page's."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from companion.app.page.access import Access
from companion.base.geometry import Quaternion, Vector3
from companion.base.messages import Frame, PadSighting
from companion.config import CameraConfig, ServeConfig, VehicleConfig
from companion.pad import Pad


@dataclass(frozen=True, slots=True)
class Start:
    """What the page's process begins with; the token stands neither in its arguments nor its environment.

    `start_unix_s` is seconds since 1970 at loop time 0, `start_s` the app's start in loop time.
    """

    access: Access
    serve: ServeConfig
    camera: CameraConfig
    vehicle: VehicleConfig
    pad: Pad
    start_unix_s: float
    start_s: float
    flights: Path | None = None  # where flights are recorded
    settings_text: str = ""


class TrackPoint(NamedTuple):
    """A point of the plots: the feet over the pad where it is known, and over the EKF's origin (m)."""

    time_s: float
    height_m: float | None
    lateral_m: float | None
    altitude_m: float | None


@dataclass(frozen=True, slots=True)
class Look:
    """One camera frame with what was seen in it; without a camera the frame is None.

    `attitude` is the vehicle's near the exposure. `touchdown_ned_m` is where the pad will be when the planned
    motion ends, relative to where the vehicle was then, NED axes. The time is without waiting over the pad.
    """

    point: TrackPoint
    phase: str
    frame: Frame | None = None
    sighting: PadSighting | None = None
    attitude: Quaternion | None = None
    touchdown_ned_m: Vector3 | None = None
    time_to_touchdown_s: float | None = None


@dataclass(frozen=True, slots=True)
class Text:
    """JSON for every viewer; the newest of a kind takes the place of older ones that wait."""

    kind: str
    json: str


@dataclass(frozen=True, slots=True)
class Reply:
    """What became of the order that the page's process numbered so."""

    number: int
    kind: str
    outcome: str
    text: str
