"""The events of a mission, as the monitors, the search and the landing detect them, with their reasons.

Beside them what the parts of the planner announce by: `Announcements`.
"""

import math
from enum import StrEnum
from typing import Final, Literal

from companion.base.messages import Notice

NoticeSeverity = Literal["info", "warning", "error"]

NOTICE_THRESHOLD_M: Final = 0.2  # a climb that is announced


class MissionEvent(StrEnum):
    """What can happen to a mission."""

    LAND_ORDERED = "land_ordered"  # in standby, and nothing stands against it
    FLY_ORDERED = "fly_ordered"
    READY = "ready"  # autopilot connected and ready to arm, our estimate aligned
    ALREADY_ARMED = "already_armed"  # and not by us
    ALIGNMENT_LOST = "alignment_lost"  # our estimate's, before the autopilot would arm
    ARMED = "armed"  # by us: our request was granted
    ARMED_IN_DOUBT = "armed_in_doubt"  # by us or by a pilot: our request was neither granted nor denied
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
    COMMIT = "commit"  # a contact within the limits has been likely for a moment
    CLEAR = "clear"  # at rest by our setpoints, and clear of the pad
    BREAK_OFF = "break_off"  # hard or aside, with room: back to where it waits; counts no try
    RISEN = "risen"  # climbing after a break-off
    CONTACT = "contact"  # the feet stand: a height or echoes, and a stopped sink or the autopilot's word
    LANDING_DETECTED = "landing_detected"  # by the autopilot
    AT_REST = "at_rest"  # shown to rest on the pad, without the autopilot's word
    UNPROVEN = "unproven"  # neither, and nothing shows the feet down
    PAD_GONE = "pad_gone"  # lost without room to rise, or a height says down and no sink is felt: LAND
    OFF_PAD = "off_pad"  # it does not stay: the pad is well below or slides, or a silent link may have it off
    PAD_LOST = "pad_lost"
    GROUND_NEAR = "ground_near"  # echoes far nearer than the pad's estimate: the estimate is wrong
    MISALIGNED = "misaligned"  # no contact from here: not settled, aside, sliding, overdue; counts a try
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
    TIPPED_OVER = "tipped_over"  # it lies on its side, by both attitudes and by what is felt
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


_NEVER: Final = (-math.inf, "")


class Announcements:
    """Call it to announce something in this cycle; `drain` gives what was announced since the last."""

    def __init__(self) -> None:
        self._said: list[Notice] = []
        self._last: dict[str, tuple[float, str]] = {}  # when, and what kind, something of this was last

    def __call__(self, kind: str, text: str, now_s: float, severity: NoticeSeverity = "info") -> None:
        self._said.append(Notice(now_s, kind, text, severity))

    def once(self, of: str, kind: str, text: str, now_s: float) -> None:
        """Warn of it the first time only."""
        if of not in self._last:
            self._last[of] = now_s, kind
            self(kind, text, now_s, "warning")

    def again(
        self, kind: str, text: str, now_s: float, after_s: float, severity: NoticeSeverity = "info"
    ) -> None:
        """Say it, but not in every cycle: no sooner than so long after the last of its kind."""
        if now_s - self._last.get(kind, _NEVER)[0] >= after_s:
            self._last[kind] = now_s, kind
            self(kind, text, now_s, severity)

    def change(
        self, of: str, kind: str, text: str, now_s: float, after_s: float, severity: NoticeSeverity
    ) -> None:
        """Say it if the last of this was of another kind, and so long ago; the first is taken as known."""
        last_s, last = self._last.setdefault(of, (-math.inf, kind))
        if kind != last and now_s - last_s >= after_s:
            self._last[of] = now_s, kind
            self(kind, text, now_s, severity)

    def drain(self) -> tuple[Notice, ...]:
        said = tuple(self._said)
        self._said.clear()
        return said
