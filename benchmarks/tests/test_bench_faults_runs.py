"""The bench of faults beside its judge: the solver's faults, the cases, the bars, and going on."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.faults import fault_flight
from benchmarks.faults.bench_faults import Take, bars, cell, main
from benchmarks.faults.cases import (
    CASES,
    PHASES,
    FaultRow,
    FaultRun,
    PhaseName,
    all_runs,
    one_each,
    scenario_of,
)
from benchmarks.faults.computer import FaultyTracker
from benchmarks.faults.forks import Forks
from benchmarks.faults.judge import SafetyVerdict
from benchmarks.faults.witness import TruthSample, WitnessedFlight
from benchmarks.rows_file import RowsFile, flights_key
from companion.base.motion import Motion
from companion.config import CompanionConfig
from companion.control.tracking import Target, TrackingSolution
from sitl.faults.targets import ComputerFaults

# ---------------------------------------------------------------- the solver's faults


class GoodTracker:
    """Always the same solution."""

    def solve(self, *_arguments: object) -> TrackingSolution:
        return TrackingSolution(np.ones((5, 3)), np.ones((5, 9)), iterations=3)

    def reset(self) -> None:
        """Nothing."""


def test_the_solver_fails_as_its_fault_says() -> None:
    faults = ComputerFaults()
    tracker = FaultyTracker(GoodTracker(), faults)
    zeros = np.zeros((6, 3))
    still = Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def solve() -> TrackingSolution:
        return tracker.solve(still, Target(zeros, zeros, zeros), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    assert solve().solved
    faults.solver = "infeasible"
    assert (solve().solved, solve().late) == (False, False)
    faults.solver = "late"
    assert (solve().solved, solve().late) == (False, True)
    faults.solver = "nan"
    assert solve().solved
    assert np.isnan(solve().inputs_m_s2).all()


# ---------------------------------------------------------------- cases and files


def test_every_case_is_a_scenario_and_every_phase_has_cases() -> None:
    runs = list(all_runs(list(CASES), PHASES, ["line"], 1))
    assert {run.phase for run in runs} == set(PHASES)
    assert len(set(runs)) == len(runs)
    for run in runs:
        scenario = scenario_of(run)
        assert len(scenario.faults) == len(CASES[run.fault].faults)


def test_seeds_put_a_fault_at_different_moments() -> None:
    moments = {
        scenario_of(FaultRun("frames lost", "last_metre", "line", k)).faults[0].below_m for k in range(5)
    }
    assert len(moments) == 5
    assert max(m for m in moments if m is not None) <= 1.0


def test_a_fault_s_own_delay_counts_from_the_row_s_beginning() -> None:
    lost, lands = scenario_of(FaultRun("link lost 4 s, LAND", "descend", "line", 2)).faults
    assert (lost.phase, lost.delay_s) == ("descend", 1.3)
    assert (lands.phase, lands.delay_s) == ("descend", 4.3)


def test_each_autopilot_has_its_own_parameters() -> None:
    row = "time-out 0.3 s, link lost 0.6 s"
    told = [scenario_of(FaultRun(row, "descend", "line", 0, kind)) for kind in ("px4", "ardupilot")]
    assert [scenario.autopilot_parameters for scenario in told] == [
        {"COM_OF_LOSS_T": 0.3},
        {"GUID_TIMEOUT": 0.3},
    ]


def row(outcome: str, fault: str = "GPS lost", phase: PhaseName = "descend", **more: object) -> FaultRow:
    values = {
        "scenario": "line",
        "seed": 0,
        "autopilot": "px4",
        "code": "abc",
        "began": True,
        "unsafe": "",
        "ended_s": 30.0,
        "said": "x",
    }
    return FaultRow(fault, phase, outcome=outcome, **(values | more))  # type: ignore[arg-type]


def test_the_bars_count_unsafe_ends_and_landings_where_a_fault_leaves_one_possible() -> None:
    good = [row("landed")] * 19 + [row("held", "frames lost")]
    assert [bar.holds for bar in bars([*good, row("held")])] == [True, True]
    assert [bar.holds for bar in bars([*good, row("held"), row("held")])] == [True, False]
    assert [bar.holds for bar in bars([*good, row("unsafe", "frames lost")])] == [False, True]
    assert cell([row("landed"), row("landed"), row("unsafe", began=False)]) == (
        "landed 2, unsafe 1 (1 before the fault)"
    )


def test_what_was_built_wrongly_and_is_not_landed_is_named() -> None:
    named = row("held", "print -3 %", "start", said="abort: estimate disputed: pad's scale: 3 % off")
    silent = row("held", "print -3 %", "start", said="abort: timeout: 30 s in search")
    landed = row("landed", "print -3 %", "start", said="landed: disarmed")
    assert [bar.holds for bar in bars([landed])] == [True]
    assert [bar.holds for bar in bars([*9 * [named], silent, landed])] == [True, True]
    assert [bar.holds for bar in bars([*8 * [named], silent])] == [True, False]


def landings(flown: list[FaultRun]) -> Callable[..., None]:
    """A `fly_group` whose flights all land."""

    def fly(runs: Sequence[FaultRun], code: str, _forks: Forks[FaultRow], take: Take) -> None:
        for run in runs:
            flown.append(run)
            take(run, FaultRow(*run, code, True, "landed", "", 30.0, "landed: disarmed"))

    return fly


def test_flights_that_are_there_are_not_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flown: list[FaultRun] = []
    monkeypatch.setattr("benchmarks.faults.bench_faults.fly_group", landings(flown))
    asked = ["bench", "--jobs", "1", "--faults", "GPS lost;30 uT", "--phases", "descend"]
    monkeypatch.setattr("sys.argv", [*asked, "--seeds", "1", "--out", str(tmp_path)])
    assert main().exit_status == 0
    assert len(flown) == 8
    assert {run.autopilot for run in flown} == {"px4", "ardupilot"}
    monkeypatch.setattr("sys.argv", [*asked, "--seeds", "2", "--out", str(tmp_path)])
    assert main().exit_status == 0
    assert [run.seed for run in flown[8:]] == [1] * 8
    said = capsys.readouterr().out
    assert "bars: unsafe ends 0 of 16 holds, landed where possible 100.0 % holds" in said
    assert "flown: 16 of the whole 16" in said


def test_a_flight_that_the_bench_could_not_fly_is_flown_again_and_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tries: list[FaultRun] = []
    record = WitnessedFlight(
        samples=[TruthSample(30.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, True, False, "LAND")]
    )

    def fly(
        runs: Sequence[FaultRun], _forks: Forks[FaultRow]
    ) -> Iterator[tuple[FaultRun, SafetyVerdict, WitnessedFlight]]:
        tries.append(runs[0])
        if runs[0].scenario == "circle" or len(tries) == 1:
            raise MemoryError("no room")
        yield runs[0], SafetyVerdict("landed"), record

    monkeypatch.setattr("benchmarks.faults.bench_faults.fly_together", fly)
    asked = ["bench", "--jobs", "1", "--faults", "GPS lost", "--phases", "descend", "--seeds", "1"]
    asked += ["--autopilots", "px4"]
    monkeypatch.setattr("sys.argv", [*asked, "--out", str(tmp_path)])
    assert main().exit_status == 1
    assert [run.scenario for run in tries] == ["line", "circle"] * 2
    assert "unsafe ends 0 of 1 holds" in capsys.readouterr().out
    code = flights_key(Path(fault_flight.__file__).parent)
    assert [row.scenario for row in RowsFile(tmp_path / "runs.jsonl", FaultRow).read(code)] == ["line"]


def test_one_flight_of_each_fault_in_each_phase_takes_scenarios_and_seeds_in_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = set(all_runs(list(CASES), PHASES, ["line", "circle"], 5))
    choice = (list(CASES), PHASES, ["line", "circle"], 5)
    once, twice = one_each(*choice, 1), one_each(*choice, 2)
    pairs = {(run.fault, run.phase) for run in whole}
    assert sorted((run.fault, run.phase) for run in once) == sorted(pairs)
    assert twice[: len(once)] == once
    assert len(set(twice)) == 2 * len(pairs)
    assert set(one_each(*choice, 99)) == whole
    for phase in PHASES:  # no phase is flown in one scenario or under one seed alone
        kinds = {(run.scenario, run.seed) for run in once if run.phase == phase}
        assert len(kinds) >= 5
    monkeypatch.setattr("benchmarks.faults.bench_faults.fly_group", landings([]))
    # those with the disk are flown from their start
    asked = ["bench", "--jobs", "1", "--each", "1", "--out", str(tmp_path), "--faults", "GPS lost;30 uT"]
    monkeypatch.setattr("sys.argv", asked)
    assert main().exit_status == 0
    assert "flown: 20 of the whole 200" in capsys.readouterr().out


def test_ardupilot_flies_every_pair_too_and_what_is_wrong_from_the_start_is_flown_from_there() -> None:
    choice = (list(CASES), PHASES, ["line", "circle"], 5)
    once = one_each(*choice, 1, ("px4", "ardupilot"))
    assert len(once) == 2 * len(one_each(*choice, 1))
    for run in once:
        scenario = scenario_of(run)
        assert scenario.autopilot == run.autopilot
        case = CASES[run.fault]
        of_its_own = case.changes or case.parameters or case.signed or case.stands_by
        assert case.flown_alone == bool(case.on_disk or of_its_own)
        assert scenario.faults or of_its_own


# ---------------------------------------------------------------- children

FORKED = """
from benchmarks.faults import cases
from benchmarks.faults.bench_faults import fly_all, fly_alone
from benchmarks.faults.cases import FaultRun

