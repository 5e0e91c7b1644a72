"""The live page in the app: what it is fed with, and the orders that come from it."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Final

import yaml
from pydantic import BaseModel
from pydantic_core import to_json

from companion.app.app import App, supervised
from companion.app.page.access import Access, read_access
from companion.app.page.feed import LiveFeed
from companion.app.page.look import Reply, Start, Text
from companion.app.page.process import Line, PageProcess
from companion.app.service.state_report import ComputerWatch, state_report, throttled
from companion.base.clock import Clock, start_unix_s
from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply
from companion.config import CameraConfig, CompanionConfig, VehicleConfig
from companion.flightlog.flights_recorder import FlightsRecorder
from companion.flightlog.record import FlightLog, Tap
from companion.pad import Pad

SOURCE: Final = "the live page"
# flying is ordered by those who stand at the machine or have a ground station
ORDERS: Final = {"land": OrderKind.LAND, "stop": OrderKind.STOP}
# both of one kind: no other may hold a STOP up; each refusal goes to the log and the ground station
MOST_OPEN_ORDERS: Final = 4
ORDER_PERIOD_S: Final = 0.5
STATE_PERIOD_S: Final = 0.5
WITHOUT_CAMERA_S: Final = 0.25
THROTTLED_PERIOD_S: Final = 10.0


def yaml_of(settings: Mapping[str, BaseModel]) -> str:
    """The settings in use, defaults included, to be read; secrets are in files of their own."""
    plain = {name: model.model_dump(mode="json") for name, model in settings.items()}
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=110)


class LivePage:
    """Make it before the app, so that the log's tap hears the settings; `served` runs it beside the app."""

    def __init__(self, config: CompanionConfig, log: FlightLog) -> None:
        """Without `serve.address` it does nothing."""
        self._config, self._log, self._clock = config.serve, log, Clock()
        self._access = read_access(config.serve)
        self._start_s = self._clock.now_s()
        self._machine = ComputerWatch(self._start_s)
        self._held_back: tuple[str, ...] | None = None
        self._viewers = 0
        self._looked_at = asyncio.Event()
        self._open: dict[int, Order] = {}  # by the numbers of the page's present process
        self._ordered_s: dict[OrderKind, float] = {}
        self._newcomers = False
        meter = log.meter if isinstance(log, FlightsRecorder) else None
        self._feed = LiveFeed(config.serve.rate_hz, meter)
        if self._access is not None:
            log.tap = self._feed

    @asynccontextmanager
    async def served(self, app: App) -> AsyncIterator[None]:
        """Serve the page while inside. Whatever fails in it is reported, and ends nothing else."""
        if self._access is None:
            yield
            return
        process = PageProcess(
            self._start(self._access),
            lambda line: self._take(line, app, process),
            lambda problem: app.announcer.notify("page", f"live page: {problem}", "warning"),
        )
        works = (process.run, partial(self._tell, app, process), self._watch_throttling)
        tasks = [
            asyncio.create_task(supervised("live page", work, app.announcer.notify, lambda: False))
            for work in works
        ]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._log.tap = Tap()

    def _start(self, access: Access) -> Start:
        settings = self._feed.settings
        camera, vehicle, pad = settings["camera"], settings["vehicle"], settings["pad"]
        assert isinstance(camera, CameraConfig)
        assert isinstance(vehicle, VehicleConfig)
        assert isinstance(pad, Pad)
        return Start(
            access=access,
            serve=self._config,
            camera=camera,
            vehicle=vehicle,
            pad=pad,
            start_unix_s=start_unix_s(virtual=False),
            start_s=self._start_s,
            flights=self._log.root if isinstance(self._log, FlightsRecorder) else None,
            settings_text=yaml_of(settings),
        )

    # ------------------------------------------------------------ to the page

    async def _tell(self, app: App, process: PageProcess) -> None:
        """The state twice a second, and the rest without a picture where no picture comes."""
        next_state_s = 0.0
        while True:
            await self._looked_at.wait()
            now_s = self._clock.now_s()
            if self._feed.failure is not None:
                raise RuntimeError(self._feed.failure)
            if self._newcomers:
                self._newcomers = False
                process.put(Text("track", self._track()))
            if self._feed.lacks_pictures(now_s):
                process.put(self._feed.look(now_s))
            if now_s >= next_state_s:
                next_state_s = now_s + STATE_PERIOD_S
                process.put(Text("state", self._state(app, now_s)))
            await asyncio.sleep(WITHOUT_CAMERA_S)

    def _state(self, app: App, now_s: float) -> str:
        log = self._log
        machine = self._machine.state(now_s, log.flight_folder, self._held_back)
        report = state_report(app, self._feed.meter, machine, log, now_s, self._start_s)
        phases = [(time_s - self._start_s, phase) for time_s, phase in self._feed.phases]
        state = {"kind": "state", **report.model_dump(), "phases": phases, "viewers": self._viewers}
        return to_json(state, inf_nan_mode="null").decode()

    def _track(self) -> str:
        """What the plots begin with for who has just come."""
        rows = [
            (round(p.time_s - self._start_s, 2), *(None if v is None else round(v, 3) for v in p[1:]))
            for p in self._feed.track
        ]
        return to_json({"kind": "track", "rows": rows}, inf_nan_mode="null").decode()

    async def _watch_throttling(self) -> None:
        while True:
            await self._looked_at.wait()
            self._held_back = await asyncio.to_thread(throttled)
            await asyncio.sleep(THROTTLED_PERIOD_S)

    # ------------------------------------------------------------ from the page

    def _take(self, line: Line, app: App, process: PageProcess) -> None:
        if isinstance(url := line.get("listening"), str):
            app.announcer.notify("page", f"live page at {url}", "info")
        viewers = line.get("viewers")
        if isinstance(viewers, int):
            self._count(viewers, process)
        number = line.get("number")
        if isinstance(number, int) and "order" in line:
            self._order(str(line["order"]), number, app, process)

    def _count(self, viewers: int, process: PageProcess) -> None:
        self._newcomers |= viewers > self._viewers
        self._viewers = viewers
        self._feed.on_look = process.put if viewers else None
        if viewers:
            self._looked_at.set()
        else:
            self._looked_at.clear()
            self._open.clear()  # nobody waits for an answer any more

    def _order(self, name: str, number: int, app: App, process: PageProcess) -> None:
        """Give an order as `companion order` does; its answers go back by number, to those who still wait.

        The next process of the page numbers afresh: what was ordered through the one before answers nobody.
        """
        kind = ORDERS.get(name)
        if not self._config.allow_commands or kind is None:
            process.put(Reply(number, name, OrderOutcome.DENIED.value, "not allowed by serve.allow_commands"))
            return
        now_s = self._clock.now_s()
        soon = now_s - self._ordered_s.get(kind, float("-inf")) < ORDER_PERIOD_S
        open_ones = sum(order.kind is kind for order in self._open.values())
        if soon or open_ones >= MOST_OPEN_ORDERS or number in self._open:
            process.put(Reply(number, name, OrderOutcome.TEMPORARILY_REJECTED.value, "too many orders"))
            return
        self._ordered_s[kind] = now_s
        self._open[number] = order = Order(now_s, kind, SOURCE)

        def answer(reply: OrderReply) -> None:
            if self._open.get(number) is not order:
                return
            if reply.outcome is not OrderOutcome.IN_PROGRESS:
                del self._open[number]
            process.put(Reply(number, name, reply.outcome.value, reply.text))

        app.missions.give(order, answer)
