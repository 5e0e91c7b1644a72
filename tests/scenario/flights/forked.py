"""Flights of one scenario and seed that differ in their faults alone: what they have in common is flown once.

That a flight which goes on in a child is the one flown from its start, test_bench_faults_runs.py shows.
"""

import traceback
from collections.abc import Callable, Sequence
from typing import TypeVar

from benchmarks.faults.cases import FaultRun
from benchmarks.faults.fault_flight import fly_together
from benchmarks.faults.forks import Forks
from benchmarks.faults.judge import SafetyVerdict
from benchmarks.faults.witness import WitnessedFlight
from tests.scenario.flying import FEW_PICTURES

Seen = TypeVar("Seen")


def fly_forked(
    runs: Sequence[FaultRun], see: Callable[[SafetyVerdict, WitnessedFlight], Seen]
) -> dict[FaultRun, Seen]:
    """Fly them, each from its fault on in a child; returns what `see` takes from each, which is pickled.

    A run that failed in its child is not among them; why stands on standard error.
    """
    seen: dict[FaultRun, Seen] = {}

    def take(run: FaultRun, answer: Seen | None) -> None:
        if answer is not None:
            seen[run] = answer

    forks = Forks(1, take)
    try:
        for run, verdict, record in fly_together(runs, forks, FEW_PICTURES):
            answer = see(verdict, record)
            if forks.mine is not None:
                forks.deliver(answer)
            seen[run] = answer
        forks.wait()
    except BaseException:
        if forks.mine is not None:
            traceback.print_exc()
            forks.deliver(None)  # no child goes on as another worker of these tests
        raise
    finally:
        forks.stop()
    return seen
