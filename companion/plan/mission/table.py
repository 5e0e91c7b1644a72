"""The mission's state machine as data: (phase, event) -> (next phase, actions asked of the autopilot).

Its rules:
  every pair of a phase and an event has an entry;
  a pair that should not happen ends in a safe hold by the autopilot itself, and is announced;
  every phase but the two last (LANDED, ABORT) ends by time;
  once a pilot has taken over nothing is asked and nothing is sent any more;
  STOP, a lost estimate and overtime hand the vehicle back holding its position.
No clock, no I/O: the planner turns what it sees into events and looks here what follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from companion.base.messages import ActionKind, Phase


class Event(StrEnum):
    """What can happen to a mission."""

    READY = "ready"  # autopilot connected and ready to arm, our estimate aligned
    ARMED = "armed"
    AIRBORNE = "airborne"  # take-off height reached
    ARRIVED = "arrived"  # at the waypoint, slow
    ONWARD = "onward"  # the same, but further waypoints are ours to fly to
    BLOCKED = "blocked"  # an obstacle is in the straight way that the autopilot would fly
    PAD_SEEN = "pad_seen"  # steadily, and setpoints of ours are obeyed where that matters
    CENTRED = "centred"  # above the pad, within the descent cone
    LOW = "low"  # at the height from which touchdown is one straight go
    CONTACT = "contact"  # several signs say that the feet stand on the pad
    DISARMED = "disarmed"
    PAD_LOST = "pad_lost"
    GROUND_NEAR = "ground_near"  # far nearer than the pad is believed to be: that belief is wrong
    MISALIGNED = "misaligned"  # touchdown cannot be had from here: climb and try again
    OUT_OF_TRIES = "out_of_tries"
    CONNECTED = "connected"  # the link is back
    LINK_LOST = "link_lost"
    ESTIMATE_LOST = "estimate_lost"
    REFUSED = "refused"  # an action, as often as it may be asked
    TIMEOUT = "timeout"  # of the phase
    OVERTIME = "overtime"  # of the whole mission
    PILOT_TOOK_OVER = "pilot_took_over"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Transition:
    """What follows an event. `legal` is False for pairs that should never happen."""

    phase: Phase
    actions: tuple[ActionKind, ...] = ()
    legal: bool = True


FINAL: Final = frozenset({Phase.LANDED, Phase.ABORT})
# In these phases the setpoints are ours (or about to be) and our own estimate carries the vehicle.
OUR_CONTROL: Final = frozenset(
    {Phase.ROUTE, Phase.SEARCH, Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN, Phase.HOLD}
)
# In these phases control is asked for.
TAKES_CONTROL: Final = frozenset({Phase.ROUTE, Phase.SEARCH})
# In these phases the pad's estimate carries the vehicle.
BY_THE_PAD: Final = frozenset({Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN})

_C, _A, _T, _W = Phase.CONNECT, Phase.ARM, Phase.TAKE_OFF, Phase.WAYPOINT
_R, _S, _AP, _D, _TD = Phase.ROUTE, Phase.SEARCH, Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN
_ASK_PAD = (ActionKind.REQUEST_PAD_POSITION,)
_HAND_BACK: Final = Transition(Phase.ABORT, (ActionKind.HOLD,))
_SAFE_HOLD: Final = Transition(Phase.HOLD, (ActionKind.HOLD,), legal=False)
_LET_GO: Final = Transition(Phase.ABORT)

# The good flight, and what may befall it, phase by phase.
_OWN: dict[tuple[Phase, Event], Transition] = {
    (_C, Event.READY): Transition(_A, (ActionKind.ARM,)),
    (_C, Event.TIMEOUT): _LET_GO,
    (_C, Event.CONNECTED): Transition(_C),
    (_A, Event.ARMED): Transition(_T, (ActionKind.TAKE_OFF,)),
    (_A, Event.REFUSED): _LET_GO,
    # a refused arming is no event: it is asked for again until the time is up
    (_A, Event.TIMEOUT): Transition(Phase.ABORT, (ActionKind.DISARM,)),
    (_T, Event.AIRBORNE): Transition(_W, (ActionKind.GO_TO,)),
    (_T, Event.BLOCKED): Transition(_R),
    # if only the answer was lost it may be climbing: landing is right in the air and on the ground, where
    # the disarming, refused in the air, ends it at once
    (_T, Event.REFUSED): Transition(Phase.ABORT, (ActionKind.LAND, ActionKind.DISARM)),
    (_T, Event.TIMEOUT): Transition(Phase.ABORT, (ActionKind.LAND,)),
    (_W, Event.ARRIVED): Transition(_S),
    (_W, Event.ONWARD): Transition(_R),
    (_W, Event.PAD_SEEN): Transition(_S),
    # not arrived, or not allowed to go: look from here, the beacon may lead on
    (_W, Event.REFUSED): Transition(_S),
    (_W, Event.TIMEOUT): Transition(_S),
    (_R, Event.ARRIVED): Transition(_S),
    (_R, Event.PAD_SEEN): Transition(_S),
    (_R, Event.TIMEOUT): Transition(_S),
    (_R, Event.REFUSED): _HAND_BACK,
    (_S, Event.PAD_SEEN): Transition(_AP),
    (_S, Event.REFUSED): _HAND_BACK,
    (_S, Event.TIMEOUT): _HAND_BACK,
    (_AP, Event.CENTRED): Transition(_D),
    (_AP, Event.PAD_LOST): Transition(_S, _ASK_PAD),
    (_AP, Event.TIMEOUT): Transition(_S, _ASK_PAD),
    (_D, Event.LOW): Transition(_TD),
    (_D, Event.PAD_LOST): Transition(_S, _ASK_PAD),
    (_AP, Event.GROUND_NEAR): Transition(_S, _ASK_PAD),
    (_D, Event.GROUND_NEAR): Transition(_S, _ASK_PAD),
    (_TD, Event.GROUND_NEAR): Transition(_S, _ASK_PAD),
    (_D, Event.MISALIGNED): Transition(_AP),
    (_D, Event.TIMEOUT): Transition(_AP),
    (_D, Event.OUT_OF_TRIES): Transition(Phase.HOLD),
    (_TD, Event.CONTACT): Transition(_TD),
    (_TD, Event.PAD_LOST): Transition(_AP),
    (_TD, Event.MISALIGNED): Transition(_AP),
    (_TD, Event.OUT_OF_TRIES): Transition(Phase.HOLD),
    (_TD, Event.TIMEOUT): _HAND_BACK,
    (_TD, Event.REFUSED): Transition(Phase.ABORT, (ActionKind.LAND,)),
    (_TD, Event.DISARMED): Transition(Phase.LANDED),
    (Phase.HOLD, Event.CONNECTED): Transition(_S),
    (Phase.HOLD, Event.REFUSED): _HAND_BACK,
    (Phase.HOLD, Event.TIMEOUT): _HAND_BACK,
}


def _anywhere(phase: Phase) -> dict[Event, Transition]:
    """What these events mean in any phase that is not final."""
    on_ground = phase in {_C, _A}
    return {
        Event.PILOT_TOOK_OVER: _LET_GO,
        Event.DISARMED: _LET_GO,
        Event.STOP: _hand_back(phase),
        Event.OVERTIME: _hand_back(phase),
        Event.ESTIMATE_LOST: _hand_back(phase),
        Event.LINK_LOST: Transition(phase) if on_ground else Transition(Phase.HOLD),
    }


def _hand_back(phase: Phase) -> Transition:
    if phase is _C:
        return _LET_GO
    return Transition(Phase.ABORT, (ActionKind.DISARM,)) if phase is _A else _HAND_BACK


def _table() -> dict[tuple[Phase, Event], Transition]:
    table = {}
    for phase in Phase:
        anywhere = _anywhere(phase)
        for event in Event:
            default = Transition(phase) if phase in FINAL else anywhere.get(event, _SAFE_HOLD)
            table[phase, event] = _OWN.get((phase, event), default)
    return table


TRANSITIONS: Final = _table()


def transition(phase: Phase, event: Event) -> Transition:
    """What follows an event in a phase; every pair is defined."""
    return TRANSITIONS[phase, event]
