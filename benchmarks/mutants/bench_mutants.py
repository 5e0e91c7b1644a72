"""The last gate's tests against mutants of the gate: which of them would nobody notice?

    python -m benchmarks mutants

Each mutant is `companion/control/limits.py` with one small change; the gate's own tests run on it in a
process of their own, and fail, or it survives. First the tests run on the module as it is, with every
condition noted: each has to have been both true and false. Survivors are explained in `survivors`; one that
is not fails the bar.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import os
import signal
import sys
import tempfile
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import pytest
from rich.table import Table

from benchmarks.mutants.mutate import BranchMarker, Mutant, mutants
from benchmarks.report import BenchReport
from companion.control import limits
from sitl.campaign.figures import Bar

_ROUNDING: Final = "an allowance for rounding: a thousand times smaller than what any autopilot resolves"
_EDGE: Final = "differs only for a number that is the bound, its allowance included, to the last bit"
_STAMP: Final = "`apply` stamps what leaves with its own time"
_BETWEEN: Final = "if low - 1e-12 <= value <= high + 1e-12:"
_CHANGE: Final = "low - 1e-12 <= value <= high + 1e-12"
_NUMBER: Final = "numbers.append(size if size > 1e-6 else math.inf)  # no direction is no number either"
_LEVEL: Final = "return Setpoint(time_s=0.0, heading_rad=heading"
# mutants of the last gate that no test can tell from it, and why
SURVIVORS: Final[dict[str, str]] = {
    "ROUNDING = 1.0 + 1e-9: 1e-09  ->  1.5000000000000002e-09": _ROUNDING,
    "if size <= most * ROUNDING:: most * ROUNDING  ->  most / ROUNDING": _ROUNDING,
    f"{_BETWEEN}: 1e-12  ->  0.0": _ROUNDING,
    f"{_BETWEEN}: 1e-12  ->  1.5e-12": _ROUNDING,
    "if size <= radius * ROUNDING:: size <= radius * ROUNDING  ->  size < radius * ROUNDING": _EDGE,
    f"{_BETWEEN}: {_CHANGE}  ->  low - 1e-12 < value <= high + 1e-12": _EDGE,
    f"{_BETWEEN}: {_CHANGE}  ->  low - 1e-12 <= value < high + 1e-12": _EDGE,
    f"{_NUMBER}: size > 1e-06  ->  size >= 1e-06": _EDGE,
    f"{_NUMBER}: 1e-06  ->  1.5e-06": "no estimate gives a quaternion of this size; as small a one is a hold",
    f"{_LEVEL}): 0.0  ->  1.0": _STAMP,
    f"{_LEVEL}, attitude=upright, thrust=self._hover_thrust): 0.0  ->  1.0": _STAMP,
}


SMOKE: Final = ("--branches-only",)
MODULE: Final = "companion.control.limits"
SOURCE: Final = Path(limits.__file__)
_ROOT: Final = Path(__file__).resolve().parents[2]
TESTS: Final = ("tests/unit/control/test_limits_gate.py", "tests/property/test_limits.py")
PATIENCE_S: Final = 60
_QUIET: Final = (
    *("-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=", "--no-header"),
    *("--hypothesis-seed=0", "-p", "no:randomly"),
)


_USERS: Final = ("companion.control", "tests.unit.control", "tests.property")


def load(tree: ast.Module, **names: object) -> None:
    """Put a tree in the place of the gate's module, in this process."""
    module = types.ModuleType(MODULE)
    module.__file__ = str(SOURCE)
    module.__dict__.update(names)
    # whoever was imported before would go on with the module as it is
    for name in [name for name in sys.modules if name.startswith(_USERS)]:
        del sys.modules[name]
    sys.modules[MODULE] = module
    exec(compile(ast.fix_missing_locations(tree), str(SOURCE), "exec"), module.__dict__)


def in_a_child(work: Callable[[], int]) -> int:
    """What `work` returns in a forked process without output; a hung one counts as failed (1)."""
    child = os.fork()
    if child == 0:
        status = 1
        with contextlib.suppress(BaseException):
            signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)  # of processor time: the machine may be busy
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            status = work()
        os._exit(status)
    _, ended = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(ended)


def passes(tree: ast.Module, tests: Sequence[str]) -> bool:
    """Whether the tests pass on a tree."""

    def work() -> int:
        load(tree)
        return _run(tests)

    return in_a_child(work) == 0


def _run(tests: Sequence[str]) -> int:
    with tempfile.TemporaryDirectory(prefix="bench-mutants-") as folder:
        os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = folder
        return int(pytest.main([*_QUIET, "--rootdir", str(_ROOT), *(str(_ROOT / test) for test in tests)]))


def branches_missed(source: str, tests: Sequence[str]) -> tuple[int, list[str]]:
    """How many conditions there are, and which of them the tests never find true, or never false."""
    noted = BranchMarker()
    tree = noted.visit(ast.parse(source))
    with tempfile.NamedTemporaryFile(prefix="bench-mutants-") as file:
        seen: set[tuple[int, bool]] = set()

        def branch(number: int, value: object) -> object:
            seen.add((number, bool(value)))
            return value

        def work() -> int:
            load(tree, _branch=branch)
            status = _run(tests)
            Path(file.name).write_text("".join(f"{number} {int(value)}\n" for number, value in seen))
            return status

        if in_a_child(work) != 0:
            return len(noted.conditions), ["the tests fail on the module as it is"]
        lines = Path(file.name).read_text().split("\n")[:-1]
    there = {tuple(map(int, line.split())) for line in lines}
    return len(noted.conditions), [
        f"line {line}: {text} is never {bool(value)}"
        for number, (line, text) in enumerate(noted.conditions)
        for value in (1, 0)
        if (number, value) not in there
    ]


def survivors_table(survived: Sequence[Mutant]) -> Table:
    """A row a survivor, with why no test can tell it."""
    made = Table("line", "survivor", "why")
    for mutant in survived:
        made.add_row(f"{mutant.line}", mutant.name, SURVIVORS.get(mutant.name, "NOT EXPLAINED"))
    return made


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Mutate; 0 when the bars hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--branches-only", action="store_true", help="no mutants")
    options = parser.parse_args(arguments)
    report = BenchReport()
    source = SOURCE.read_text(encoding="utf-8")
    count, missed = branches_missed(source, TESTS)
    for text in missed:
        report.show(text)
    bars = [Bar("conditions both true and false", f"{count - len(missed)} of {count}", not missed)]
    if not options.branches_only:
        made = list(mutants(source))
        survived = [mutant for mutant in made if passes(mutant.tree, TESTS)]
        report.show(survivors_table(survived))
        unexplained = sum(mutant.name not in SURVIVORS for mutant in survived)
        bars.append(Bar("mutants killed", f"{len(made) - len(survived)} of {len(made)}", holds=True))
        bars.append(Bar("survivors not explained", f"{unexplained}", unexplained == 0))
    return report.judge(bars)
