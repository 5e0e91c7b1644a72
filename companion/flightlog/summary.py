"""One line about a recorded flight: when, how it ended, how far beside the pad, how long.

Read from the log's index and its last chunks, so that a hundred flights are listed in a moment; a log that
was cut short has no index and is read through.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

from mcap.reader import make_reader

from companion.base.message_json import decode
from companion.base.messages import Outcome, PadState, Phase
from companion.flightlog.flights import size_bytes
from companion.flightlog.log_file import DAMAGE, LOG_NAMES, LogReader

ENDINGS: Final = {Phase.LANDED: Outcome.LANDED.value, Phase.ABORT: Outcome.ABORTED.value}
TOPICS: Final = ("plan", "pad")
# an earlier date is that of a clock that was never set
EARLIEST_UNIX_S: Final = 1_704_067_200.0  # 2024-01-01


@dataclass(frozen=True, slots=True)
class FlightSummary:
    """What `companion logs` lists; `start_unix_s` is None where the clock was not set or nothing was logged.

    `lateral_m` is the horizontal distance from the pad's centre: at the landing by the simulator's truth,
    else (`estimated`) at the end of a landing by the pad filter; None without either.
    """

    start_unix_s: float | None
    seconds: float
    outcome: str
    lateral_m: float | None
    estimated: bool
    size_bytes: int
    cut: bool


@dataclass(slots=True)
class _Read:
    """From a log: the times of its first and last message, and the last ones of the two topics."""

    first_ns: int | None = None
    last_ns: int = 0
    last: dict[str, dict[str, Any]] = field(default_factory=dict)
    cut: bool = False


def ending(phase: str) -> str:
    """How a flight without a verdict by truth ended, by the last phase of the mission."""
    last = Phase(phase)
    return ENDINGS.get(last, f"ended in {last.value.replace('_', ' ')}")


def summary_of(folder: Path) -> FlightSummary:
    """Summarise a flight's folder.

    Raises:
        OSError: its log cannot be read.
    """
    with (folder / LOG_NAMES[0]).open("rb") as stream:
        read = _by_index(stream)
    read = read or _through(folder)
    last = read.last
    outcome, lateral_m = _verdict(folder / "result.json")
    estimated = outcome is None
    if outcome is None:
        outcome = ending(last["plan"]["phase"]) if "plan" in last else "nothing flown"
        if outcome == Outcome.LANDED.value and "pad" in last:
            lateral_m = decode(PadState, last["pad"]).lateral_m
    first_s = 0.0 if read.first_ns is None else 1e-9 * read.first_ns
    return FlightSummary(
        start_unix_s=first_s if first_s > EARLIEST_UNIX_S else None,
        seconds=0.0 if read.first_ns is None else 1e-9 * (read.last_ns - read.first_ns),
        outcome=outcome,
        lateral_m=lateral_m,
        estimated=estimated,
        size_bytes=size_bytes(folder),
        cut=read.cut,
    )


def _verdict(path: Path) -> tuple[str | None, float | None]:
    """Outcome and lateral error at the landing of a flight in the simulator; None without a result."""
    try:
        result = json.loads(path.read_bytes())
        touchdown = result["touchdown"]
        return str(result["outcome"]), None if touchdown is None else float(touchdown["lateral_error_m"])
    except (OSError, ValueError, KeyError, TypeError):
        return None, None


def _by_index(stream: IO[bytes]) -> _Read | None:
    """None for a log without an index."""
    try:
        reader = make_reader(stream)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        counts = summary.statistics.channel_message_counts
        there = {c.topic[1:] for c in summary.channels.values() if c.topic[1:] in TOPICS and counts.get(c.id)}
        newest = {topic: next(reader.iter_messages([f"/{topic}"], reverse=True)) for topic in sorted(there)}
        last = {topic: json.loads(message.data) for topic, (_, _, message) in newest.items()}
        statistics = summary.statistics
        first_ns = statistics.message_start_time if statistics.message_count else None
        return _Read(first_ns, statistics.message_end_time, last)
    except DAMAGE:
        return None


def _through(folder: Path) -> _Read:
    reader, read, last = LogReader(folder), _Read(), dict[str, bytes]()
    for topic, message in reader.messages():
        read.first_ns = message.log_time if read.first_ns is None else read.first_ns
        read.last_ns = max(read.last_ns, message.log_time)
        if topic in TOPICS:
            last[topic] = message.data
    read.cut, read.last = reader.cut, {topic: json.loads(data) for topic, data in last.items()}
    return read
