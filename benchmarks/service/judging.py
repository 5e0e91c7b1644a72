"""What is unsafe of an interrupted flight, by what passed on the line and what is in the log. Pure.

Times are seconds, monotonic, as the witness has them. Each judge returns what it found wrong, in words.
"""

from __future__ import annotations

import random
import select
import socket
import sys
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Literal, get_args

from mcap.records import Message
from mcap.stream_reader import StreamReader

from companion.link.codec import Codec, command_long, mavlink

# what was in flight on the line, and what the kernel still held
GRACE_S: Final = 0.3
# PX4 leaves OFFBOARD after COM_OF_LOSS_T (1 s) without setpoints, and its heartbeat comes once a second
FAILSAFE_S: Final = 3.5
HEARTBEAT_S: Final = 1.5
MISSING_S: Final = 1.0
ENDS_WITHIN_S: Final = 30.0  # TimeoutStopSec of the unit: then systemd kills it
HANDS_BACK: Final = frozenset({mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_NAV_LAND})
STOPPED_IN_STANDBY, STOPPED_IN_FLIGHT = 0, 4


def ours(beat: Beat) -> bool:
    """Whether setpoints fly the vehicle."""
    return beat.armed and beat.mode == OFFBOARD


def left_after_s(seen: SeenTraffic, since_s: float) -> float | None:
    """How long after a moment the autopilot had left OFFBOARD, or disarmed; None: never."""
    later = (beat.time_s for beat in seen.beats if beat.time_s > since_s and not ours(beat))
    return next((time_s - since_s for time_s in later), None)


def killed(seen: SeenTraffic, killed_s: float) -> list[str]:
    """kill -9 and the start after it: nothing is ordered any more, and the autopilot helps itself."""
    return _nothing_after(seen, killed_s + GRACE_S) + _failsafe(seen, killed_s) + _armed_after(seen, killed_s)


def stopped(seen: SeenTraffic, stopped_s: float, resumed_s: float) -> list[str]:
    """SIGSTOP, and SIGCONT: silence, the failsafe, and nothing against the mode that it chose."""
    late = [at_s for at_s in seen.setpoints if stopped_s + GRACE_S < at_s < resumed_s]
    found = [f"{len(late)} setpoints while it was stopped"] if late else []
    found += _failsafe(seen, stopped_s)
    # control may have been granted just before, which its next heartbeat shows
    flew = [seen.at(stopped_s), *(beat for beat in seen.beats if stopped_s < beat.time_s <= resumed_s)]
    if any(map(ours, flew)) and not ours(flew[-1]):
        found += _nothing_after(seen, resumed_s) + _armed_after(seen, resumed_s)
    return found


def terminated(seen: SeenTraffic, asked_s: float, ended_s: float, code: int, *, standby: bool) -> list[str]:
    """SIGTERM: it hands back, ends in time with the right code, and nothing comes after it."""
    took_s = ended_s - asked_s
    found = [] if took_s <= ENDS_WITHIN_S else [f"ended after {took_s:.0f} s"]
    if code not in ((STOPPED_IN_STANDBY,) if standby else (STOPPED_IN_STANDBY, STOPPED_IN_FLIGHT)):
        found.append(f"ended with {code}")
    if not standby:
        found += _handed_back(seen, asked_s, ended_s)
    return found + _nothing_after(seen, ended_s) + _failsafe(seen, ended_s) + _armed_after(seen, ended_s)


def log_missing(folder: Path, ordered_unix_s: float, killed_unix_s: float) -> list[str]:
    """Whether a killed flight's log in `folder` reads back whole up to a second before the kill.

    The flight begins with its order: what was to be logged of the minute before is not counted.
    """
    logs = sorted(folder.glob("flight-*/flight.mcap"))
    stamps = sorted(
        stamp for path in logs for stamp in _stamps_s(path) if ordered_unix_s < stamp < killed_unix_s
    )
    missing_s = max(b - a for a, b in pairwise((ordered_unix_s, *stamps, killed_unix_s)))
    if missing_s <= MISSING_S:
        return []
    return [f"log misses {missing_s:.1f} s" if logs else f"no log of {missing_s:.1f} s"]


