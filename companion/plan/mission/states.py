"""The vocabulary of the mission's table: states, events, who has the vehicle, guards, effects, rows.

A state is a phase of the mission, or one of its sub-phases: the touchdown has six, a hold has two. No clock,
no I/O.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from companion.base.messages import Action, Phase


class State(StrEnum):
    """Where the mission is; `phase` is what the log, the terminal and the time limits call it."""

    STANDBY = "standby"  # watches, asks for nothing, waits for an order
    CONNECT = "connect"
    ARM = "arm"
    TAKE_OFF = "take_off"
    WAYPOINT = "waypoint"
    ROUTE = "route"
    SEARCH = "search"
    APPROACH = "approach"
    DESCEND = "descend"
    WAIT = "wait"  # just over the pad, for a moment to land
    SINK = "sink"  # committed: down at a constant speed
    RISE = "rise"  # broken off: back up to where it waits
    SET_DOWN = "set_down"  # too low to rise, and nothing to follow: straight down, by the autopilot's LAND
    STAND = "stand"  # the feet are on the pad
    AUTO_LAND = "auto_land"  # on the pad in the autopilot's LAND mode, until it detects the landing
    LANDED = "landed"
    HOLD = "hold"
    AWAIT_LINK = "await_link"  # a hold that ends when the autopilot is heard again
    ABORT = "abort"

    @property
    def phase(self) -> Phase:
        """The phase that this is, or is a part of."""
        return _PART_OF.get(self) or Phase(self.value)


_PART_OF: Final = {
    **dict.fromkeys(
        (State.WAIT, State.SINK, State.RISE, State.SET_DOWN, State.STAND, State.AUTO_LAND), Phase.TOUCHDOWN
    ),
    State.AWAIT_LINK: Phase.HOLD,
}


class MissionEvent(StrEnum):
    """What can happen to a mission."""

    LAND_ORDERED = "land_ordered"  # in standby, and nothing stands against it
    FLY_ORDERED = "fly_ordered"
    READY = "ready"  # autopilot connected and ready to arm, our estimate aligned
    ALREADY_ARMED = "already_armed"  # and not by us
    ALIGNMENT_LOST = "alignment_lost"  # our estimate's, before the autopilot would arm
    ARMED = "armed"
    AIRBORNE = "airborne"  # take-off height reached
    BLOCKED = "blocked"  # the same, but an obstacle is in the straight way that the autopilot would fly
    HOME_UNKNOWN = "home_unknown"  # the same, but where the obstacles are is not known
    ARRIVED = "arrived"  # at the waypoint, slow
    ONWARD = "onward"  # the same, but further waypoints are ours to fly to
    STREAMING = "streaming"  # setpoints have left for long enough to ask for control
    CONTROL_GRANTED = "control_granted"  # and the autopilot obeys setpoints
    PAD_SEEN = "pad_seen"  # steadily, and setpoints of ours are obeyed where that matters
    CENTRED = "centred"  # above the pad, within the descent cone
    LOW = "low"  # at the height from which touchdown is one straight go
    COMMIT = "commit"  # aligned over a pad that is gentle, for a moment
    CLEAR = "clear"  # at rest by our setpoints, and clear of the pad
    BREAK_OFF = "break_off"  # in the final descent, with room to stop
    RISEN = "risen"  # climbing after a break-off
    CONTACT = "contact"  # several signs say that the feet stand on the pad
    LANDING_DETECTED = "landing_detected"  # by the autopilot
    AT_REST = "at_rest"  # shown to rest on the pad, without the autopilot's word
    UNPROVEN = "unproven"  # neither, and nothing shows the feet down
    PAD_GONE = "pad_gone"  # in the final descent, where there is no room to rise either
    OFF_PAD = "off_pad"  # it does not stay: the pad is well below or slides, or a silent link may have it off
    PAD_LOST = "pad_lost"
    GROUND_NEAR = "ground_near"  # echoes far nearer than the pad's estimate: the estimate is wrong
    MISALIGNED = "misaligned"  # no touchdown from here: climb and try again
    REFUSED = "refused"  # an action, as often as it may be asked
    TIMEOUT = "timeout"  # of the phase
    OVERTIME = "overtime"  # of the whole mission, from take-off or the order to land
    DISARMED = "disarmed"
    TAKEN_OVER = "taken_over"
    STOP = "stop_requested"
    SUSPENDED = "suspended"  # our computer was: what is known is from long before
    LINK_LOST = "link_lost"
    LINK_UP = "link_up"
    COMPUTER_LATE = "computer_late"  # ours is too slow to fly by
    LINK_LATE = "link_late"  # answers come, but too late to fly by
    RIVAL = "rival"  # somebody else sends setpoints to the vehicle
    ESTIMATE_LOST = "estimate_lost"
    CONTROL_FAILED = "control_failed"  # the controller finds no plan, and has long commanded to stop
    VELOCITY_UNCERTAIN = "velocity_uncertain"  # ours, though there is an estimate
    BATTERY_CRITICAL = "battery_critical"
    BATTERY_LOW = "battery_low"
    OUT_OF_BOUNDS = "out_of_bounds"  # the fence or the ceiling, with room to stop before it
    ESTIMATE_DISPUTED = "estimate_disputed"  # our own motion, by a second source of it
    PAD_DISPUTED = "pad_disputed"  # what the pad's estimate rests on, by a second source of it
    PAD_TOO_FAST = "pad_too_fast"  # to be followed


# what is detected, and why
DetectedEvent = tuple[MissionEvent, str]


class Authority(StrEnum):
    """Who commands the vehicle."""

    NONE = "none"  # the autopilot flies by itself; control was not granted yet
    OURS = "ours"  # our setpoints are obeyed
    RELEASED = "released"  # returned to the autopilot or taken by a pilot, for good


class Guard(StrEnum):
    """What else has to hold for a branch to be taken."""

    ALWAYS = "always"
    NOT_TAKEN = "it flew by its pilot when ordered, and control was never ours"
    CONTROL_NONE = "control not granted yet"
    CONTROL_OURS = "control is ours"
    STILL_FLIES = "it flies, and control not granted yet"  # by the autopilot's word
    ON_SURFACE = "it stands"  # on the pad by our signs, on the ground by the autopilot's
    TRIES_LEFT = "tries left"
    DISARM_NOT_ASKED = "no disarm asked yet"
    LAND_GRANTED = "the autopilot is in LAND"
    LEFT_IN_OFFBOARD = "control was ours, and PX4 is in OFFBOARD still"
    UNHEARD = "the autopilot has not been heard for long"
    MAY_FINISH = "the settings let a descent finish"
    ENDS_INSIDE = "the pad is inside the fence until the landing ends"
    FEET_DOWN = "echoes show the feet down"
    NOT_STANDING = "it does not stand upright on the pad"
    NEAR = "lower than a metre over the ground or the pad"


class Effect(StrEnum):
    """What a branch does besides actions to the autopilot."""

    COUNT_TRY = "count the try"
    ASK_PAD_POSITION = "ask the ground station for the pad's position"
    STOP_SETPOINTS = "stop setpoints"
    ASK_AFRESH = "forget what was answered, count the phase's time again"
    COUNT_AFRESH = "count the phase's time again"
    ASK_NOTHING = "drop what is asked, stop setpoints"
    SEARCH_FROM_HERE = "search from here"
    NO_NEW_TRY = "begin no new try"


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What guards are judged by."""

    authority: Authority = Authority.NONE
    tries_left: bool = True
    ordered_in_air: bool = False
    on_surface: bool = False
    disarm_asked: bool = False
    land_granted: bool = False
    heard: bool = True
    airborne: bool = False
    may_finish: bool = False
    ends_inside: bool = True
    in_offboard: bool = False
    feet_down: bool = False
    standing: bool = True
    near: bool = False

    def allow(self, guard: Guard) -> bool:
        """Whether a guard holds."""
        return {
            Guard.ALWAYS: True,
            Guard.NOT_TAKEN: self.ordered_in_air and self.authority is Authority.NONE,
            Guard.CONTROL_NONE: self.authority is Authority.NONE,
            Guard.CONTROL_OURS: self.authority is Authority.OURS,
            Guard.STILL_FLIES: self.airborne and self.authority is Authority.NONE,
            Guard.ON_SURFACE: self.on_surface,
            Guard.TRIES_LEFT: self.tries_left,
            Guard.DISARM_NOT_ASKED: not self.disarm_asked,
            Guard.LAND_GRANTED: self.land_granted,
            Guard.LEFT_IN_OFFBOARD: self.in_offboard and self.authority is Authority.OURS,
            Guard.UNHEARD: not self.heard,
            Guard.MAY_FINISH: self.may_finish,
            Guard.ENDS_INSIDE: self.ends_inside,
            Guard.FEET_DOWN: self.feet_down,
            Guard.NOT_STANDING: not self.standing,
            Guard.NEAR: self.near,
        }[guard]


@dataclass(frozen=True, slots=True)
class Branch:
    """What follows an event: the next state (None: the same), requests, and who has the vehicle then."""

    to: State | None
    actions: tuple[Action, ...] = ()
    authority: Authority | None = None  # None: as before
    effects: tuple[Effect, ...] = ()
    guard: Guard = Guard.ALWAYS


@dataclass(frozen=True, slots=True)
class TableRow:
    """One event in some states: the first branch whose guard holds; none: the event means nothing.

    `except_` gives the states in which the event may arise and means nothing, with the reason.
    """

    event: MissionEvent
    states: frozenset[State]
    branches: tuple[Branch, ...]
    except_: Mapping[State, str] = field(default_factory=dict)
