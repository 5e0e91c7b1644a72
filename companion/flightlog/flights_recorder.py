"""The log of a service: one folder a flight, from the minute before it was ordered to its end.

In standby the last minute is kept in memory, and nothing goes to the card. A flight's log begins with it,
written by the log's own thread, a slice at a time: the control loop hands over the whole minute at once. Its
files are opened in a thread too, and what comes meanwhile joins the minute; what of the flight no longer fits
in there is lost, counted and told. Nothing here waits for the card in a flight or at its end, and no failure
to open a log reaches whoever writes to it, the control loop.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel

from companion.base.messages import Frame
from companion.config import ConfigError
from companion.flightlog.flights import next_flight_folder
from companion.flightlog.meter import Meter
from companion.flightlog.record import BufferedCall, FlightLog
from companion.flightlog.version import SettingsRecord

KEPT_S: Final = 60.0
KEPT_FRAME_PERIOD_S: Final = 1.0  # a picture a second: a minute of them is 18 MB at 640 x 480
MOST_KEPT: Final = 120_000  # messages, whatever their stamps say


class FlightsRecorder(FlightLog):
    """A `FlightLog` of many flights: `begin` and `end` each; without a folder only the meter runs.

    `root` is where the flights' folders are.
    """

    def __init__(
        self,
        folder: Path | None,
        start_unix_s: Callable[[], float],
        make_room: Callable[[], None] | None = None,
    ) -> None:
        """`start_unix_s`: see `FlightLog`; asked at each flight, for a clock that is set after the start.

        `make_room` is called after each flight's log, in a thread: a card may take long to remove one.
        """
        super().__init__(None, start_unix_s())
        self._clock_offset_s = start_unix_s
        self.root, self._make_room = folder, make_room
        self._opener = ThreadPoolExecutor(1, thread_name_prefix="flight-log-opener")
        if folder is not None:
            self._opener.submit(lambda: None)  # starts its thread now: a flight's begin needs no new one
        self._opening: Future[FlightLog] | None = None
        self._flight: FlightLog | None = None
        self._ending: FlightLog | None = None  # whose last messages are being written
        self._minute: deque[BufferedCall] = deque()
        self._begun_s = math.inf  # the first message of the flight whose log is being opened
        self._lost = 0  # of that flight's
        self._kept_frame_s = float("-inf")
        self._settings: dict[str, BaseModel] = {}
        self._settings_record: Future[SettingsRecord] | None = None
        self._failed: str | None = None
        self.meter = Meter()

    @property
    def flight_folder(self) -> Path | None:
        """See `FlightLog`; None between flights, and until its files are open."""
        flight = self._opened()
        return None if flight is None else flight.folder

    @property
    def problem(self) -> str | None:
        """See `FlightLog`; a flight without a log because none could be made, or not yet, counts too."""
        if (flight := self._opened()) is not None:
            return flight.problem
        if self._opening is not None and self._lost:
            return f"the disk does not answer: {self._lost} messages lost from the log"
        return self._failed

    def begin(self) -> None:
        """A flight begins; it is flown also where it cannot be recorded, and `problem` says so."""
        self._failed = None
        if self.root is None or self._flight is not None or self._opening is not None:
            return
        self._begun_s, self._lost = math.inf, 0
        self._opening = self._opener.submit(self._open, self.root)

    def _open(self, root: Path) -> FlightLog:
        if self._ending is not None:
            self._ending.join()
        return FlightLog(next_flight_folder(root), self._clock_offset_s(), keeps=False)

    def _opened(self) -> FlightLog | None:
        """The log under way, once its files are open; it is given what has been kept until now."""
        if self._opening is not None and self._opening.done():
            opening, self._opening = self._opening, None
            self._flight = self._result(opening)
            if self._flight is not None:
                self._give(self._flight, self._take_minute(), self._lost)
        return self._flight

    def _result(self, opening: Future[FlightLog]) -> FlightLog | None:
        try:
            return opening.result()
        except (ConfigError, OSError) as error:
            self._failed = str(error)
        except Exception as error:
            # whatever it is, such as no memory for a thread: whoever writes here is flying
            self._failed = f"no flight log: {type(error).__name__}: {error}"
        return None

    def _take_minute(self) -> deque[BufferedCall]:
        minute, self._minute = self._minute, deque()
        return minute

    def _give(self, flight: FlightLog, minute: deque[BufferedCall], lost: int) -> None:
        record = self._settings_record
        flight.write_before(partial(SettingsRecord.of, {}) if record is None else record.result, minute, lost)

    def end(self) -> None:
        """The flight under way has ended; its files are finished by the log's thread."""
        flight, self._flight = self._opened(), None
        if flight is not None:
            self._opener.submit(self._finish, flight)
        elif self._opening is not None:
            opening, self._opening = self._opening, None
            self._opener.submit(self._end_late, opening, self._take_minute(), self._lost)

    def _end_late(self, opening: Future[FlightLog], minute: deque[BufferedCall], lost: int) -> None:
        """In the opener's thread, after the opening: the flight has ended before its files were open."""
        flight = self._result(opening)
        if flight is not None:
            self._give(flight, minute, lost)
            self._finish(flight)

    def _finish(self, flight: FlightLog) -> None:
        """In the opener's thread: where the card hangs, the log's queue is full and takes its end later."""
        flight.close(wait=False)
        self._ending = flight
        if self._make_room is not None:
            with suppress(RuntimeError):  # no thread is to be had; there is room after the next flight
                threading.Thread(target=self._make_room, name="flights", daemon=True).start()

    # ------------------------------------------------------------ as a FlightLog

    def write(self, topic: str, message: Any, time_s: float) -> None:
        self.meter.note(topic, message, time_s)
        self.tap.note(topic, message, time_s)
        self._pass_on("write", (topic, message, time_s), time_s)

    def write_settings(self, **settings: BaseModel) -> None:
        """See `FlightLog`; every flight's log gets them."""
        self._settings |= settings
        if self.root is not None:  # made now, on the ground: at an order it would delay control
            self._settings_record = self._opener.submit(SettingsRecord.of, dict(self._settings))
        self.tap.know(settings)

    def write_frame(self, frame: Frame, time_s: float) -> None:
        self.tap.frame(frame)
        if self._opened() is None:
            if time_s - self._kept_frame_s < KEPT_FRAME_PERIOD_S:
                return
            self._kept_frame_s = time_s
        self._pass_on("write_frame", (frame, time_s), time_s)

    def write_mavlink(self, data: bytes, time_s: float, direction: Literal["in", "out"]) -> None:
        self._pass_on("write_mavlink", (data, time_s, direction), time_s)

    def close(self, *, wait: bool = True) -> None:
        self.end()
        self._opener.shutdown()
        if wait and self._ending is not None:
            self._ending.join(hurries=True)

    def discard(self) -> None:
        """Nothing is removed: every folder here is a flight's."""
        self.close()

    def _pass_on(
        self,
        method: Literal["write", "write_frame", "write_mavlink"],
        arguments: tuple[Any, ...],
        time_s: float,
    ) -> None:
        if (flight := self._opened()) is not None:
            getattr(flight, method)(*arguments)
        elif self.root is not None:
            minute = self._minute
            minute.append(BufferedCall(time_s, method, arguments))
            if self._opening is not None:
                self._begun_s = min(self._begun_s, time_s)
            while len(minute) > MOST_KEPT or time_s - minute[0].time_s > KEPT_S:
                self._lost += minute.popleft().time_s >= self._begun_s