def _stamps_s(path: Path) -> list[float]:
    """The stamps (s since 1970) that a log reads back with; the last record may be cut."""
    stamps: list[float] = []
    try:
        with path.open("rb") as stream:
            found = (record for record in StreamReader(stream).records if isinstance(record, Message))
            stamps.extend(1e-9 * message.log_time for message in found)
    except Exception as error:
        # whatever the reader makes of a cut record; what came before it is read
        if not stamps:
            print(f"{path}: {type(error).__name__}: {error}", file=sys.stderr)
    return stamps


def _handed_back(seen: SeenTraffic, asked_s: float, ended_s: float) -> list[str]:
    """An armed vehicle is told its mode, and stays in it: setpoints that merely stop are no handing back."""
    settled_s = ended_s + HEARTBEAT_S
    if not seen.at(settled_s).armed:
        return []
    asked = [c for c in seen.commands if c.number in HANDS_BACK and asked_s < c.time_s <= ended_s]
    found = [] if asked else ["control was not handed back"]
    later = {beat.mode for beat in seen.beats if beat.armed and beat.time_s > settled_s}
    return found + (["the mode changed after the end"] if later - {seen.at(settled_s).mode} else [])


def _nothing_after(seen: SeenTraffic, after_s: float) -> list[str]:
    """What was ordered after a moment after which nothing may be."""
    late = sum(at_s > after_s for at_s in seen.setpoints)
    commands = sorted({command.number for command in seen.commands if command.time_s > after_s})
    found = [f"{late} setpoints"] if late else []
    return found + ([f"commands {_listed(commands)}"] if commands else [])


def _failsafe(seen: SeenTraffic, since_s: float) -> list[str]:
    """Setpoints that stop leave the vehicle to the autopilot's failsafe."""
    if not any(beat.time_s > since_s for beat in seen.beats):
        return ["nothing heard of the vehicle any more"]
    return ["the autopilot's failsafe did not act"] if ours(seen.at(since_s + FAILSAFE_S)) else []


def _armed_after(seen: SeenTraffic, since_s: float) -> list[str]:
    """A vehicle that was or became disarmed stays so; what was asked before may take a heartbeat to show."""
    settled_s = since_s + HEARTBEAT_S
    armed = [seen.at(settled_s).armed, *(beat.armed for beat in seen.beats if beat.time_s > settled_s)]
    return ["armed"] if any(now and not before for before, now in pairwise(armed)) else []


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


# ---------------------------------------------------------------- trials
# The trials: which moment of a flight is interrupted how, and what is kept of one that is done.

