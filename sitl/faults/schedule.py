"""When each fault of a scenario begins and ends; at each change all are applied anew.

A fault that begins by what happens in the flight waits for that (`Moments`); the others have their time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from companion.link.codec import mavlink
from sitl.faults.faults import Fault
from sitl.faults.targets import FaultTargets
from sitl.mavlink.framing import FrameReader, MavFrame

# ---------------------------------------------------------------- status text monitor
# What the app says, heard on its line: STATUSTEXT, the phases and the first sighting in it. Sans I/O.
#
# A fault can begin by it, and a judge of the flight reads it. Only what the app says to everybody is heard.


class StatusTextMonitor:
    """Collects an app's texts. The bytes are whole frames."""

    def __init__(self) -> None:
        self.texts: list[AppText] = []
        self.phase_began_s: dict[str, float] = {}
        self.sighted_s: float | None = None
        self._reader = FrameReader(datagrams=True)
        self._decoder = mavlink.MAVLink(None)
        self._chunks: dict[int, list[str]] = {}

    def hear(self, data: bytes, now_s: float) -> None:
        for frame in self._reader.read(data, now_s):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self._take(frame, now_s)

    def _take(self, frame: MavFrame, now_s: float) -> None:
        message = self._decoder.decode(bytearray(frame.data))
        words = str(message.text)
        if message.id != 0:
            self._chunks.setdefault(message.id, []).append(words)
            if len(words.encode("utf-8", "replace")) >= _WHOLE_CHUNK_BYTES:
                return
            words = "".join(self._chunks.pop(message.id))
        self._note(AppText(now_s, int(message.severity), words))

    def _note(self, said: AppText) -> None:
        self.texts.append(said)
        phase, colon, rest = said.text.partition(": ")
        if not colon:
            return
        self.phase_began_s.setdefault(phase, said.time_s)
        if self.sighted_s is None and rest.startswith(_SIGHTING):
            self.sighted_s = said.time_s


@dataclass(frozen=True, slots=True)
class Moments:
    """What a fault can begin by: the app's words, and the feet's height (m) over the pad, None beside it."""

    words: StatusTextMonitor = field(default_factory=StatusTextMonitor)
    feet_over_pad_m: Callable[[], float | None] = field(default=lambda: None)

    def happened_s(self, fault: Fault, now_s: float) -> float | None:
        """Since when what the fault waits for has been so (s); None: it has not yet."""
        if fault.start_s is not None:
            return fault.start_s
        if fault.phase is not None:
            return self.words.phase_began_s.get(fault.phase)
        if fault.after_sighting_s is not None:
            seen_s = self.words.sighted_s
            return None if seen_s is None else seen_s + fault.after_sighting_s
        height_m = self.feet_over_pad_m()
        low = height_m is not None and fault.below_m is not None and height_m <= fault.below_m
        return now_s if low else None


class Schedule(Protocol):
    """What a simulation steps."""

    @property
    def all_begun(self) -> bool:
        """Whether no fault is still to come."""

    def step(self, now_s: float) -> None:
        """Once per physics step, before the sensors' step."""


class FaultSchedule:
    """Begins and ends the faults."""

    def __init__(self, plan: Sequence[Fault], targets: FaultTargets, moments: Moments | None = None) -> None:
        """Ready at time 0.

        Raises:
            ConfigError: a fault has nothing here that it could act on.
        """
        self._targets = targets
        self._moments = moments or Moments()
        self._waiting = list(plan)
        self._due: list[tuple[float, Fault]] = []
        self._present: list[tuple[float, Fault]] = []  # until when, in the order of their beginnings
        for fault in plan:
            fault.check(targets)

    @property
    def all_begun(self) -> bool:
        """Whether no fault is still to come."""
        return not self._waiting and not self._due

    def due_s(self, now_s: float) -> float | None:
        """When the fault begins that `step` would let begin now; None: none does."""
        if self._waiting:
            self._look(now_s)
        return min((begins_s for begins_s, _ in self._due if begins_s <= now_s), default=None)

    def step(self, now_s: float) -> None:
        """Once per physics step, before the sensors' step."""
        if self._waiting:
            self._look(now_s)
        begun = [(begins_s, fault) for begins_s, fault in self._due if begins_s <= now_s]
        ended = [fault for until_s, fault in self._present if until_s <= now_s]
        if not begun and not ended:
            return
        self._due = [(begins_s, fault) for begins_s, fault in self._due if begins_s > now_s]
        self._present = [(end_s, fault) for end_s, fault in self._present if end_s > now_s]
        self._present += [(begins_s + fault.lasts_s, fault) for begins_s, fault in begun]
        self._targets.clear_faults()
        for _, fault in self._present:
            fault.apply(self._targets)
        for fault in ended:
            fault.end(self._targets, now_s)
        for _, fault in begun:
            fault.begin(self._targets, now_s)

    def _look(self, now_s: float) -> None:
        """Note the time at which each fault begins, once that is known."""
        for fault in tuple(self._waiting):
            since_s = self._moments.happened_s(fault, now_s)
            if since_s is not None:
                self._waiting.remove(fault)
                self._due.append((since_s + fault.delay_s, fault))


_WHOLE_CHUNK_BYTES: Final = 50
_SIGHTING: Final = "pad seen"


class AppText(NamedTuple):
    """One text: when (s of the simulation), MAV_SEVERITY, and the words."""

    time_s: float
    severity: int
    text: str