cases.TIME_LIMIT_S = 8.0
runs = [FaultRun("pilot: Hold", "start", "line", 0), FaultRun("refuses arm", "start", "line", 0)]
runs.append(FaultRun("GPS lost", "on_pad", "line", 0))
rows = {}
fly_all(runs, "abc", 1, rows.__setitem__)
assert rows == {run: fly_alone(run, "abc") for run in runs}, rows
print(*(rows[run].outcome for run in runs), *(int(rows[run].began) for run in runs), sep=",")
"""


def test_a_flight_that_goes_on_in_a_child_is_the_one_flown_from_its_start() -> None:
    flown = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, check=False, timeout=300
    )
    assert flown.stderr == ""
    assert flown.stdout.strip() == "pilot,unsafe,unsafe,1,1,0"  # cut short: two have no end


def test_a_child_that_ends_without_a_row_is_no_flight() -> None:
    taken: dict[FaultRun, FaultRow | None] = {}
    forks = Forks[FaultRow](2, taken.__setitem__)
    runs = [FaultRun("GPS lost", "descend", "line", seed) for seed in range(3)]
    for run in runs:
        if forks.begin(run):
            if run.seed == 1:
                os._exit(3)
            forks.deliver(row("landed", seed=run.seed))
    forks.wait()
    assert taken == {run: None if run.seed == 1 else row("landed", seed=run.seed) for run in runs}


def test_the_key_of_the_results_covers_the_judge_the_cases_and_the_settings(tmp_path: Path) -> None:
    bench, configs = tmp_path / "bench", tmp_path / "configs"
    for folder in (bench, configs / "scenarios"):
        folder.mkdir(parents=True)
    (bench / "judge.py").write_text("a")
    (configs / "scenarios" / "line.yaml").write_text("b")

    def key(code: str = "abc") -> str:
        return flights_key(bench, code, configs)

    keys = {key(), key("abd")}
    (bench / "judge.py").write_text("c")
    keys.add(key())
    (configs / "scenarios" / "line.yaml").write_text("d")
    keys.add(key())
    assert len(keys) == 4
    assert key() == key()


@pytest.mark.parametrize(
    ("fault", "began", "expected"),
    [("pilot: Hold", True, True), ("pilot: Hold", False, False), ("GPS lost", True, False)],
)
def test_a_pilots_end_needs_a_pilots_fault_that_began(
    monkeypatch: pytest.MonkeyPatch, fault: str, began: bool, expected: bool
) -> None:
    sample = TruthSample(1.0, (0.0, 0.0, -5.0), (0.0, 0.0, 0.0), 5.0, False, True, "AUTO_LOITER")
    record = WitnessedFlight(samples=[sample], fault_began=began)
    monkeypatch.setattr(fault_flight, "fly", lambda *_, **__: (record, CompanionConfig()))
    assert fault_flight.fly_run(FaultRun(fault, "descend", "line", 0))[1].pilot_took_over == expected
