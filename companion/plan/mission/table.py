"""The mission's state machine: as data, a state and an event give the next state and the requests.

Its rules:
  every pair of a state and an event has one row, or is ignored, or is impossible;
  an impossible pair ends in a hold by the autopilot, and is announced;
  every state ends by time, except the final ones (LANDED, ABORT), STANDBY, which waits for an order, and
  SET_DOWN and AUTO_LAND while the autopilot is received: they go on to request LAND, and once there was a
  contact a disarming, or the motors stay on;
  control that was released is never taken again in this mission, and nothing more is requested;
  STOP, the bounds and overtime return control to the autopilot, which holds its position; low over the pad
  the vehicle climbs clear first. A lost or disputed estimate, a controller without a plan and a late link
  leave no time for that: low down the autopilot is asked to climb;
  COMMITTED states heed, of what may come anywhere, only TAKEN_OVER, DISARMED, TIPPED_OVER, their own
  time and a low battery (no new try), and SINK a lost or disputed estimate and a controller without a plan.
  What lasts acts once a try has failed, as a STOP does, which holds until the mission ends;
  a vehicle that a pilot flew when the landing was ordered, and that the app never controlled, stays in the
  pilot's mode; once control was asked for, it is put into a hold if it obeys setpoints, whatever it answered;
  a PX4 that is disarmed in the app's OFFBOARD is put into Hold, so that it can be armed again.
No clock, no I/O: the failsafe monitor and the phases detect events, and this table decides what follows.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Final

from companion.base.messages import Action, ActionKind, Phase
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.mission.states import Authority, Branch, Circumstances, Effect, Guard, State, TableRow

E, S = MissionEvent, State
FINAL: Final = frozenset({S.LANDED, S.ABORT})
LIVE: Final = frozenset(State) - FINAL
BEFORE_TAKE_OFF: Final = frozenset({S.STANDBY, S.CONNECT, S.ARM})  # in STANDBY a pilot may fly the vehicle
IN_AIR: Final = LIVE - BEFORE_TAKE_OFF
BY_AUTOPILOT: Final = frozenset({S.TAKE_OFF, S.WAYPOINT})
OVER_PAD: Final = frozenset({S.WAIT, S.RISE})  # waiting for a moment to land
ON_PAD: Final = frozenset({S.STAND, S.AUTO_LAND})  # since the contact, shown to stand or not
GOING_DOWN: Final = frozenset({S.SINK, S.SET_DOWN})  # committed, the feet not yet on the pad
COMMITTED: Final = ON_PAD | GOING_DOWN
TOUCHDOWN: Final = OVER_PAD | COMMITTED
OVER_PAD_OR_DESCENDING: Final = OVER_PAD | {S.DESCEND}  # it may be just over the pad, and has not committed
HOLDING: Final = frozenset({S.HOLD, S.AWAIT_LINK})
# the pad's estimate carries the vehicle
BY_THE_PAD: Final = TOUCHDOWN | {S.APPROACH, S.DESCEND}
# what was asked before and waits to be sent is withdrawn as it comes to one of these
WITHDRAWS: Final = FINAL | HOLDING
UNFOLLOWED: Final = (E.PAD_DISPUTED, E.PAD_TOO_FAST)  # the pad's estimate leads astray, or too fast
OUTSIDE: Final = (E.OUT_OF_BOUNDS, E.OVERTIME)  # of the mission's space or time
LATE: Final = (E.COMPUTER_LATE, E.LINK_LATE)  # setpoints of ours come too late
# our setpoints lead nowhere
NO_OWN_MOTION: Final = (E.ESTIMATE_LOST, E.ESTIMATE_DISPUTED, E.CONTROL_FAILED)
# What may be detected in any state, the gravest first: what causes others comes before them. Each state has a
# row or a reason for none.
ANYWHERE: Final = (
    *(E.DISARMED, E.TAKEN_OVER, E.TIPPED_OVER, E.STOP, E.SUSPENDED, E.LINK_LOST, E.COMPUTER_LATE),
    *(E.RIVAL, E.LINK_LATE),
    *(E.ESTIMATE_LOST, E.VELOCITY_UNCERTAIN, E.CONTROL_FAILED, E.BATTERY_CRITICAL, E.BATTERY_LOW),
    *(E.ESTIMATE_DISPUTED, E.PAD_DISPUTED, E.OUT_OF_BOUNDS, E.PAD_TOO_FAST, E.OVERTIME, E.TIMEOUT, E.LINK_UP),
)
_SEVERITY: Final = {event: place for place, event in enumerate((E.CONTROL_GRANTED, *ANYWHERE))}

_ARM, _TAKE_OFF, _GO_TO = Action(ActionKind.ARM), Action(ActionKind.TAKE_OFF), Action(ActionKind.GO_TO)
_TAKE_CONTROL, _HOLD = Action(ActionKind.TAKE_CONTROL), Action(ActionKind.HOLD)
_HOLD_IF_OBEYED = Action(ActionKind.HOLD_IF_OBEYED)
_LAND, _DISARM = Action(ActionKind.LAND), Action(ActionKind.DISARM)
# Plainly first, by force only where that is refused (`PymavlinkActions.disarm`). In the air it would drop the
# vehicle: only once the vehicle is shown to stand, or to lie on its side.
_FORCE_DISARM = Action(ActionKind.DISARM, force=True)


def _rows(
    events: MissionEvent | Iterable[MissionEvent],
    states: State | Collection[State],
    *branches: Branch,
    except_: Mapping[State, str] | None = None,
) -> list[TableRow]:
    """A row for each event: in these states but those in `except_` the same follows."""
    listed = frozenset({states} if isinstance(states, State) else states) - set(except_ or ())
    each = (events,) if isinstance(events, MissionEvent) else events
    return [TableRow(event, listed, branches, except_ or {}) for event in each]


def _end(*actions: Action, guard: Guard = Guard.ALWAYS) -> Branch:
    return Branch(S.ABORT, actions, Authority.RELEASED, guard=guard)


def _all(states: Iterable[State], reason: str) -> dict[State, str]:
    return dict.fromkeys(sorted(states), reason)  # in one order, whatever order the set has


_GIVE_UP: Final = _end()
_CONTROL_LOST: Final = Branch(S.ABORT, (), Authority.RELEASED, (Effect.STOP_SETPOINTS,))
# A disarmed PX4 stays in OFFBOARD, where it does not get ready to arm again without setpoints.
_LEAVE_OFFBOARD: Final = replace(
    _CONTROL_LOST, actions=(Action(ActionKind.LEAVE_OFFBOARD),), guard=Guard.LEFT_IN_OFFBOARD
)
# Control returns to the autopilot. A vehicle that stands would lift off to hold a position: it lands.
# Once control was asked for, it counts what may have been obeyed, not what was answered.
_NEVER_OURS: Final = (_end(_HOLD_IF_OBEYED, guard=Guard.MAY_OBEY), _end(guard=Guard.PILOTS))
# Near the ground or the pad it would hold there until it has drifted onto it: the autopilot rises first.
_RISE: Final = replace(_end(replace(_HOLD, height_m=2.0), guard=Guard.NEAR), effects=(Effect.STOP_SETPOINTS,))
_RETURN_CONTROL: Final = (*_NEVER_OURS, _end(_LAND, guard=Guard.ON_SURFACE), _RISE, _end(_HOLD))
_SEARCH_AGAIN: Final = Branch(S.SEARCH, effects=(Effect.ASK_PAD_POSITION,))
_NEXT_TRY: Final = (
    Branch(S.APPROACH, effects=(Effect.COUNT_TRY,), guard=Guard.TRIES_LEFT),
    Branch(S.HOLD, effects=(Effect.COUNT_TRY,)),
)
# Just over the pad the autopilot would hold in its way: the hold by our own setpoints climbs clear first.
_HOLD_CLEAR: Final = (_end(_LAND, guard=Guard.ON_SURFACE), Branch(S.HOLD))
# A try that begins after one that failed may be as low.
_CLEAR_IF_NEAR: Final = (_end(_LAND, guard=Guard.ON_SURFACE), Branch(S.HOLD, guard=Guard.NEAR))
# Without the pad or our own estimate: LAND holds the vehicle level, and goes on down.
_SET_DOWN: Final = Branch(S.SET_DOWN, (_LAND,), effects=(Effect.COUNT_AFRESH,))
# However late it is asked for: LAND takes its time to be answered, and to come down.
_AUTO_LAND: Final = Branch(S.AUTO_LAND, (_LAND,), effects=(Effect.COUNT_AFRESH,))
IMPOSSIBLE: Final = (
    *_NEVER_OURS,
    Branch(S.HOLD, (_LAND,), Authority.RELEASED, guard=Guard.ON_SURFACE),
    Branch(S.HOLD, (_HOLD,), Authority.RELEASED),
)

_NOT_YET = "before take-off; in standby a pilot may fly"
_FLIES_ITSELF = "the autopilot navigates"
_FINISHES = "committed: finishing is gentler than breaking off"
_STANDS = "it stands on the pad"
_DOUBTED = "it stands on the pad; a shorter silence already makes that doubtful (off pad)"
_NOTHING_ASKED = "nothing is requested yet; an armed vehicle ends the mission in any mode"
_WAITS_FOR_OPERATOR = "it waits for an order, and asks for nothing"
_LANDS = "the autopilot lands already"
_LOST_WITH_IT = "the estimate, lost with it, ends it"
_GO_ON: Final = {**_all(GOING_DOWN, _FINISHES), **_all(ON_PAD, _STANDS)}
_EARLY: Final = _all(BEFORE_TAKE_OFF, _NOT_YET)
_BY_ITSELF: Final = _all(BY_AUTOPILOT, _FLIES_ITSELF)
_UNASKED: Final = _all({S.STANDBY, S.CONNECT}, _NOTHING_ASKED)
_LAY = "nothing is requested there but to disarm a vehicle on its side, again as long as it lies there"
_CLEARS = "it climbs clear of the pad and comes to rest, which returns control; so does its time"

ROWS: Final = (
    # ---- ordered
    *_rows(E.LAND_ORDERED, S.STANDBY, Branch(S.SEARCH, authority=Authority.PILOT)),
    *_rows(E.FLY_ORDERED, S.STANDBY, Branch(S.CONNECT)),
    # ---- to the waypoint; a refused arming is no event, it is asked for again until the time is up
    *_rows(E.READY, S.CONNECT, Branch(S.ARM, (_ARM,))),
    # also after a restart in the air, or while arming is refused: somebody else has the vehicle
    *_rows(E.ALREADY_ARMED, {S.CONNECT, S.ARM}, _CONTROL_LOST),
    # Our request may be obeyed yet, and nobody else turns the motors off; in the air that is refused.
    *_rows(
        (E.ARMED_IN_DOUBT, E.ALIGNMENT_LOST, E.TIMEOUT, E.STOP, E.SUSPENDED),
        S.ARM,
        _end(_DISARM),
    ),
    *_rows(E.ARMED, S.ARM, Branch(S.TAKE_OFF, (_TAKE_OFF,))),
    *_rows(E.AIRBORNE, S.TAKE_OFF, Branch(S.WAYPOINT, (_GO_TO,))),
    *_rows(E.BLOCKED, S.TAKE_OFF, Branch(S.ROUTE)),
    *_rows(E.HOME_UNKNOWN, S.TAKE_OFF, _end(_LAND, _DISARM)),
    *_rows(E.ONWARD, S.WAYPOINT, Branch(S.ROUTE)),
    *_rows(E.ARRIVED, {S.WAYPOINT, S.ROUTE}, Branch(S.SEARCH)),
    # ---- control
    *_rows(E.STREAMING, {S.ROUTE, S.SEARCH}, Branch(None, (_TAKE_CONTROL,))),
    *_rows(
        E.CONTROL_GRANTED,
        {S.ROUTE, S.SEARCH},
        # its pilot has flown on meanwhile
        Branch(None, (), Authority.OURS, (Effect.SEARCH_FROM_HERE,), Guard.PILOTS),
        Branch(None, authority=Authority.OURS, guard=Guard.CONTROL_NONE),
    ),
    # ---- to the pad
    *_rows(E.PAD_SEEN, {S.WAYPOINT, S.ROUTE}, Branch(S.SEARCH)),
    *_rows(E.PAD_SEEN, S.SEARCH, Branch(S.APPROACH)),
    *_rows(E.CENTRED, S.APPROACH, Branch(S.DESCEND)),
    *_rows(E.LOW, S.DESCEND, Branch(S.WAIT)),
    *_rows(E.PAD_LOST, {S.APPROACH, S.DESCEND}, _SEARCH_AGAIN),
    *_rows(E.PAD_LOST, OVER_PAD | {S.SINK}, *_NEXT_TRY),
    *_rows(E.GROUND_NEAR, {S.APPROACH, S.DESCEND} | OVER_PAD, _SEARCH_AGAIN),
    # ---- onto the pad
    *_rows(E.COMMIT, OVER_PAD, Branch(S.SINK, guard=Guard.ENDS_INSIDE)),
    *_rows(E.BREAK_OFF, S.SINK, Branch(S.RISE)),
    *_rows(E.RISEN, S.RISE, Branch(S.WAIT)),
    *_rows(E.MISALIGNED, OVER_PAD | {S.SINK}, *_NEXT_TRY),
    *_rows(E.CONTACT, S.SINK, Branch(S.STAND)),
    # PX4 detects no landing on a moving pad, and its LAND mode brakes against the pad: the vehicle tilts
    # until it tips over. So LAND is requested only where nothing shows the feet down.
    *_rows(E.LANDING_DETECTED, ON_PAD, Branch(None, (_DISARM,))),
    *_rows(E.AT_REST, ON_PAD, Branch(None, (_FORCE_DISARM,))),
    *_rows(
        E.UNPROVEN,
        ON_PAD,
        replace(_AUTO_LAND, guard=Guard.DISARM_NOT_ASKED),
        except_={S.AUTO_LAND: "LAND is asked for already"},
    ),
    *_rows(E.PAD_GONE, S.SINK, _SET_DOWN),
    *_rows(E.CONTACT, S.SET_DOWN, Branch(S.AUTO_LAND)),
    *_rows(E.LANDING_DETECTED, S.SET_DOWN, Branch(S.AUTO_LAND, (_DISARM,))),
    *_rows(E.OFF_PAD, S.STAND, *_NEXT_TRY),
    # in LAND it comes down beside the pad, which is gentler than to fly again from there
    *_rows(E.OFF_PAD, S.AUTO_LAND, _end(guard=Guard.LAND_GRANTED), *_NEXT_TRY),
    # ---- refused as often as it may be asked
    # if only the answer was lost it may be climbing: LAND is right in the air and on the ground; the DISARM,
    # refused in the air, ends it at once on the ground
    *_rows(E.REFUSED, S.TAKE_OFF, _end(_LAND, _DISARM)),
    # not allowed to go: search from here, by the beacon
    *_rows(E.REFUSED, S.WAYPOINT, Branch(S.SEARCH)),
    *_rows(E.REFUSED, HOLDING | {S.ROUTE, S.SEARCH}, *_RETURN_CONTROL),
    # Nobody else turns the motors off: it stays, pressed down, and asks again.
    *_rows(
        E.REFUSED, S.STAND, Branch(None, (_DISARM,)), except_=_all(BY_THE_PAD - COMMITTED | {S.SINK}, _LAY)
    ),
    *_rows(E.REFUSED, {S.SET_DOWN, S.AUTO_LAND}, Branch(None, (_LAND,))),
    # ---- the time of a phase
    *_rows(E.TIMEOUT, S.CONNECT, _GIVE_UP, except_={S.STANDBY: _WAITS_FOR_OPERATOR}),
    *_rows(E.TIMEOUT, S.TAKE_OFF, _end(_LAND)),
    *_rows(E.TIMEOUT, {S.WAYPOINT, S.ROUTE}, Branch(S.SEARCH)),
    *_rows(E.TIMEOUT, S.APPROACH, _SEARCH_AGAIN),
    *_rows(E.TIMEOUT, S.DESCEND, *_NEXT_TRY),
    *_rows(E.TIMEOUT, OVER_PAD, *_HOLD_CLEAR),
    *_rows(E.TIMEOUT, HOLDING | {S.SEARCH}, *_RETURN_CONTROL),
    *_rows(E.CLEAR, S.HOLD, *_RETURN_CONTROL),
    *_rows(E.TIMEOUT, S.SINK, _SET_DOWN),
    *_rows(E.TIMEOUT, S.STAND, _AUTO_LAND),
    # without a link nothing arrives: its own failsafe has long taken it, and what then flies is not ours.
    # Where nothing has shown a contact, time alone cuts no thrust: it asks for LAND again.
    *_rows(
        E.TIMEOUT,
        S.SET_DOWN,
        _end(guard=Guard.UNHEARD),
        Branch(None, (_LAND,), effects=(Effect.ASK_AFRESH,)),
    ),
    *_rows(
        E.TIMEOUT,
        S.AUTO_LAND,
        _end(guard=Guard.UNHEARD),
        Branch(None, (_LAND, _DISARM), effects=(Effect.ASK_AFRESH,)),
    ),
    # ---- anywhere
    *_rows(
        E.BATTERY_CRITICAL,
        IN_AIR - OVER_PAD_OR_DESCENDING - {S.APPROACH},
        *_RETURN_CONTROL,
        except_={**_UNASKED, S.ARM: "the autopilot's own checks decide", S.HOLD: _CLEARS, **_GO_ON},
    ),
    *_rows(E.BATTERY_CRITICAL, OVER_PAD_OR_DESCENDING, Branch(None, guard=Guard.MAY_FINISH), *_HOLD_CLEAR),
    # the hold brakes at once, within the room that a bound leaves, and climbs no higher than the ceiling
    *_rows((*OUTSIDE, *UNFOLLOWED, E.STOP), OVER_PAD_OR_DESCENDING, *_HOLD_CLEAR),
    *_rows((E.BATTERY_CRITICAL, *OUTSIDE, E.STOP), S.APPROACH, *_CLEAR_IF_NEAR, *_RETURN_CONTROL),
    *_rows(
        OUTSIDE,
        IN_AIR - OVER_PAD_OR_DESCENDING - {S.APPROACH},
        *_RETURN_CONTROL,
        except_={**_EARLY, S.HOLD: _CLEARS, **_GO_ON},
    ),
    *_rows(
        UNFOLLOWED,
        S.APPROACH,
        *_CLEAR_IF_NEAR,
        *_RETURN_CONTROL,
        except_={**_all(LIVE - BY_THE_PAD, "it does not follow the pad"), **_GO_ON},
    ),
    *_rows(
        E.BATTERY_LOW,
        LIVE - {S.STANDBY, S.CONNECT},
        Branch(None, effects=(Effect.NO_NEW_TRY,)),
        except_=_UNASKED,
    ),
    *_rows(E.STOP, {S.STANDBY, S.CONNECT}, _GIVE_UP),
    *_rows(
        E.SUSPENDED,
        S.CONNECT,
        _GIVE_UP,
        except_={S.STANDBY: _WAITS_FOR_OPERATOR, **_all(OVER_PAD_OR_DESCENDING, _LOST_WITH_IT)},
    ),
    *_rows(
        E.STOP,
        IN_AIR - OVER_PAD_OR_DESCENDING - {S.APPROACH},
        *_RETURN_CONTROL,
        except_={S.HOLD: _CLEARS, **_GO_ON},
    ),
    *_rows(
        E.SUSPENDED,
        IN_AIR - OVER_PAD_OR_DESCENDING,
        *_RETURN_CONTROL,
        except_={S.HOLD: _CLEARS, **_GO_ON, S.SINK: _LOST_WITH_IT},
    ),
    *_rows(
        E.TAKEN_OVER,
        LIVE,
        _CONTROL_LOST,
        except_={S.STANDBY: _WAITS_FOR_OPERATOR, S.CONNECT: _NOTHING_ASKED},
    ),
    # a hold or a landing that is still asked for would take the vehicle from whoever has it now
    *_rows(E.TAKEN_OVER, S.ABORT, Branch(None, effects=(Effect.ASK_NOTHING,))),
    # The motors of a vehicle on its side drag it over the ground, and no landing is detected there. It is
    # asked again as long as it lies there. Setpoints without thrust go on, or PX4 would change its mode.
    *_rows(
        E.TIPPED_OVER,
        IN_AIR,
        *_NEVER_OURS,
        Branch(None, (_FORCE_DISARM,)),
        except_=_EARLY,
    ),
    *_rows(
        E.DISARMED,
        IN_AIR - ON_PAD - {S.SET_DOWN},
        *(_LEAVE_OFFBOARD, _CONTROL_LOST),
        except_=_EARLY,
    ),
    *_rows(
        E.DISARMED,
        ON_PAD | {S.SET_DOWN},
        replace(_CONTROL_LOST, guard=Guard.NOT_STANDING),
        *(replace(branch, to=S.LANDED) for branch in (_LEAVE_OFFBOARD, _CONTROL_LOST)),
    ),
    *_rows(
        E.LINK_LOST,
        IN_AIR,
        *_NEVER_OURS,
        Branch(S.AWAIT_LINK),
        except_={
            **_EARLY,
            **_all(HOLDING, "it holds already"),
            **_all(GOING_DOWN, _FINISHES),
            **_all(ON_PAD, _DOUBTED),
        },
    ),
    *_rows(
        E.LINK_UP,
        S.AWAIT_LINK,
        Branch(S.SEARCH, guard=Guard.CONTROL_OURS),
        # lost on the way to the waypoint; a vehicle on the ground is not lifted by our setpoints
        Branch(S.SEARCH, guard=Guard.STILL_FLIES),
        except_=_all(LIVE - {S.AWAIT_LINK}, "no link is awaited"),
    ),
    # Setpoints that come late make the vehicle swing, higher and higher: a climb by them just over the pad is
    # the greater danger than the autopilot's own hold there.
    # Of two that command it nobody knows what it will do: its own hold obeys neither. To rise first ArduPilot
    # would stay in GUIDED, in which it obeys the other.
    *_rows(LATE, IN_AIR, *_RETURN_CONTROL, except_={**_EARLY, **_BY_ITSELF, **_GO_ON}),
    *_rows(
        E.RIVAL,
        IN_AIR,
        *(branch for branch in _RETURN_CONTROL if branch is not _RISE),
        except_={**_EARLY, **_BY_ITSELF, **_GO_ON},
    ),
    *_rows(
        NO_OWN_MOTION,
        IN_AIR - {S.SINK},
        *_RETURN_CONTROL,
        except_={**_EARLY, **_BY_ITSELF, S.SET_DOWN: _LANDS, **_all(ON_PAD, _STANDS)},
    ),
    *_rows(NO_OWN_MOTION, S.SINK, Branch(S.STAND, guard=Guard.FEET_DOWN), _SET_DOWN),
    *_rows(
        E.VELOCITY_UNCERTAIN,
        IN_AIR,
        *_RETURN_CONTROL,
        except_={**_EARLY, **_BY_ITSELF, **_all(BY_THE_PAD, "over the pad the camera tells")},
    ),
)


def _table(rows: Iterable[TableRow]) -> dict[tuple[State, MissionEvent], tuple[Branch, ...]]:
    """Branches by state and event; none: it means nothing there.

    Raises:
        ValueError: a pair stands in the table twice.
    """
    table: dict[tuple[State, MissionEvent], tuple[Branch, ...]] = {}
    for row in rows:
        for state in sorted({*row.states, *row.except_}):
            if (state, row.event) in table:
                raise ValueError(f"{state} and {row.event} stand in the table twice")
            table[state, row.event] = row.branches if state in row.states else ()
    for state in State:
        for event in MissionEvent:
            table.setdefault((state, event), () if state in FINAL else IMPOSSIBLE)
    return table


TABLE: Final = _table(ROWS)


def impossible(state: State, event: MissionEvent) -> bool:
    """Whether an event cannot arise in a state."""
    return TABLE[state, event] is IMPOSSIBLE


def by_severity(events: Iterable[DetectedEvent]) -> tuple[DetectedEvent, ...]:
    """What may be detected anywhere in the order in which it acts, until one changes the state."""
    return tuple(sorted(events, key=lambda event: _SEVERITY[event[0]]))


def follows(state: State, event: MissionEvent, circumstances: Circumstances) -> Branch | None:
    """What follows an event; None: it means nothing. Released it stays, and nothing is asked any more."""
    branches = TABLE[state, event]
    branch = next((b for b in branches if b.guard.holds(circumstances)), None)
    if branch is not None and circumstances.authority is Authority.RELEASED:
        return replace(branch, actions=(), authority=None)
    return branch


class StateMachine:
    """Asks the table what follows, and takes it."""

    def __init__(self, retries: int, *, may_fly: bool = True) -> None:
        """Ready to connect; in standby, if it may not fly until it is ordered to."""
        self._retries_left = retries
        self.state = State.CONNECT if may_fly else State.STANDBY
        self.authority = Authority.NONE

    @property
    def phase(self) -> Phase:
        return self.state.phase

    @property
    def in_control(self) -> bool:
        """Whether control was granted, though it may have been returned or taken since."""
        return self.authority not in {Authority.NONE, Authority.PILOT}

    @property
    def last_try(self) -> bool:
        """Whether the next try that fails is the last."""
        return self._retries_left <= 0

    def follows(self, event: MissionEvent, circumstances: Circumstances) -> Branch | None:
        """What follows an event now; None: it means nothing. Authority and tries are the machine's own."""
        ours = replace(circumstances, authority=self.authority, tries_left=not self.last_try)
        return follows(self.state, event, ours)

    def take(self, branch: Branch) -> None:
        self.state = branch.to or self.state
        self.authority = branch.authority or self.authority
        if Effect.COUNT_TRY in branch.effects:
            self._retries_left -= 1
        if Effect.NO_NEW_TRY in branch.effects:
            self._retries_left = 0  # it stays low, whatever the load does to it
