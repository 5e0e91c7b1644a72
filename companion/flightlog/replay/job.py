"""A replay: a log in, a table, `replay.json` and a page out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import Progress

from companion.base.command_line import say
from companion.base.files import cannot_read, make_folder, write_atomically
from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError
from companion.flightlog.log_file import MAGIC, log_file, log_name
from companion.flightlog.replay.compare import ReplayResult, build_result
from companion.flightlog.replay.dataflash import read_dataflash
from companion.flightlog.replay.flight_record import FlightRecord
from companion.flightlog.replay.mcap_log import read_mcap
from companion.flightlog.replay.plausible import shortcomings, why_unaligned
from companion.flightlog.replay.plots import replay_lines, replay_table, write_page
from companion.flightlog.replay.run import Replayed, replay
from companion.flightlog.replay.settings import Choice, choose
from companion.flightlog.replay.ulog import read_ulog
from companion.flightlog.version import versions

RESULT_NAME: Final = "replay.json"
PAGE_NAME: Final = "replay.html"
# by a log's first bytes, whatever it is called
READERS: Final[dict[bytes, Callable[[Path], FlightRecord]]] = {
    MAGIC: read_mcap,
    b"\xa3\x95": read_dataflash,
    b"ULog\x01\x12\x35": read_ulog,
}
EXPECTED: Final = "a flight's folder, a flight.mcap, an ArduPilot .bin or a PX4 .ulg"


def replay_and_show(log: Path, output: Path | None, config: Path | None) -> None:
    console = Console()
    record = read_log(log)
    choice = choose(record, config)
    folder = make_folder("--output", output or Path("replay") / log_name(log))
    with _progress(console, str(log)) as report:
        replayed = replay(record.events, choice.rig, report)
    result = _result(log, record, replayed, choice)
    console.print(replay_table(result))  # first: the disk may be full
    say(console, *replay_lines(result))
    write_atomically(folder / RESULT_NAME, result.model_dump_json(indent=2) + "\n")
    write_page(folder / PAGE_NAME, result, record, replayed)
    say(console, f"{RESULT_NAME} and {PAGE_NAME} in {folder}")


def read_log(path: Path) -> FlightRecord:
    """Read a log of ours, of ArduPilot's or of PX4's."""
    path = log_file(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(max(map(len, READERS)))
        reader = next((read for magic, read in READERS.items() if start.startswith(magic)), None)
        if reader is None:
            raise ConfigError(f"{path}: not a flight log; expected {EXPECTED}")
        record = reader(path)
    except OSError as error:
        raise cannot_read(path, error, expected=EXPECTED) from error
    cut = f" ({record.cut})" if record.cut else ""
    for kind, name in ((ImuSample, "IMU"), (MagSample, "magnetometer")):
        if not any(isinstance(event.item, kind) for event in record.events):
            raise ConfigError(f"{path}: no {name} samples in the log{cut}; the estimators need both")
    return record


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


@contextmanager
def _progress(console: Console, title: str) -> Iterator[Callable[[float], None]]:
    """A bar on a terminal, nothing elsewhere; yields what takes the share that is done."""
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda share: bar.update(task, completed=share)
