"""The live page's budget: from exposure to pixel, CPU with one viewer, and what three do to the control loop.

    python -m benchmarks page

Landings in real time, `companion --sitl --serve`, with no viewer, one, three, and one in headless Chromium.
The others are this process: they take what comes and say what a browser says. CPU is that of the processes as
the kernel counts it, in the air. From exposure to pixel is what the page itself measures, by the exposure's
stamp and the machine's clock when the frame that shows it has begun. Prints the figures beside the bars, and
ends in one line that says which hold; the exit status matches.
"""

import argparse
import asyncio
import json
import math
import os
import struct
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import aiohttp
from mcap.reader import make_reader

from benchmarks.report import BenchReport
from sitl.campaign.tables import Bar, at_most
from tests.beside import beside
from tests.browser import PHONE, Tab, browser, program
from tests.scenario.flying import COMMAND, ROOT, environment

SMOKE: Final = ("--part", "load")
NEEDS: Final = "the machine to itself"
PIXEL_MS: Final = 200.0
VIEWER_PERCENT: Final = 10.0
IDLE_PERCENT: Final = 0.5
LATE_S: Final = 0.5 / 30.0  # as the app's own loop monitor counts them
MANY: Final = 3
WAIT_S: Final = 90.0
TRIES: Final = 3


class FlightSpoiltError(RuntimeError):
    """It did not land."""


@dataclass
class PageFlight:
    """What one landing cost, in the air."""

    viewers: str
    app_percent: float = math.nan
    page_percent: float = math.nan
    cycles: int = 0
    late: int = 0
    pictures: int = 0
    latencies_ms: list[float] = field(default_factory=list)

    def __str__(self) -> str:
        late = f"{self.late} of {self.cycles} cycles late"
        cpu = f"app {self.app_percent:.1f} %, page {self.page_percent:.1f} % of a core"
        return f"viewers: {self.viewers}: {cpu}, {late}, {self.pictures} pictures"


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="static")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=1, help="landings with each number of viewers")
    parser.add_argument("--part", choices=("load", "pixel"), help="only CPU and cycles, or only the delay")
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    return report.judge(asyncio.run(_bench(chosen, report)))


async def _bench(chosen: argparse.Namespace, report: BenchReport) -> list[Bar]:
    bars: list[Bar] = []
    if chosen.part != "pixel":
        bars += await _load_bars(chosen, report)
    if chosen.part != "load":
        bars += await _pixel_bars(chosen, report)
    return bars


async def _load_bars(chosen: argparse.Namespace, report: BenchReport) -> list[Bar]:
    flown: dict[int, list[PageFlight]] = {0: [], MANY: [], 1: []}
    for number in range(chosen.rounds):
        for viewers, flights in flown.items():
            flights.append(await _fly(chosen.scenario, chosen.seed + number, viewers))
            report.show(flights[-1])
    return [
        at_most("CPU of the page while nobody looks", _mean(flown[0], "page_percent"), IDLE_PERCENT, "%"),
        at_most("CPU for one viewer", _viewer_percent(flown), VIEWER_PERCENT, "% of a core"),
        _late_bar(flown[0], flown[MANY]),
    ]


async def _pixel_bars(chosen: argparse.Namespace, report: BenchReport) -> list[Bar]:
    ordered: list[float] = []
    if program() is None:
        report.show("Chromium is not installed; expected it for the delay to the pixel")
    else:
        looked = await _fly(chosen.scenario, chosen.seed, None)
        report.show(looked)
        ordered = sorted(looked.latencies_ms)
    return [
        at_most(
            f"from exposure to pixel, {name}",
            ordered[round(share * (len(ordered) - 1))] if ordered else math.nan,
            PIXEL_MS,
            "ms",
        )
        for name, share in (("p50", 0.5), ("p99", 0.99))
    ]


def _mean(flights: list[PageFlight], name: str) -> float:
    return float(sum(getattr(flight, name) for flight in flights) / len(flights))


def _viewer_percent(flown: dict[int, list[PageFlight]]) -> float:
    """What the page's process takes, and what the app's takes more than without a viewer, if it does."""
    more = _mean(flown[1], "app_percent") - _mean(flown[0], "app_percent")
    return _mean(flown[1], "page_percent") + max(0.0, more)


def _late_bar(without: list[PageFlight], many: list[PageFlight]) -> Bar:
    """Late cycles, no more than without viewers within two standard deviations of such counts."""
    few, lot = sum(f.late for f in without), sum(f.late for f in many)
    most = few + 2.0 * math.sqrt(few + lot)
    return at_most(f"late cycles with {MANY} viewers (without: {few})", lot, most)


