"""Decides who chose the flight mode: the app, or a pilot or failsafe, which takes the vehicle from the app.

Before the app has control, the autopilot may be in the modes that the app's requests lead to. On the ground
the mode in which it was found is accepted; after the first accepted request the autopilot has `TAKES_S` to
change into the requested mode. From then on the old mode counts as a pilot's too. The same rule applies to
a vehicle that a pilot flew when the landing was ordered.

With control only the mode that obeys setpoints is accepted, and just after a silent link the mode in which
PX4 waited for setpoints. After the mission's end, while a hold or a landing is still requested, the mode in
which it ended and the requested mode are accepted. A LAND that was not requested is not accepted, because a
repeated hold request would stop it.
"""

import math
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import (
    ActionKind,
    AutopilotState,
    LandedState,
    LinkHealth,
)
from companion.plan.debounce import Debounce
from companion.plan.mission.states import Authority, State

# A mode change is in the next HEARTBEAT (1 Hz), which may be lost once.
TAKES_S: Final = 3.0
# PX4 ends a take-off in LOITER within its acceptance radius (NAV_MC_ALT_RAD, 0.8 m). So low it was a pilot.
_TAKE_OFF_DONE_SHARE: Final = 0.6
_LAND: Final = "LAND"
# Setpoints have not arrived for `COM_OF_LOSS_T`, and PX4 flies the mode of `COM_OBL_RC_ACT`. It obeys again
# with the first that arrives, but may say so a heartbeat later. In a mode with sticks a pilot may fly without
# having chosen it (`actionAllowsUserTakeover` of its failsafe framework): that one is heeded.
_OBEYS_AGAIN_S: Final = 1.0
WITHOUT_STICKS: Final = frozenset({"LOITER", "RTL", "LAND"})
_LANDING: Final = frozenset({State.SET_DOWN, State.AUTO_LAND})
_BEFORE_ANY_REQUEST: Final = frozenset({State.STANDBY, State.CONNECT})


def short_name(mode: str) -> str:
    """A mode's name without the prefix of its main mode: AUTO.LOITER is LOITER."""
    return mode.upper().rsplit(".", 1)[-1].replace(" ", "_")


def in_land(autopilot: AutopilotState) -> bool:
    """Whether the autopilot says that it lands."""
    return autopilot.connected and short_name(autopilot.mode or "") == _LAND


def in_offboard(autopilot: AutopilotState) -> bool:
    """Whether it is in a mode in which it does not get ready to arm unless setpoints come."""
    kind = autopilot.autopilot_kind
    waits = kind is not None and PROFILES[kind].needs_setpoints
    return autopilot.connected and waits and autopilot.offboard


def _asked_for(
    asked: frozenset[ActionKind], autopilot: AutopilotState, kind: AutopilotKind
) -> frozenset[str]:
    hold = short_name(PROFILES[kind].hold_mode)
    holds = dict.fromkeys((ActionKind.HOLD, ActionKind.HOLD_IF_OBEYED, ActionKind.LEAVE_OFFBOARD), hold)
    modes = {ActionKind.TAKE_CONTROL: PROFILES[kind].control_mode, ActionKind.LAND: _LAND, **holds}
    found = {modes[action] for action in asked if action in modes}
    # a PX4 that has come down in LAND and disarmed goes to Hold by itself; in the air it is chosen
    if _LAND in found and autopilot.landed is LandedState.ON_GROUND:
        found.add(hold)
    return frozenset(found)


class ModeMonitor:
    """Call `listen` in every cycle, and `taken_over` while the autopilot is received."""

    def __init__(self, take_off_height_m: float) -> None:
        self._done_m = _TAKE_OFF_DONE_SHARE * take_off_height_m
        self._found: str | None = None  # "" once it has left the mode in which it was found
        self._held = Debounce()
        self._silent_s, self._obeyed = -math.inf, False
        self._climbed = False
        self._last: str | None = None  # while the mission went on

    def listen(self, autopilot: AutopilotState, link: LinkHealth, now_s: float) -> None:
        """Note a silence that began while the autopilot obeyed; after one it has to obey again."""
        if not link.maybe_unheard:
            self._obeyed = autopilot.connected and autopilot.offboard
        elif self._obeyed:
            self._silent_s = now_s

    def taken_over(
        self,
        state: State,
        authority: Authority,
        autopilot: AutopilotState,
        *,
        requested: bool,
        over_home_m: float | None,
        now_s: float,
        asked: frozenset[ActionKind] = frozenset(),
    ) -> bool:
        """Whether the mode is one that we did not request.

        `asked`: what was asked for last, which counts once control was released. `requested`: the take-off,
        or from a pilot control, was granted. `over_home_m`: the height.
        """
        kind = autopilot.autopilot_kind
        if kind is None or not autopilot.mode:
            return False
        mode = self._last = short_name(autopilot.mode)
        if self._found is None or state in _BEFORE_ANY_REQUEST:
            self._found = mode
        if state in _BEFORE_ANY_REQUEST:
            return False
        self._climbed = self._climbed or over_home_m is None or over_home_m >= self._done_m
        theirs = authority is Authority.PILOT
        ours = self._ours(state, authority, autopilot, kind, asked)
        if mode in (frozenset({PROFILES[kind].control_mode}) if theirs else ours):
            self._found = self._found if mode == self._found else ""
            return False
        if authority is Authority.OURS and self._awaits_setpoints(autopilot, mode, kind, now_s):
            return False
        on_the_way_up = authority is Authority.NONE and state in {State.ARM, State.TAKE_OFF}
        as_found = (on_the_way_up or theirs) and mode == self._found
        # the autopilot may not have changed yet into the mode that was asked for
        return not (as_found and self._held.held_s("requested", requested, now_s) <= TAKES_S)

    def taken_since_end(self, autopilot: AutopilotState, asked: frozenset[ActionKind]) -> bool:
        """Whether the mode is neither the one that the mission ended in nor one that was asked for last."""
        kind = autopilot.autopilot_kind
        if kind is None or not autopilot.mode:
            return False
        return short_name(autopilot.mode) not in _asked_for(asked, autopilot, kind) | {self._last}

    def _ours(
        self,
        state: State,
        authority: Authority,
        autopilot: AutopilotState,
        kind: AutopilotKind,
        asked: frozenset[ActionKind],
    ) -> frozenset[str]:
        """The modes that what we requested leads to."""
        control = frozenset({PROFILES[kind].control_mode})
        if state in _LANDING or authority is Authority.RELEASED:
            asked = frozenset({ActionKind.LAND}) if state in _LANDING else asked
            return control | _asked_for(asked, autopilot, kind)
        if authority is Authority.OURS:
            return control
        profile = PROFILES[kind]
        if state is State.ARM:
            return profile.waits_in
        if state is State.TAKE_OFF and not self._climbed:
            # where a take-off ends is also where the vehicle may have been found
            end = short_name(profile.hold_mode)
            return profile.climbs_in - ({end} if self._found != end else frozenset())
        return profile.climbs_in | control

    def _awaits_setpoints(
        self, autopilot: AutopilotState, mode: str, kind: AutopilotKind, now_s: float
    ) -> bool:
        """Whether it waits for setpoints, which a silent link has kept from it: nobody chose its mode."""
        lately = now_s - self._silent_s <= _OBEYS_AGAIN_S
        return (
            lately
            and mode in WITHOUT_STICKS
            and short_name(autopilot.intended_mode) == PROFILES[kind].control_mode
        )
