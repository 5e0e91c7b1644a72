"""Answers to commands, modes and landed states of two flights by the same client, side by side.

Modes are told by the heartbeat, once a second, so a change counts as the same within a little more than that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from benchmarks.autopilot.autopilot_record import ON_GROUND, AutopilotRecord
from companion.base.autopilot_kind import AutopilotKind

SET_MESSAGE_INTERVAL: Final = 511
HEARTBEAT_S: Final = 1.2
RESULTS: Final = ("accepted", "temporarily rejected", "denied", "unsupported", "failed")
STATES: Final = {0: "?", 1: "on ground", 2: "in air", 3: "take-off", 4: "landing"}
# said in flight, of what a client may wait for
TEXTS: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "ardupilot": ("Arming motors", "Disarming motors"),
    "px4": (),
}


@dataclass(frozen=True)
class Saying:
    """One row of words."""

    name: str
    recorded: str
    ours: str
    holds: bool


def sayings(autopilot_kind: AutopilotKind, recorded: AutopilotRecord, ours: AutopilotRecord) -> list[Saying]:
    """All rows of words."""
    rows = _answers(recorded, ours) + _modes(recorded, ours)
    states = (_states(recorded), _states(ours))
    rows.append(Saying("landed states", *states, holds=states[0] == states[1]))
    for text in TEXTS[autopilot_kind]:
        theirs, our = (_says(record, text) for record in (recorded, ours))
        rows.append(Saying(f'text "{text}"', theirs, our, holds=theirs == our))
    return rows


def _answers(recorded: AutopilotRecord, ours: AutopilotRecord) -> list[Saying]:
    """What became of each command; requests for streams in one row, told apart by their answers."""
    rows, streams = [], [0, 0]
    for index, (theirs, our) in enumerate(zip(_acks(recorded), _acks(ours), strict=False)):
        if theirs[0] == SET_MESSAGE_INTERVAL:
            streams[0] += 1
            streams[1] += theirs == our
            continue
        words = tuple(RESULTS[result] for _, result in (theirs, our))
        name = f"answer {index + 1}, to command {theirs[0]}"
        rows.append(Saying(name, words[0], words[1], holds=theirs == our))
    same = f"{streams[1]} the same"
    return [Saying("answers to stream requests", f"{streams[0]}", same, streams[0] == streams[1]), *rows]


def _acks(record: AutopilotRecord) -> list[tuple[int, int]]:
    """The answers in order; one given twice in a row (PX4 does) counts once for each command sent."""
    asked = [s for s in record.sent if s.message.get_type() == "COMMAND_LONG"]
    answers: list[tuple[int, int]] = []
    for i, sent in enumerate(asked):
        until = asked[i + 1].time_s + 0.02 if i + 1 < len(asked) else sent.time_s + 2.0
        heard = [s.what for s in record.heard("ack", sent.time_s, until) if s.what[0] == sent.message.command]
        answers.append(heard[0] if heard else (sent.message.command, 4))
    return answers


def _modes(recorded: AutopilotRecord, ours: AutopilotRecord) -> list[Saying]:
    end_s = _disarmed_s(recorded)
    theirs, our = _mode_changes(recorded, end_s), _mode_changes(ours, end_s + HEARTBEAT_S)
    rows = []
    for index, (time_s, mode) in enumerate(theirs):
        match = our[index] if index < len(our) else None
        said = "-" if match is None else f"{match[1]:#x} at {match[0]:.1f} s"
        same = match is not None and match[1] == mode and abs(match[0] - time_s) <= HEARTBEAT_S
        rows.append(Saying(f"mode change {index + 1}", f"{mode:#x} at {time_s:.1f} s", said, same))
    return rows


def _client_s(record: AutopilotRecord) -> float:
    """When the client began to stream setpoints."""
    return next(s.time_s for s in record.sent if s.message.get_type() == "SET_POSITION_TARGET_LOCAL_NED")


def _disarmed_s(record: AutopilotRecord) -> float:
    """When the motors had stopped after the flight, as told by the heartbeat."""
    stopped = [s.time_s for s in record.heard("armed", _client_s(record) + 60.0) if not s.what]
    return stopped[0] if stopped else float(record.motion[-1, 0])


def _mode_changes(record: AutopilotRecord, end_s: float) -> list[tuple[float, Any]]:
    """After the client's first setpoints, before the end."""
    return [(s.time_s, s.what) for s in record.heard("mode", _client_s(record) + 5.0, end_s)]


def _says(record: AutopilotRecord, text: str) -> str:
    return "said" if text in {said.what for said in record.heard("text")} else "not said"


def _states(record: AutopilotRecord) -> str:
    states: list[int] = []
    for said in record.heard("landed"):
        if (not states or states[-1] != said.what) and said.what:
            states.append(said.what)
    first = next((i for i, state in enumerate(states) if state == ON_GROUND), 0)
    return ", ".join(STATES[state] for state in states[first:])
