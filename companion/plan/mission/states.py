"""The vocabulary of the mission's table: states, owners of control, guards, effects, rows.

A state is a phase of the mission or one of its sub-phases: the touchdown has six, a hold has two. No clock,
no I/O.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Final

from companion.base.messages import Action, Phase
from companion.plan.events import MissionEvent


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
    # straight down, by the autopilot's LAND: after SINK, too low to rise without the pad, or at any height
    # without our own estimate, without a plan, or once its time is over
    SET_DOWN = "set_down"
    STAND = "stand"  # the feet are on the pad
    # LAND is asked for and the thrust is taken away: after a contact of SET_DOWN, or after STAND when nothing
    # shows the feet down or the time is over
    AUTO_LAND = "auto_land"
    LANDED = "landed"
    HOLD = "hold"
    AWAIT_LINK = "await_link"  # a hold that ends when the autopilot is heard again
    ABORT = "abort"

    @property
    def phase(self) -> Phase:
        """The phase that this is, or is a part of."""
        return _PHASES[self]


_PARTS: Final = {
    **dict.fromkeys(
        (State.WAIT, State.SINK, State.RISE, State.SET_DOWN, State.STAND, State.AUTO_LAND), Phase.TOUCHDOWN
    ),
    State.AWAIT_LINK: Phase.HOLD,
}
_PHASES: Final = {state: _PARTS.get(state) or Phase(state.value) for state in State}


class Authority(StrEnum):
    """Who commands the vehicle."""

    NONE = "none"  # the autopilot flies by itself; control was not granted yet
    PILOT = "pilot"  # its pilot flew it when the landing was ordered; control was not granted yet
    OURS = "ours"  # our setpoints are obeyed
    RELEASED = "released"  # returned to the autopilot or taken by a pilot, for good


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What guards are judged by."""

    authority: Authority = Authority.NONE
    tries_left: bool = True
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
    may_obey: bool = False


class Guard(Enum):
    """What else has to hold for a branch to be taken: in words, and by the circumstances."""

    ALWAYS = "always", lambda _: True
    PILOTS = (
        "it flew by its pilot when ordered, and control was never ours",
        lambda c: c.authority is Authority.PILOT,
    )
    MAY_OBEY = (
        "it flew by its pilot when ordered, and may obey setpoints by now",
        lambda c: c.authority is Authority.PILOT and c.may_obey,
    )
    CONTROL_NONE = "control not granted yet", lambda c: c.authority is Authority.NONE
    CONTROL_OURS = "control is ours", lambda c: c.authority is Authority.OURS
    STILL_FLIES = (  # by the autopilot's word
        "it flies, and control not granted yet",
        lambda c: c.airborne and c.authority is Authority.NONE,
    )
    ON_SURFACE = "it stands", lambda c: c.on_surface  # on the pad by our signs, on the ground by its word
    TRIES_LEFT = "tries left", lambda c: c.tries_left
    DISARM_NOT_ASKED = "no disarm asked yet", lambda c: not c.disarm_asked
    LAND_GRANTED = "the autopilot is in LAND", lambda c: c.land_granted
    LEFT_IN_OFFBOARD = (
        "control was ours, and PX4 is in OFFBOARD still",
        lambda c: c.in_offboard and c.authority is Authority.OURS,
    )
    UNHEARD = "the autopilot has not been heard for long", lambda c: not c.heard
    MAY_FINISH = "the settings let a descent finish", lambda c: c.may_finish
    ENDS_INSIDE = "the pad is inside the fence until the landing ends", lambda c: c.ends_inside
    FEET_DOWN = "echoes show the feet down", lambda c: c.feet_down
    NOT_STANDING = "it does not stand upright on the pad", lambda c: not c.standing
    NEAR = "lower than a metre over the ground or the pad", lambda c: c.near

    def __init__(self, words: str, holds: Callable[[Circumstances], bool]) -> None:
        self.words, self.holds = words, holds


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
