"""What the plan stage gives: the phase, the reference, and the requests to the autopilot."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from companion.base.geometry import FloatArray, Vector3


class Phase(StrEnum):
    """The states of the mission, in the order of a good flight; standby, hold and abort are not."""

    STANDBY = "standby"
    CONNECT = "connect"
    ARM = "arm"
    TAKE_OFF = "take_off"
    WAYPOINT = "waypoint"
    ROUTE = "route"
    SEARCH = "search"
    APPROACH = "approach"
    DESCEND = "descend"
    TOUCHDOWN = "touchdown"
    LANDED = "landed"
    HOLD = "hold"
    ABORT = "abort"


class Outcome(StrEnum):
    """How a simulated flight ended, judged by the truth."""

    LANDED = "landed"
    MISSED = "missed"
    ABORTED = "aborted"
    TIMEOUT = "timeout"
    CRASHED = "crashed"


class ActionKind(StrEnum):
    """What a mission asks of the autopilot besides setpoints."""

    ARM = "arm"
    TAKE_OFF = "take_off"
    GO_TO = "go_to"
    TAKE_CONTROL = "take_control"
    LEAVE_OFFBOARD = "leave_offboard"
    HOLD = "hold"
    LAND = "land"
    DISARM = "disarm"
    REQUEST_PAD_POSITION = "request_pad_position"


@dataclass(frozen=True, slots=True)
class Action:
    """One request to the autopilot or the ground station.

    `position` is latitude (deg), longitude (deg) and height over home (m); so is `height_m`, over home: to
    take off to, and for a HOLD to rise to first unless 0. `force` lets a DISARM through
    that the autopilot refuses because it considers itself in the air: in the air it drops the vehicle, so
    only a touchdown that several signs have confirmed for seconds may ask for it.
    """

    kind: ActionKind
    height_m: float = 0.0
    position: Vector3 | None = None
    heading_rad: float | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class ActionResult:
    """How an action ended; a refused one carries the autopilot's text."""

    time_s: float
    kind: ActionKind
    accepted: bool
    text: str = ""


@dataclass(frozen=True, slots=True)
class DescentCone:
    """How far aside of the pad a descent may be: radius_m + slope * (height over the pad - apex_height_m)."""

    slope: float
    radius_m: float
    apex_height_m: float


@dataclass(frozen=True, slots=True)
class LevelOff:
    """When (app's clock) the vehicle may be tilted by no more than tilt_rad: its feet are about to touch."""

    from_s: float
    until_s: float
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the vehicle should be over the coming horizon, one row a step.

    origin "pad": rows count from the pad and move with it, NED axes (above the pad z is negative).
    origin "local": rows count from the EKF's origin, NED.
    Arrays are (n, 3); row k holds at time_s + k * step_s. `minimum_height_m` and `cone` bound where the
    vehicle may be about the pad, with origin "pad" alone.
    """

    time_s: float
    origin: Literal["pad", "local"]
    step_s: float
    position_m: FloatArray = field(metadata={"columns": 3})
    velocity_m_s: FloatArray = field(metadata={"columns": 3})
    acceleration_m_s2: FloatArray = field(metadata={"columns": 3})
    heading_rad: float
    minimum_height_m: float | None = None
    cone: DescentCone | None = None
    level_off: LevelOff | None = None


@dataclass(frozen=True, slots=True)
class Notice:
    """Something worth telling: to the log, the terminal and, as STATUSTEXT, the ground station."""

    time_s: float
    kind: str
    text: str
    severity: Literal["info", "warning", "error"] = "info"


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the speed of approach and descent goes by beside the way to go; `pace` is the factor on it.

    `sight_rad` is the standard deviation of the pad's place as an angle seen from the vehicle,
    `relative_speed_m_s` the horizontal speed over the pad beyond the planned, `gust_m_s2` the standard
    deviation of the horizontal acceleration that the wind makes.
    """

    sight_rad: float
    relative_speed_m_s: float
    gust_m_s2: float
    pace: float = 1.0


@dataclass(frozen=True, slots=True)
class PlanStep:
    """What the planner makes of one cycle. No reference: no setpoint leaves."""

    time_s: float
    phase: Phase
    reference: Reference | None = None
    actions: tuple[Action, ...] = ()
    notices: tuple[Notice, ...] = ()
    speed_m_s: float = 0.0
    time_to_go_s: float = 0.0
    on_ground: bool = False
    conditions: Conditions | None = None
