"""A few pairs of `make bench-faults`: a fault in a phase, judged by the simulator's own record."""

from typing import Final

import pytest

from benchmarks.faults.cases import FaultRun, PhaseName
from benchmarks.faults.judge import SafetyVerdict
from benchmarks.faults.witness import WitnessedFlight
from tests.scenario.flights.forked import fly_forked

# fault and phase; the outcome, and words of its reason
PAIRS: Final[dict[tuple[str, PhaseName], tuple[str, str]]] = {
    ("link lost 1 s", "descend"): ("landed", "landed: "),
    ("IMU NaN", "approach"): ("held", "estimate lost"),
    ("link 0.5 s late", "approach"): ("held", "link late: round trip 1.0"),
    ("pilot: Position", "last_metre"): ("pilot", "taken over"),
}
RUNS: Final = {pair: FaultRun(*pair, "line", 0) for pair in PAIRS}


@pytest.fixture(scope="module")
def flown() -> dict[FaultRun, tuple[SafetyVerdict, WitnessedFlight]]:
    return fly_forked(list(RUNS.values()), lambda verdict, record: (verdict, record))


@pytest.mark.parametrize("pair", PAIRS)
def test_a_fault_in_a_phase_ends_safely_and_with_a_reason(
    pair: tuple[str, PhaseName], flown: dict[FaultRun, tuple[SafetyVerdict, WitnessedFlight]]
) -> None:
    outcome, words = PAIRS[pair]
    verdict, record = flown[RUNS[pair]]
    assert record.fault_began
    assert verdict == SafetyVerdict(outcome)  # type: ignore[arg-type]
    assert any(words in said.text for said in record.texts), record.texts
