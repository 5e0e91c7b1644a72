"""In place of a flight's faults: where one is due, the flight goes on with it in a process of its own.

Up to its fault a flight is the same whatever will fail, to the bit. So a flight without any fault is flown
once per scenario and seed, and forks for each run at the step of the physics at which its fault begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from benchmarks.faults.cases import FaultRun, faults_of
from benchmarks.faults.forks import Forks
from sitl.faults.faults import Fault
from sitl.faults.schedule import FaultSchedule
from sitl.run.simulation import Simulation


@dataclass(frozen=True, slots=True)
class _Moment:
    """Runs whose faults begin at the same moment, by a schedule that is never stepped."""

    schedule: FaultSchedule
    runs: tuple[FaultRun, ...]


class ForkedSchedule:
    """The schedule of a flight that forks; in a child the simulation gets the run's own."""

    def __init__(self, simulation: Simulation, runs: Sequence[FaultRun], forks: Forks[Any]) -> None:
        self._simulation, self._forks = simulation, forks
        self._moments = [
            _Moment(simulation.fault_schedule(faults_of(together[0])[:1]), together)
            for together in _by_moment(runs)
        ]

    @property
    def all_begun(self) -> bool:
        """Whether no fault is still to come: without one, never."""
        return False

    @property
    def left(self) -> list[FaultRun]:
        """The runs whose fault has not begun yet."""
        return [run for moment in self._moments for run in moment.runs]

    def step(self, now_s: float) -> None:
        """Fork for what is due; each child goes on with its faults."""
        for moment in tuple(self._moments):
            begins_s = moment.schedule.due_s(now_s)
            if begins_s is None:
                continue
            self._moments.remove(moment)
            for run in moment.runs:
                if self._forks.begin(run):
                    self._go_on(run, begins_s, now_s)
                    return

    def _go_on(self, run: FaultRun, begins_s: float, now_s: float) -> None:
        own = faults_of(run)
        faults = [_at(fault, begins_s, fault.delay_s - own[0].delay_s) for fault in own]
        self._simulation.faults = self._simulation.fault_schedule(faults)
        self._simulation.faults.step(now_s)


def _by_moment(runs: Sequence[FaultRun]) -> list[tuple[FaultRun, ...]]:
    def moment(run: FaultRun) -> str:
        fault = faults_of(run)[0]
        return repr((fault.start_s, fault.phase, fault.below_m, fault.delay_s))

    return [tuple(together) for _, together in groupby(sorted(runs, key=moment), key=moment)]


def _at(fault: Fault, begins_s: float, delay_s: float) -> Fault:
    return fault.model_copy(
        update={
            "start_s": begins_s,
            "phase": None,
            "below_m": None,
            "after_sighting_s": None,
            "delay_s": delay_s,
        }
    )
