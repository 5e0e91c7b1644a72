"""Writes docs/results/measured.md from the benchmarks' JSON: no figure without commit, machine and date.

    python -m benchmarks mpc --json mpc.json
    python -m docs.results [mpc.json ...]

Each FILE replaces its benchmark's in docs/results/measured/. One that was measured on files that differ from
their commit is refused: nobody could measure it again.
"""

import json
import shutil
import sys
from pathlib import Path
from typing import Any, Final

RESULTS: Final = Path(__file__).resolve().parent / "results"
KEPT: Final = RESULTS / "measured"
PAGE: Final = RESULTS / "measured.md"
INTRODUCTION: Final = """\
# Measured

Written by `python -m docs.results` from the JSON that `python -m benchmarks` leaves with `--json`. Each
benchmark has its commit, day and machine, and the command that repeats it. **Bold** is a bar that fails.
"""


def refusal(result: dict[str, Any]) -> str | None:
    """Why a result cannot be shown; None: it can."""
    commit = result.get("commit") or ""
    if commit.endswith("+"):
        return f"commit {commit}: files differed from it; expected a clean checkout"
    missing = [key for key in ("benchmark", "commit", "machine", "date") if not result.get(key)]
    return f"no {', '.join(missing)}; expected the JSON of a benchmark" if missing else None


def page_text() -> str:
    """The whole page, a section for each benchmark."""
    results = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(KEPT.glob("*.json"))]
    return INTRODUCTION + "".join(map(_section, results))


def _section(result: dict[str, Any]) -> str:
    name, machine = result["benchmark"], result["machine"]
    command = " ".join(("python -m benchmarks", name, *result["arguments"]))
    parts = [
        f"## {name}",
        f"{result['commit'][:8]}, {result['date'][:10]}, {machine['cores']} cores of {machine['cpu']}, "
        f"Python {machine['python']}: `{command}` ([JSON](measured/{name}.json)).",
    ]
    parts += [_table(table) for table in result["tables"] if table["rows"]]
    bars = [bar["text"] if bar["holds"] else f"**{bar['text']}**" for bar in result["bars"]]
    parts += [f"Bars: {'; '.join(bars)}."] if bars else []
    return "".join(f"\n{part}\n" for part in parts)


def _table(table: dict[str, Any]) -> str:
    headings = list(table["rows"][0])
    rows = [headings, ["---"] * len(headings), *([row[key] for key in headings] for row in table["rows"])]
    lines = [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in rows]
    return "\n".join([f"{table['title']}:\n"] * bool(table["title"]) + lines)


def main(words: list[str]) -> int:
    """Take the files in and write the page; returns the exit status."""
    for path in map(Path, words):
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
            why = refusal(result)
        except (OSError, ValueError, AttributeError) as error:
            why = f"cannot be read: {error}"
        if why is not None:
            print(f"docs.results: {path}: {why}", file=sys.stderr)
            return 2
        if path.parent.resolve() != KEPT:
            shutil.copyfile(path, KEPT / f"{result['benchmark']}.json")
    PAGE.write_text(page_text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
