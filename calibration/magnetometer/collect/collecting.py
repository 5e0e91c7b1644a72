"""Collecting live samples until the sphere is covered, and showing how far that is."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import cv2
import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from calibration.magnetometer.collect.coverage_map import picture, text_map
from calibration.magnetometer.collect.guidance import CoverageProgress, progress
from calibration.magnetometer.collect.live import LiveCompass
from calibration.magnetometer.ellipsoid.coverage import CELLS
from calibration.magnetometer.read.recording import MagnetometerRecording, paired
from companion.base.clock import Clock
from companion.base.files import write_atomically
from companion.base.formats.mjpeg import MjpegServer
from companion.config import ConfigError

ENOUGH: Final = 0.88  # of the sphere: then it stops by itself
LEAST_SAMPLES: Final = 500
_LOOK_S: Final = 0.5
_RECENT: Final = 200  # inertial samples: guidance needs the newest alone
_LINE_S: Final = 3.0


@dataclass(frozen=True, slots=True)
class CollectionLimits:
    """When to stop though it is not covered; where the picture goes; the browser's port (None: none)."""

    time_s: float
    picture: Path | None = None
    port: int | None = None


async def collect(source: LiveCompass, limits: CollectionLimits, console: Console) -> MagnetometerRecording:
    """Collect until the sphere is covered or the time is up.

    Raises:
        ConfigError: no samples come, or the port cannot be had.
    """
    clock = Clock()
    start_s = looked_s = clock.now_s()
    now = CoverageProgress(0, np.zeros(CELLS, dtype=bool), None, "")
    async with _browser(limits.port) as browser:
        with _screen(console) as screen:
            while clock.now_s() - start_s < limits.time_s:
                mags, imus = await source.more()
                if clock.now_s() - looked_s < _LOOK_S:
                    continue
                looked_s = clock.now_s()
                now = progress(*paired(mags, imus[-_RECENT:]), source.body_from_sensor)
                screen.show(now, looked_s - start_s)
                if browser is not None:
                    browser.show(picture(now))
                if now.share >= ENOUGH and now.samples >= LEAST_SAMPLES:
                    break
    if limits.picture is not None and now.samples:
        # samples that took minutes are not given up for a picture
        line = f"coverage in {limits.picture}"
        try:
            write_atomically(limits.picture, cv2.imencode(".png", picture(now))[1].tobytes())
        except ConfigError as error:
            line = str(error)
        console.print(line, highlight=False, markup=False)
    return source.recording()


@asynccontextmanager
async def _browser(port: int | None) -> AsyncIterator[MjpegServer | None]:
    if port is None:
        yield None
        return
    server = MjpegServer()
    try:
        await server.start(port)
    except OSError as error:
        raise ConfigError(f"--serve {port}: {error.strerror}; expected a free port") from error
    try:
        yield server
    finally:
        await server.close()


# ---------------------------------------------------------------- on the terminal


class _Screen(Protocol):
    def show(self, now: CoverageProgress, elapsed_s: float) -> None:
        """Show how far it is."""


class _Lines:
    """For what is no terminal: a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._reported_s = -_LINE_S

    def show(self, now: CoverageProgress, elapsed_s: float) -> None:
        if elapsed_s - self._reported_s >= _LINE_S or now.share >= ENOUGH:
            self._reported_s = elapsed_s
            self._console.print(_line(now, elapsed_s), highlight=False, markup=False)


class _Map:
    """A map that is drawn over and over."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def show(self, now: CoverageProgress, elapsed_s: float) -> None:
        self._live.update(drawn(now, elapsed_s), refresh=True)


def drawn(now: CoverageProgress, elapsed_s: float) -> Group:
    """The map, how far it is, and what to do next on lines of its own: it is the instruction."""
    if not now.samples:
        return Group(Text("no samples yet"))
    lines = [*text_map(now.covered), _progress(now, elapsed_s)]
    return Group(*(Text(line) for line in lines), Text(f"next: {now.hint}", style="bold", overflow="fold"))


@contextmanager
def _screen(console: Console) -> Iterator[_Screen]:
    if not console.is_terminal:
        yield _Lines(console)
        return
    with Live(console=console, auto_refresh=False) as live:
        yield _Map(live)


def _line(now: CoverageProgress, elapsed_s: float) -> str:
    return f"{_progress(now, elapsed_s)}; next: {now.hint}"


def _progress(now: CoverageProgress, elapsed_s: float) -> str:
    return f"{elapsed_s:5.0f} s  {now.share:4.0%} covered, {now.samples} samples"
