"""Mutants of a module's source: one small change each, by its syntax tree. Pure.

The changes are the usual ones: another comparison or operator, a condition that is always or never so,
another number or text, a call or a keyword or a statement less, and for or, smaller for larger.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

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
