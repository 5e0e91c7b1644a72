"""The interface to the parent process: JSON lines on standard output, one command on standard input."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Coroutine, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from pydantic import TypeAdapter

from companion.base.messages import ContactResult, Outcome, Phase, Truth
from companion.base.signals import STOPPING
from companion.config import ConfigError

if TYPE_CHECKING:
    from sitl.pad.motion import PadTruth
    from sitl.world.score import TouchdownDetector, Verdict

REPORT_NAME: Final = "report.json"
SENSOR_BAUD: Final = 9600  # of the lines that an app in another process opens


@dataclass(frozen=True, slots=True)
class SimulationReport:
    """How a flight ended by the truth, and the truth itself.

    `latest_tick_s` is how far the simulation fell behind the clock at worst: 0 in virtual time.
    `nearest_obstacle_m` is the least distance from the rotors' tips to an obstacle, None without any.
    `touchdown_pad_m` is where on the pad it came down: along the pad's heading and to its right. `contacts`
    have the truth's times; `as_built` is what was built against what was believed, None where all was
    believed rightly.
    """

    outcome: Outcome
    failures: tuple[str, ...]
    touchdown: dict[str, float] | None
    pad_speed_m_s: float
    duration_s: float
    latest_tick_s: float
    truth: tuple[Truth, ...]
    nearest_obstacle_m: float | None = None
    touchdown_pad_m: tuple[float, float] | None = None
    contacts: tuple[ContactResult, ...] = ()
    as_built: dict[str, float | list[float]] | None = None


def report_of(
    verdict: Verdict,
    watch: TouchdownDetector,
    pad: PadTruth,
    *,
    duration_s: float,
    latest_tick_s: float,
    truth: Iterable[Truth],
) -> SimulationReport:
    """A flight as it was judged; without a touchdown the pad's speed is that of `pad`, as it is now."""
    touchdown = watch.touchdown
    pad_speed_m_s = (
        float(np.linalg.norm(pad.velocity_ned_m_s)) if touchdown is None else touchdown.pad_speed_m_s
    )
    return SimulationReport(
        outcome=verdict.outcome,
        failures=verdict.failures,
        touchdown=verdict.touchdown,
        pad_speed_m_s=pad_speed_m_s,
        duration_s=duration_s,
        latest_tick_s=latest_tick_s,
        truth=tuple(truth),
        nearest_obstacle_m=watch.nearest_obstacle_m,
        contacts=verdict.contacts,
    )


def write_report(report: SimulationReport, path: Path) -> None:
    path.write_bytes(TypeAdapter(SimulationReport).dump_json(report))


def read_report(path: Path) -> SimulationReport:
    """Read what `write_report` wrote.

    Raises:
        OSError: the file cannot be read.
        pydantic.ValidationError: it is something else.
    """
    return TypeAdapter(SimulationReport).validate_json(path.read_bytes())


class FlightRun(Protocol):
    """A simulation that runs until it is cancelled, and judges the flight as it stands."""

    async def run(self) -> None: ...

    def report(self, final_phase: Phase) -> SimulationReport:
        """Judge; `final_phase` is the app's last."""
        ...


async def run_until_finished(
    simulation: FlightRun, report_path: Path, ending: Coroutine[Any, Any, Phase | None]
) -> None:
    """Run a simulation until `ending` returns; with a phase the flight is judged, and the report's path
    printed.

    Raises:
        Exception: whatever ended the simulation before.
    """
    flying = asyncio.create_task(simulation.run())
    listening = asyncio.create_task(ending)
    await asyncio.wait([flying, listening], return_when=asyncio.FIRST_COMPLETED)
    if flying.done():
        listening.cancel()
        flying.result()
    phase = listening.result()
    flying.cancel()
    await asyncio.wait([flying])
    if phase is not None:
        write_report(simulation.report(phase), report_path)
        print_json({"report": str(report_path)})


async def final_phase() -> Phase | None:
    """Wait for `finish PHASE` on standard input; None when it ends without."""
    loop = asyncio.get_running_loop()
    said: asyncio.Future[str] = loop.create_future()

    def settle(line: str) -> None:
        if not said.done():
            said.set_result(line)

    def listen() -> None:
        # a thread, since a loop cannot watch a standard input that is a file or /dev/null; unbuffered, since
        # a buffer's lock that a waiting thread holds breaks the end of the interpreter
        line = b""
        while b"\n" not in line and (data := os.read(sys.stdin.fileno(), 100)):
            line += data
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(settle, line.decode(errors="replace"))

    threading.Thread(target=listen, name="standard input", daemon=True).start()
    word, _, phase = (await said).strip().partition(" ")
    return Phase(phase) if word == "finish" and phase in set(Phase) else None


def print_json(message: dict[str, Any]) -> None:
    print(json.dumps(message), flush=True)


@contextlib.contextmanager
def socket_folder(wanted: Path | None) -> Iterator[Path]:
    """A folder for the sockets: the given one, or a temporary one that is removed at the end.

    Raises:
        ConfigError: the wanted one is none, or cannot be written to.
    """
    with contextlib.ExitStack() as stack:
        place = wanted or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="companion-sitl-")))
        if not os.access(place, os.W_OK) or not place.is_dir():
            raise ConfigError(f"--folder {place}: expected a folder that can be written to")
        yield place


@contextlib.contextmanager
def interrupted_at_once() -> Iterator[None]:
    """While inside, a signal interrupts code that blocks the loop, for which asyncio would wait."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    own = {number: handler for number in STOPPING if callable(handler := signal.getsignal(number))}
    for number in own:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in own.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """While inside, SIGTERM and SIGHUP end a program as cleanly as Ctrl-C does; what is ignored stays so."""
    numbers = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, signal.default_int_handler) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