Kind = Literal["kill", "stop", "term"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
# Phases of a good flight in their order, and how long (s) each lasts here: a moment is drawn in each in turn,
# else it would be the climb nearly always.
PHASES: Final = {
    "standby": 3.0,
    "connect": 1.0,
    "arm": 1.0,
    "take_off": 6.0,
    "waypoint": 2.0,
    "search": 2.0,
    "approach": 3.0,
    "descend": 5.0,
    "touchdown": 3.0,
    "landed": 1.0,
}
# of the committed vehicle, the last third of a metre, it takes most to be sure
ORDER: Final = ("descend", "standby", "touchdown", "approach", "take_off", "search", "landed", "waypoint",
                "touchdown", "arm", "connect")  # fmt: skip


@dataclass(frozen=True, slots=True)
class InterruptionMoment:
    """When to interrupt: so long (s) after a phase, or a later one, has begun."""

    phase: str
    delay_s: float


def moment(kind: Kind, seed: int) -> InterruptionMoment:
    """The moment of a trial."""
    phase = ORDER[(seed + 3 * KINDS.index(kind)) % len(ORDER)]
    return InterruptionMoment(phase, random.Random(f"{kind} {seed}").uniform(0.0, PHASES[phase]))


def reached(phase: str, wanted: str) -> bool:
    """Whether a flight in `phase` has come to `wanted`, or has passed it over."""
    names = list(PHASES)
    return phase in names and names.index(phase) >= names.index(wanted)


@dataclass(frozen=True, slots=True)
class InterruptedTrial:
    """A trial that is done: what was interrupted, on which state of the code, and what was found unsafe.

    `failsafe_s` is how long the autopilot took to leave OFFBOARD; None where it was not in it.
    """

    kind: Kind
    seed: int
    code: str
    phase: str
    ordered_s: float
    failsafe_s: float | None
    found: tuple[str, ...]


# ---------------------------------------------------------------- witness
# A witness on the line between app and autopilot: what passed and when, and what a ground station says.

ASKING: Final = frozenset({mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE})
OFFBOARD: Final = 6 << 16  # PX4's main mode
POSCTL: Final = 3 << 16
GROUND_STATION: Final = (255, 190)


@dataclass(frozen=True, slots=True)
class Beat:
    """A heartbeat of the autopilot, with the time (s, monotonic) at which it passed."""

    time_s: float
    mode: int
    armed: bool


@dataclass(frozen=True, slots=True)
class AppCommand:
    """A command of the app's to the autopilot."""

    time_s: float
    number: int


@dataclass
class SeenTraffic:
    """What passed: the app's setpoints (s, monotonic) and commands, the autopilot's heartbeats."""

    setpoints: list[float] = field(default_factory=list)
    commands: list[AppCommand] = field(default_factory=list)
    beats: list[Beat] = field(default_factory=list)

    def take(self, message: Any, now_s: float, *, from_app: bool) -> None:
        """Note a message; requests for telemetry order nothing."""
        kind = message.get_type()
        if from_app and kind.startswith("SET_") and "TARGET" in kind:
            self.setpoints.append(now_s)
        elif from_app and kind in {"COMMAND_LONG", "COMMAND_INT"} and message.command not in ASKING:
            self.commands.append(AppCommand(now_s, message.command))
        elif not from_app and kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.beats.append(Beat(now_s, message.custom_mode, armed))

    def at(self, time_s: float) -> Beat:
        """The last heartbeat until then; before the first one, a vehicle that is disarmed."""
        return next((b for b in reversed(self.beats) if b.time_s <= time_s), Beat(time_s, 0, armed=False))


class UdpWitness:
    """A UDP relay between the app, which calls `port`, and the simulated vehicle at `vehicle_port`."""

    def __init__(self, vehicle_port: int, port: int = 0) -> None:
        self.seen = SeenTraffic()
        self._app_side = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._app_side.bind(("127.0.0.1", port))
        self._vehicle_side = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle_side.connect(("127.0.0.1", vehicle_port))
        for side in (self._app_side, self._vehicle_side):
            # what a socket is ready for may be an error, which the other direction's send takes away
            side.setblocking(False)
        self.port: int = self._app_side.getsockname()[1]
        self._pilot = Codec(*GROUND_STATION)
        self._ends = False
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the relay."""
        self._ends = True
        self._thread.join()
        self._app_side.close()
        self._vehicle_side.close()

    def pilot(self, number: int, *parameters: float) -> None:
        """A command of the ground station's to the autopilot."""
        filled = (*parameters, *(0.0,) * (7 - len(parameters)))
        self._vehicle_side.send(self._pilot.encode(command_long(number, filled, 1, 1)))

    def _relay(self) -> None:
        app: tuple[str, int] | None = None
        codecs = {True: Codec(1), False: Codec(1)}
        while not self._ends:
            for ready in select.select([self._app_side, self._vehicle_side], [], [], 0.2)[0]:
                from_app = ready is self._app_side
                with suppress(OSError):
                    if from_app:
                        data, app = self._app_side.recvfrom(65536)
                        self._vehicle_side.send(data)
                    else:
                        data = self._vehicle_side.recv(65536)
                        if app is not None:
                            self._app_side.sendto(data, app)
                    now_s = time.monotonic()
                    for message in codecs[from_app].decode(data):
                        self.seen.take(message, now_s, from_app=from_app)
