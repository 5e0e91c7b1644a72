"""Modes, arming checks and failsafes as data: the entries of an autopilot's profile.

A mode is what the autopilot reports; a task is what it flies. Some modes allow one task only, ArduPilot's
GUIDED allows several. A check or failsafe is a predicate on the `VehicleStatus`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from math import inf


class Task(Enum):
    """What is being flown."""

    HOLD = "hold"
    TAKE_OFF = "take off"
    GO_TO = "go to"
    SETPOINT = "setpoint"
    LAND = "land"
    RETURN = "return"
    DESCEND = "descend"
    MISSION = "mission"
    PRECISION_LAND = "precision land"


class StickMode(Enum):
    """Meaning of the sticks: velocities, tilt angles and climb rate, or tilt angles and thrust."""

    VELOCITY = "velocity"
    ANGLE_AND_CLIMB = "angle and climb"
    ANGLE_AND_THRUST = "angle and thrust"


class CommandResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Severity(IntEnum):
    """MAV_SEVERITY, as far as used."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    INFO = 6


@dataclass(frozen=True, slots=True)
class Mode:
    """One flight mode: HEARTBEAT's custom_mode, base_mode without the armed bit, and what it may do.

    `title` is its name in texts. A mode with `sticks` is flown by them once there are any, and holds until
    then. One `by_attitude` is flown by streamed attitudes alone: one that climbs lifts off, and without any
    it holds level at its height, not at its place. One that is not `available` is known and always refused.
    """

    name: str
    custom_mode: int
    base_mode: int
    task: Task
    takes_setpoints: bool = False
    by_attitude: bool = False
    armable: bool = True
    in_flight: bool = True
    sticks: StickMode | None = None
    title: str = ""
    available: bool = True

    @property
    def display_name(self) -> str:
        return self.title or self.name


@dataclass(slots=True)
class VehicleStatus:
    """Input of checks and failsafes; times in seconds, `setpoint_age_s` since the last streamed one.

    `rc_available`: RC input is received; `rc_lost`: it was received and no longer is. `mission_ready`:
    there is one to fly, `mission_climbs`: and it begins with a take-off. `setpoints_lost_action`: what the
    autopilot's parameter says of it; `fence_action` the same of a `fence_broken`.
    """

    armed: bool = False
    rc_available: bool = False
    rc_lost: bool = False
    throttle_up: bool = False
    mission_ready: bool = False
    mission_climbs: bool = False
    aligned: bool = False
    home_set: bool = False
    armable: bool = True
    landed: bool = True
    has_flown: bool = False
    task: Task = Task.HOLD
    tilt_rad: float = 0.0
    setpoint_age_s: float = inf
    setpoint_timeout_s: float = 1.0
    setpoints_lost_action: int = 0
    fence_broken: bool = False
    fence_action: int = 0
    streaming: bool = False


Condition = Callable[[VehicleStatus], bool]


@dataclass(frozen=True, slots=True)
class ArmingCheck:
    """Arming is refused with `text` unless `passes`."""

    passes: Condition
    text: str


@dataclass(frozen=True, slots=True)
class ModeCheck:
    """A mode is refused with `text` (which may name the `{mode}`) when it `fails`."""

    fails: Callable[[Mode, VehicleStatus], bool]
    text: str


@dataclass(frozen=True, slots=True)
class Failsafe:
    """When `condition` has held for `after_s`, send `text` and disarm, or go to `mode` if there is one.

    It goes back as soon as the condition has ended; with `over` it stays there, and
    does not trigger again before that has been so: a mode chosen meanwhile is the pilot's decision.
    `task` is flown there instead of the mode's own.
    """

    condition: Condition
    after_s: float
    severity: Severity
    text: str
    mode: str = ""
    over: Condition | None = None
    task: Task | None = None
