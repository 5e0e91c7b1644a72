"""A replay: a log in, a table, `replay.json` and a page out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import Progress

from companion.base.files import make_folder, write_atomically
from companion.config import ConfigError
from companion.flightlog.log_file import LOG_NAMES, log_file
from companion.flightlog.replay.compare import ReplayResult, build_result
from companion.flightlog.replay.flight_record import FlightRecord
from companion.flightlog.replay.plausible import shortcomings, why_unaligned
from companion.flightlog.replay.plots import replay_lines, replay_table, write_page
from companion.flightlog.replay.reading import read_log
from companion.flightlog.replay.run import Replayed, replay
from companion.flightlog.replay.settings import Choice, choose
from companion.flightlog.version import versions

RESULT_NAME: Final = "replay.json"
PAGE_NAME: Final = "replay.html"


def replay_and_show(log: Path, output: Path | None, config: Path | None) -> None:
    """Read, replay, compare and show.

    Raises:
        ConfigError: something the user can correct.
    """
    console = Console()
    record = read_log(log)
    choice = choose(record, config)
    folder = make_folder("--output", output or Path("replay") / log_name(log))
    with _progress(console, str(log)) as report:
        replayed = replay(record.events, choice.rig, report)
    result = _result(log, record, replayed, choice)
    console.print(replay_table(result))  # first: the disk may be full
    for line in replay_lines(result):
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    write_atomically(folder / RESULT_NAME, result.model_dump_json(indent=2) + "\n")
    write_page(folder / PAGE_NAME, result, record, replayed)
    console.print(f"{RESULT_NAME} and {PAGE_NAME} in {folder}", highlight=False, soft_wrap=True, markup=False)


def _result(log: Path, record: FlightRecord, replayed: Replayed, choice: Choice) -> ReplayResult:
    if not replayed.vehicles:
        why = why_unaligned(record.events, choice.rig.config.estimate.alignment)
        raise ConfigError(f"{log}: the estimators never aligned: {why}")
    record.notes += shortcomings(record.events)
    if record.kind == "companion" and record.rig is None:
        record.notes.append(f"the log holds no settings (an older version's): replayed under {choice.name}")
    result = build_result(
        record, replayed, log=str(log), settings=choice.name, field=choice.field, repeats=choice.repeats
    )
    if result.repetition is not None and not result.repetition.identical:
        other = {name: old for name, old in record.versions.items() if versions().get(name) != old}
        if other:
            flown = ", ".join(f"{name} {version}" for name, version in other.items())
            return result.model_copy(update={"notes": (*result.notes, f"it was flown with {flown}")})
    return result


def log_name(log: Path) -> str:
    """What to call a log: its file's name, or its folder's where all files are called alike."""
    file = log_file(log.resolve())
    return file.parent.name if file.name == LOG_NAMES[0] else file.stem


@contextmanager
def _progress(console: Console, title: str) -> Iterator[Callable[[float], None]]:
    """A bar on a terminal, nothing elsewhere; yields what takes the share that is done."""
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda share: bar.update(task, completed=share)
