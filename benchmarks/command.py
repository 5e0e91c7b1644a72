"""`python -m benchmarks NAME [options]` runs one benchmark; without NAME it lists them.

A benchmark is a module `bench_*.py` anywhere below this folder, with a function `main` that takes the words
after NAME and returns the exit status: 0 when all its bars hold. Its name is the module's, with hyphens; its
line in the list is the first of its docstring.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

from companion.base.errors import ConfigError

HERE: Final = Path(__file__).resolve().parent
PROGRAM: Final = "python -m benchmarks"


def discover() -> dict[str, str]:
    """The module of each benchmark, by name."""
    paths = sorted(HERE.rglob("bench_*.py"), key=lambda path: path.name)
    return {
        path.stem.removeprefix("bench_").replace("_", "-"): ".".join(
            path.relative_to(HERE.parent).with_suffix("").parts
        )
        for path in paths
    }


def summary(module: str) -> str:
    """The first line of a module's docstring; the module is not imported."""
    source = HERE.parent.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]


def main(words: Sequence[str] | None = None) -> int | str:
    """Run one, or list them; returns what `sys.exit` takes."""
    name, *rest = list(sys.argv[1:] if words is None else words) or ["--help"]
    found = discover()
    if name in {"-h", "--help"}:
        print(f"usage: {PROGRAM} NAME [options]; {PROGRAM} NAME --help\n")
        for each, module in found.items():
            print(f"{each:<16} {summary(module)}")
        return 0
    if name not in found:
        return f"{PROGRAM}: {name}: no such benchmark; expected one of {', '.join(found)}"
    sys.argv[:] = [f"{PROGRAM} {name}", *rest]  # argparse's usage line begins with it
    try:
        return int(import_module(found[name]).main(rest))
    except ConfigError as problem:
        return f"{PROGRAM} {name}: {problem}"
    except KeyboardInterrupt:
        return "stopped; the same command goes on where the rows are kept"
