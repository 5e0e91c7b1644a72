"""When each fault of a scenario begins and ends; at each change all are applied anew.

A fault that begins by what happens in the flight waits for that (`Moments`); the others have their time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from sitl.faults import faults
from sitl.faults.injection import INJECT, FaultTargets
from sitl.faults.non_sensor_injection import BEGIN, END, NonSensorTargets
from sitl.faults.times import FaultTimes
from sitl.mavlink.status_text_monitor import StatusTextMonitor


@dataclass(frozen=True, slots=True)
class Moments:
    """What a fault can begin by: the app's words, and the feet's height (m) over the pad, None beside it."""

    words: StatusTextMonitor = field(default_factory=StatusTextMonitor)
    feet_over_pad_m: Callable[[], float | None] = field(default=lambda: None)

    def happened_s(self, fault: FaultTimes, now_s: float) -> float | None:
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

    def __init__(
        self, plan: Sequence[faults.Fault], targets: FaultTargets, moments: Moments | None = None
    ) -> None:
        """Ready at time 0.

        Raises:
            ConfigError: a fault has nothing here that it could act on.
        """
        self._targets = targets
        self._moments = moments or Moments()
        self._waiting = list(plan)
        self._due: list[tuple[float, faults.Fault]] = []
        self._present: list[tuple[float, faults.Fault]] = []  # until when, in the order of their beginnings
        if targets.non_sensor is not None:
            targets.non_sensor.check({fault.kind for fault in plan})

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
        begun = [fault for begins_s, fault in self._due if begins_s <= now_s]
        ended = [fault for until_s, fault in self._present if until_s <= now_s]
        if not begun and not ended:
            return
        until_s = {id(fault): begins_s + fault.lasts_s for begins_s, fault in self._due}
        self._due = [(begins_s, fault) for begins_s, fault in self._due if begins_s > now_s]
        self._present = [(end_s, fault) for end_s, fault in self._present if end_s > now_s]
        self._present += [(until_s[id(fault)], fault) for fault in begun]
        self._targets.clear_faults()
        for _, fault in self._present:
            if fault.kind in INJECT:
                INJECT[fault.kind](fault, self._targets)
        self._happen(begun, ended, now_s)

    def _look(self, now_s: float) -> None:
        """Note the time at which each fault begins, once that is known."""
        for fault in tuple(self._waiting):
            since_s = self._moments.happened_s(fault, now_s)
            if since_s is not None:
                self._waiting.remove(fault)
                self._due.append((since_s + fault.delay_s, fault))

    def _happen(self, begun: list[faults.Fault], ended: list[faults.Fault], now_s: float) -> None:
        non_sensor: NonSensorTargets | None = self._targets.non_sensor
        if non_sensor is None:
            return
        for table, those in ((END, ended), (BEGIN, begun)):
            for fault in those:
                if fault.kind in table:
                    table[fault.kind](fault, non_sensor, now_s)
