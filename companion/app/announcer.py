"""Notices to people: each goes into the log and on to whoever listens, and is kept for a while."""

from collections import deque
from collections.abc import Callable
from typing import Final

from companion.base.clock import Clock
from companion.base.messages import Notice
from companion.flightlog.record import FlightLog
from companion.link.codec import Severity

KEPT: Final = 20
# the same fault again within it is for the log alone: many a second would crowd out everything else
REPEATED_S: Final = 2.0
# what the vehicle is about to do is no fault: it is told each time
_ACTIONS: Final = frozenset({"climb"})


class Announcer:
    """Takes notices; `deliver` sends each on to the ground station and the service manager."""

    def __init__(self, clock: Clock, log: FlightLog, deliver: Callable[[Notice], None]) -> None:
        self._clock, self._log, self._deliver = clock, log, deliver
        self._new: list[Notice] = []
        self._log_problem_reported = False
        self._notified_once: set[str] = set()
        self._told_s: dict[tuple[str, str, Severity], float] = {}
        self.recent: deque[Notice] = deque(maxlen=KEPT)

    def notify(self, kind: str, text: str, severity: Severity) -> None:
        """Tell something that happens now."""
        self.publish(Notice(self._clock.now_s(), kind, text, severity))

    def notify_once(self, kind: str, text: str, severity: Severity) -> None:
        """Tell something that holds on; what was told before goes into the log alone: each flight has it."""
        if text not in self._notified_once:
            self._notified_once.add(text)
            self.notify(kind, text, severity)
        else:
            now_s = self._clock.now_s()
            self._log.write("notice", Notice(now_s, kind, text, severity), now_s)

    def publish(self, notice: Notice) -> None:
        """Tell the log, the terminal and the ground station; the log alone of a fault that was just told."""
        self._log.write("notice", notice, notice.time_s)
        fault = notice.severity != "info" and notice.kind not in _ACTIONS
        if fault and self._just_told(notice):
            return
        self._new.append(notice)
        self.recent.append(notice)
        self._deliver(notice)

    def _just_told(self, notice: Notice) -> bool:
        told, now_s = (notice.kind, notice.text, notice.severity), notice.time_s
        self._told_s = {key: time_s for key, time_s in self._told_s.items() if now_s - time_s < REPEATED_S}
        return self._told_s.setdefault(told, now_s) < now_s

    def take(self) -> list[Notice]:
        """The notices since the last call."""
        new, self._new = self._new, []
        return new

    def watch_log(self) -> None:
        """Tell once that the log on disk has a gap or has ended; the flight goes on."""
        problem = self._log.problem
        reported, self._log_problem_reported = self._log_problem_reported, problem is not None
        if problem is not None and not reported:
            self.notify("record", problem, "warning")