# ---------------------------------------------------------------- one landing


async def _fly(scenario: str, seed: int, viewers: int | None) -> PageFlight:
    """A landing with so many viewers (None: one in Chromium); one that the machine spoilt is flown again."""
    for _ in range(TRIES - 1):
        with suppress(FlightSpoiltError):
            return await _try(scenario, seed, viewers)
    return await _try(scenario, seed, viewers)


async def _try(scenario: str, seed: int, viewers: int | None) -> PageFlight:
    flight = PageFlight("Chromium" if viewers is None else str(viewers))
    with tempfile.TemporaryDirectory(prefix="page-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        async with (
            _flying(scenario, seed, folder) as (process, url),
            _looking(flight, folder, url, viewers),
        ):
            await _measure(process, flight)
        _count_cycles(folder / "flight" / "flight.mcap", flight)
    return flight


@asynccontextmanager
async def _flying(
    scenario: str, seed: int, folder: Path
) -> AsyncIterator[tuple[asyncio.subprocess.Process, str]]:
    process = await asyncio.create_subprocess_exec(
        *COMMAND,
        *("--sitl", "--no-ui", "--scenario", scenario, "--seed", str(seed), "--serve", "127.0.0.1:0"),
        *("--record", str(folder / "flight")),
        cwd=ROOT,
        env=environment() | {"PYTHONUNBUFFERED": "1"},
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        yield process, (await _line(process, "live page at ")).rpartition(" ")[2]
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def _line(process: asyncio.subprocess.Process, words: str) -> str:
    """The next line of its standard output that holds these words."""
    assert process.stdout is not None
    async with asyncio.timeout(WAIT_S):
        while line := (await process.stdout.readline()).decode():
            if words in line:
                return line.strip()
    raise FlightSpoiltError(f"the flight ended before '{words}'")


async def _measure(process: asyncio.subprocess.Process, flight: PageFlight) -> None:
    """CPU of the app and of its page from the take-off to the end of the landing."""
    await _line(process, "airborne")
    page = _page_of(process.pid)
    loop = asyncio.get_running_loop()
    began_s, app_s, page_s = loop.time(), _cpu_s(process.pid), _cpu_s(page)
    await _line(process, "landed: ")
    flown_s = loop.time() - began_s
    flight.app_percent = 100.0 * (_cpu_s(process.pid) - app_s) / flown_s
    flight.page_percent = 100.0 * (_cpu_s(page) - page_s) / flown_s
    assert process.stdout is not None
    await process.stdout.read()
    await process.wait()


def _page_of(pid: int) -> int:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return next(int(c) for c in children if b"companion.app.page" in Path(f"/proc/{c}/cmdline").read_bytes())


def _cpu_s(pid: int) -> float:
    cells = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(int(cell) for cell in cells[11:13]) / float(os.sysconf("SC_CLK_TCK"))


def _count_cycles(path: Path, flight: PageFlight) -> None:
    with path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/control_report"]):
            flight.cycles += 1
            flight.late += json.loads(message.data)["cycle_late_s"] > LATE_S


# ---------------------------------------------------------------- viewers


@asynccontextmanager
async def _looking(flight: PageFlight, folder: Path, url: str, viewers: int | None) -> AsyncIterator[None]:
    if viewers is None:
        async with browser(folder) as tab:
            await tab.resize(PHONE, 2.0)
            await tab.open(url)
            async with beside(_read(flight, tab)):
                yield
        return
    async with (
        aiohttp.ClientSession() as session,
        beside(*(_view(flight, session, url) for _ in range(viewers))),
    ):
        yield


async def _view(flight: PageFlight, session: aiohttp.ClientSession, url: str) -> None:
    async with session.ws_connect(f"{url}live", headers={"Origin": url.rstrip("/")}) as socket:
        async for message in socket:
            if message.type is aiohttp.WSMsgType.BINARY:
                (length,) = struct.unpack_from(">I", message.data)
                await socket.send_json({"drawn": json.loads(message.data[4 : 4 + length])["number"]})
                flight.pictures += 1


async def _read(flight: PageFlight, tab: Tab) -> None:
    """What the page has measured so far; the newest before it ends is all of it."""
    with suppress(OSError, RuntimeError, TimeoutError, KeyError):
        while True:
            await asyncio.sleep(1.0)
            flight.latencies_ms = await tab.evaluate("window.companion ? window.companion.latenciesMs : []")
            flight.pictures = len(flight.latencies_ms)
