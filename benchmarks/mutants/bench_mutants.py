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
import copy
import os
import signal
import sys
import tempfile
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest
from rich.table import Table

from benchmarks.report import BenchReport
from companion.control import limits
from sitl.campaign.tables import Bar

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


# ---------------------------------------------------------------- mutate
# Mutants of a module's source: one small change each, by its syntax tree. Pure.
#
# The changes are the usual ones: another comparison or operator, a condition that is always or never so,
# another number or text, a call or a keyword or a statement less, and for or, smaller for larger.

_COMPARED: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_COUNTED: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}
_CALLED: Final = {"min": "max", "max": "min", "all": "any", "any": "all", "sin": "cos", "cos": "sin"}


@dataclass(frozen=True, slots=True)
class Mutant:
    """A changed module: in which line it differs, how, and its tree."""

    line: int
    text: str
    before: str
    after: str
    tree: ast.Module

    @property
    def name(self) -> str:
        """What it changes and in which line's text, without the line's number, which moves."""
        return f"{self.text}: {self.before}  ->  {self.after}"


def mutants(source: str) -> Iterator[Mutant]:
    """All mutants of a module."""
    tree, lines = ast.parse(source), source.split("\n")
    for index, node in enumerate(ast.walk(tree)):
        if not hasattr(node, "lineno") or _is_note(tree, node):
            continue
        for changed in _changes(node):
            mutant = copy.deepcopy(tree)
            _put(mutant, list(ast.walk(mutant))[index], changed)
            ast.fix_missing_locations(mutant)
            after = "(nothing)" if isinstance(changed, ast.Pass) else ast.unparse(changed)
            text = lines[node.lineno - 1].strip()
            yield Mutant(node.lineno, text, ast.unparse(node), after, mutant)


def _put(tree: ast.Module, old: ast.AST, new: ast.AST) -> None:
    """Replace a node of a tree."""
    ast.copy_location(new, old)
    for parent in ast.walk(tree):
        for field, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, field, new)
                return
            if isinstance(value, list) and any(item is old for item in value):
                value[:] = [new if item is old else item for item in value]
                return


def _is_note(tree: ast.Module, node: ast.AST) -> bool:
    """Whether a node is a docstring, an annotation or an import: nothing that runs in a step."""
    for parent in ast.walk(tree):
        if isinstance(parent, ast.Import | ast.ImportFrom) and node in (parent, *parent.names):
            return True
        text = parent.value if isinstance(parent, ast.Expr) else None
        if isinstance(text, ast.Constant) and (node is parent or node is text):
            return True
        notes = [getattr(parent, name, None) for name in ("annotation", "returns")]
        if any(note is not None and any(node is part for part in ast.walk(note)) for note in notes):
            return True
    return False


# ---------------------------------------------------------------- one function a kind of change


def _changes(node: ast.AST) -> Iterator[ast.AST]:
    match node:
        case ast.Compare():
            yield from _compared(node)
        case ast.BinOp(op=op) if type(op) in _COUNTED:
            yield _with(node, op=_COUNTED[type(op)]())
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield copy.deepcopy(operand)
        case ast.BoolOp(op=op, values=values):
            yield _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
            yield from (copy.deepcopy(value) for value in values)
        case ast.Constant():
            yield from _constants(node)
        case ast.If() | ast.IfExp():
            yield from (_with(node, test=ast.Constant(always)) for always in (True, False))
        case ast.Call():
            yield from _called(node)
        case ast.Expr() | ast.Assign() | ast.AnnAssign() | ast.AugAssign():
            yield ast.Pass()
        case ast.Return(value=value) if not (value is None or _is_none(value)):
            yield ast.Return(ast.Constant(None))


def _is_none(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and value.value is None


def _with(node: ast.AST, **fields: ast.AST) -> ast.AST:
    changed = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _compared(node: ast.Compare) -> Iterator[ast.AST]:
    for place, op in enumerate(node.ops):
        for other in _COMPARED[type(op)]:
            changed = copy.deepcopy(node)
            changed.ops[place] = other()
            yield changed


def _constants(node: ast.Constant) -> Iterator[ast.AST]:
    value = node.value
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int | float):
        others = dict.fromkeys((value + 1, value * 0, value * 1.5))
        yield from (ast.Constant(other) for other in others if other != value)
    elif isinstance(value, str):
        yield ast.Constant(value + "x")


def _called(node: ast.Call) -> Iterator[ast.AST]:
    """Another function, one keyword less, or what a function of one argument was given."""
    if isinstance(node.func, ast.Name) and node.func.id in _CALLED:
        yield _with(node, func=ast.Name(_CALLED[node.func.id], ast.Load()))
    for place in range(len(node.keywords)):
        changed = copy.deepcopy(node)
        del changed.keywords[place]
        yield changed
    if len(node.args) == 1 and not node.keywords and not isinstance(node.args[0], ast.Starred):
        yield copy.deepcopy(node.args[0])


# ---------------------------------------------------------------- branches


class BranchMarker(ast.NodeTransformer):
    """Wraps every condition into `_branch(number, condition)`, so that its values can be noted."""

    def __init__(self) -> None:
        self.conditions: list[tuple[int, str]] = []

    def _noted(self, test: ast.expr) -> ast.expr:
        self.conditions.append((test.lineno, ast.unparse(test)))
        number = ast.Constant(len(self.conditions) - 1)
        noted = ast.Call(ast.Name("_branch", ast.Load()), [number, test], [])
        return ast.copy_location(noted, test)

    def visit_If(self, node: ast.If) -> ast.AST:
        """A statement's condition."""
        node.test = self._noted(node.test)
        return self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        """An expression's condition."""
        node.test = self._noted(node.test)
        return self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        """Each part of an `and` or `or`: it decides whether the next one is looked at."""
        node.values = [self._noted(value) for value in node.values]
        return self.generic_visit(node)
