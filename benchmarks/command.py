"""`python -m benchmarks NAME [options]` runs one benchmark; without NAME it lists them.

A benchmark is a module `bench_*.py` anywhere below this folder, with a function `main` that takes the words
after NAME and returns a `BenchReport`. Its name is the module's, with hyphens; its line in the list is the
first of its docstring. `SMOKE` are the words of a run that takes seconds, and `NEEDS` what not every machine
has. All of them know `--json FILE` (write the results, with commit, machine and date) and `--smoke`.
"""

import argparse
import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

from benchmarks.report import BenchReport
from companion.base.errors import ConfigError
from companion.base.files import must_be_writable

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


def main(words: Sequence[str] | None = None) -> int:
    """Run one, or list them; returns the exit status: 0 when all bars hold."""
    name, *rest = list(sys.argv[1:] if words is None else words) or ["--help"]
    found = discover()
    if name in {"-h", "--help"}:
        print(f"usage: {PROGRAM} NAME [--smoke] [--json FILE] [options]; {PROGRAM} NAME --help\n")
        for each, path in found.items():
            print(f"{each:<16} {summary(path)}")
        return 0
    if name not in found:
        return _refused(f"{name}: no such benchmark; expected one of {', '.join(found)}")
    common = argparse.ArgumentParser(PROGRAM, add_help=False, allow_abbrev=False)
    common.add_argument("--smoke", action="store_true")
    common.add_argument("--json", type=Path)
    ours, rest = common.parse_known_args(rest)
    sys.argv[:] = [f"{PROGRAM} {name}", *rest]  # argparse's usage line begins with it
    module = import_module(found[name])
    try:
        if ours.json is not None:
            must_be_writable("--json", ours.json)
        chosen = [*module.SMOKE, *rest] if ours.smoke else rest
        report: BenchReport = module.main(chosen)
        if ours.json is not None:
            report.write(ours.json, name, chosen)
    except ConfigError as problem:
        return _refused(f"{name}: {problem}")
    except KeyboardInterrupt:
        return _refused(f"{name}: stopped; the same command goes on where rows are kept")
    return report.exit_status


def _refused(text: str) -> int:
    print(f"{PROGRAM}: {text}", file=sys.stderr)
    return 2
