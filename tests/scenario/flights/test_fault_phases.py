"""A few pairs of `make bench-faults`: a fault in a phase, judged by the simulator's own record."""

from __future__ import annotations

import pytest

from tests.bench.faults.cases import Run
from tests.bench.faults.fault_flight import fly_run
from tests.bench.faults.judge import Verdict


@pytest.mark.parametrize(
    ("fault", "phase", "outcome", "words"),
    [
        ("link lost 1 s", "descend", "landed", "landed: "),
        ("IMU NaN", "approach", "held", "estimate lost"),
        ("link 0.5 s late", "approach", "held", "link late: answers after 1.0"),
        ("pilot: Position", "last_metre", "pilot", "pilot took over"),
    ],
)
def test_a_fault_in_a_phase_ends_safely_and_with_a_reason(
    fault: str, phase: str, outcome: str, words: str
) -> None:
    verdict, record = fly_run(Run(fault, phase, "line", 0))  # type: ignore[arg-type]
    assert record.fault_began
    assert verdict == Verdict(outcome)  # type: ignore[arg-type]
    assert any(words in said.text for said in record.texts), record.texts
