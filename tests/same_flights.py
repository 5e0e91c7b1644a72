"""Are the flights of two source trees equal to the bit? For changes that must not change behaviour.

    python -m tests.same_flights BEFORE AFTER [--scenario NAME ...] [--seed 0]

Flies every shipped scenario with the code of each tree in virtual time, with its own settings, and compares
the recorded flights: every number of every message of every topic, and every camera frame. Names and
sentences are not compared, so that they may change. Exit status 0 when all are equal. BEFORE and AFTER are
folders with a checkout; both run in the environment of this interpreter.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from mcap.reader import make_reader

Rows = dict[str, list[tuple[Any, ...]]]

# messages whose stamps are the wall clock's: only the picture itself is compared
WALL_CLOCK_KEYS: Final = ("timestamp",)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--scenario", action="append", help="Only this one; may be given often.")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    names = asked.scenario or sorted(p.stem for p in (asked.before / "configs/scenarios").glob("*.yaml"))
    equal = 0
    for name in names:
        difference = compare(fly(asked.before, name, asked.seed), fly(asked.after, name, asked.seed))
        print(f"{name:>14}: {difference or 'equal'}", flush=True)
        equal += difference is None
    print(f"{equal} of {len(names)} flights are equal")
    return 0 if equal == len(names) else 1


def fly(tree: Path, scenario: str, seed: int) -> Rows:
    """One flight with the code and the settings of `tree`; its messages by topic."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "companion.cli", "--sitl", "--fast", "--no-ui"]
        command += ["--scenario", scenario, "--seed", str(seed), "--record", folder]
        flight = subprocess.run(
            command,
            cwd=tree,
            env={**os.environ, "PYTHONPATH": str(tree.resolve())},
            capture_output=True,
            text=True,
            check=False,
        )
        log = Path(folder) / "flight.mcap"
        if not log.exists():
            raise SystemExit(f"{tree}: {scenario} left no log: {flight.stderr.strip()[-300:]}")
        return read(log)


def read(log: Path) -> Rows:
    """Every number of a log by topic, in the order in which it was recorded."""
    rows: Rows = defaultdict(list)
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            rows[channel.topic].append(tuple(numbers(json.loads(message.data))))
    return dict(rows)


def numbers(value: Any) -> Iterator[Any]:
    """The numbers of a JSON value in order, and the pictures; what names and sentences say is left out."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key == "data":
                yield inner
            elif key not in WALL_CLOCK_KEYS:
                yield from numbers(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from numbers(inner)
    elif not isinstance(value, str):
        yield value


def compare(before: Rows, after: Rows) -> str | None:
    """The first difference in one line, or None. NaN equals NaN, since JSON has it as null."""
    for topic in sorted(before.keys() | after.keys()):
        old, new = before.get(topic, []), after.get(topic, [])
        for index, (a, b) in enumerate(zip(old, new, strict=False)):
            if a != b:
                return f"{topic} differs from message {index} on"
        if len(old) != len(new):
            return f"{topic} has {len(old)} messages before and {len(new)} after"
    return None


if __name__ == "__main__":
    sys.exit(main())
