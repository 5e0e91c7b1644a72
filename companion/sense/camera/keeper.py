"""A camera that is kept: watched, given up on when it is lost, and opened anew, again and again.

    device or socket ─► health ─► newest frame ─► vision
                          └─► reports: notices, status

Who waits for a frame simply goes on waiting while there is no camera; what is wrong goes to `report`.
Nothing here waits for a driver: one that hangs is left alone with its thread (`reader`).
"""

import asyncio
import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, Protocol

from companion.base.clock import Clock
from companion.base.messages import Frame
from companion.config import ConfigError
from companion.sense.camera.health import CameraHealth, Patience
from companion.sense.camera.reader import EndOfFrames, Newest, OpeningHangs, ReadBack

# the usual camera's frames come sooner: while all is well, nothing else wakes the watch
WATCH_S: Final = 0.04
LETTING_GO_S: Final = 1.5  # for a driver's thread to end, before the device is opened all the same
FIRST_PAUSE_S: Final = 0.25
LONGEST_PAUSE_S: Final = 1.0
# images of no use may be the light's or the lens cap's fault, which opening does not mend: ever more patience
LONGEST_PATIENCE_S: Final = 30.0
RECOVERED_S: Final = 5.0
GOOD_AGAIN_S: Final = 0.5  # of good frames alone, until the trouble counts as over
MOST_HANGING: Final = 4  # drivers left alone; with so many no further one is started
NUMBER: Final = re.compile(r"[\d.]+")


class LiveSource(Protocol):
    """A camera that has been opened once: `reader.ThreadedCamera`, `frame_socket.SocketCamera`."""

    @property
    def held(self) -> bool:
        """Whether its driver still has the device."""

    @property
    def read_back(self) -> ReadBack:
        """What the driver says of its settings."""

    async def next(self) -> Frame:
        """See `source.FrameSource`."""

    def take_notes(self) -> list[str]:
        """What there is to say about it, each line once."""

    def let_go(self) -> None:
        """Give it back without waiting for it."""

    def close(self) -> None:
        """See `source.FrameSource`."""


@dataclass(frozen=True, slots=True)
class CameraReport:
    """One line about the camera."""

    text: str
    severity: Literal["info", "warning", "error"]


class KeptCamera:
    """A `FrameSource` that never ends. Make it inside the running loop, with the camera opened once."""

    def __init__(
        self,
        first: LiveSource | None,
        reopen: Callable[[], Awaitable[LiveSource]],
        patience: Patience,
        *,
        missing: str = "",
    ) -> None:
        """Keep `first`; `reopen` opens the same camera anew. Without one yet, `missing` says why."""
        self._source, self._reopen, self._patience = first, reopen, patience
        self._clock = Clock()
        self._newest = Newest()
        self._reports: asyncio.Queue[CameraReport] = asyncio.Queue()
        self._hanging: list[LiveSource] = []
        self._problem: str | None = None
        self._reported: set[str] = set()  # of the present trouble
        self._reported_notes: set[str] = set()  # a camera that is opened again has the same to say
        self._trouble_s = 0.0
        self._pause_s = FIRST_PAUSE_S
        self._last_sequence = -1
        self._content_patience_s = patience.content_s
        if first is None:
            self._set_trouble(missing)
        self._task = asyncio.create_task(self._keep(), name="camera's keeper")
        self._task.add_done_callback(self._tell_failure)

    @property
    def problem(self) -> str | None:
        """What is wrong now, None when all is well."""
        return self._problem

    @property
    def read_back(self) -> ReadBack:
        return ReadBack() if self._source is None else self._source.read_back

    async def next(self) -> Frame:
        """See `source.FrameSource`; waits for as long as there is no camera."""
        return await self._newest.next()

    async def report(self) -> CameraReport:
        """Wait for the next thing to tell about the camera."""
        return await self._reports.get()

    def close(self) -> None:
        self._task.cancel()
        if self._source is not None:
            self._source.close()

    def _tell_failure(self, task: asyncio.Task[None]) -> None:
        """A fault of ours must not look like a camera that is silent."""
        if not task.cancelled() and (error := task.exception()) is not None:
            self._newest.fail(OSError(f"its keeper failed: {type(error).__name__}: {error}"))

    # ------------------------------------------------------------ one life after another

    async def _keep(self) -> None:
        source = self._source or await self._open_anew()
        while True:
            self._source = source
            lasted = await self._watch(source)
            if not lasted:
                return
            await self._let_go(source)
            source = await self._open_anew()

    async def _watch(self, source: LiveSource) -> bool:
        """Hand on what is of use until the camera is lost; whether another life makes sense."""
        patience = replace(self._patience, content_s=self._content_patience_s)
        health = CameraHealth(patience, self._clock.now_s())
        offset: int | None = None
        try:
            while (cause := health.lost(self._clock.now_s())) is None:
                looked_s = self._clock.now_s()
                frame = await _next_within(source, WATCH_S)
                if (late_s := self._clock.now_s() - looked_s - WATCH_S) > WATCH_S:
                    health.excuse(late_s)
                if frame is not None:
                    if offset is None:  # numbers go on from life to life
                        offset = self._last_sequence + 1 - frame.sequence
                    self._take(replace(frame, sequence=frame.sequence + offset), health)
                self._tell_notes(source)
                self._tell_trouble(health)
                good_s = health.good_since_s
                if good_s is not None and self._clock.now_s() - good_s > RECOVERED_S:
                    self._content_patience_s = self._patience.content_s
        except EndOfFrames as end:
            self._problem = str(end)
            self._reports.put_nowait(CameraReport(f"camera: {end}", "info"))
            return False
        except (OSError, ConfigError) as error:
            if isinstance(error, ConfigError) and self._last_sequence < 0:
                self._newest.fail(error)  # it never was what the settings say: a mistake of theirs
                return False
            self._set_trouble(str(error))
            return True
        if cause == "content":
            self._content_patience_s = min(2.0 * self._content_patience_s, LONGEST_PATIENCE_S)
        return True

    def _take(self, frame: Frame, health: CameraHealth) -> None:
        if health.take(frame, self._clock.now_s()):
            self._last_sequence = max(self._last_sequence, frame.sequence)
            self._newest.put(frame)

    async def _let_go(self, source: LiveSource) -> None:
        """Part from a camera; from one whose driver hangs, after a while, without its consent."""
        source.let_go()
        until_s = self._clock.now_s() + LETTING_GO_S
        while source.held and self._clock.now_s() < until_s:  # noqa: ASYNC110 - a thread has no event
            await asyncio.sleep(WATCH_S)
        if source.held:
            self._hanging.append(source)

    async def _open_anew(self) -> LiveSource:
        """Try until it opens, with longer and longer pauses."""
        while True:
            await asyncio.sleep(self._pause_s)
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            self._hanging = [source for source in self._hanging if source.held]
            if len(self._hanging) >= MOST_HANGING:
                self._set_trouble("driver hangs")
                continue
            try:
                return await self._reopen()
            except Exception as error:  # no memory, no thread: whatever it is, the next try may do
                self._set_trouble(str(error) or type(error).__name__)
                if isinstance(error, OpeningHangs):
                    self._hanging.append(error.camera)

    # ------------------------------------------------------------ telling

    def _tell_notes(self, source: LiveSource) -> None:
        for note in source.take_notes():
            if (shape := NUMBER.sub("", note)) in self._reported_notes:
                continue
            self._reported_notes.add(shape)
            self._reports.put_nowait(CameraReport(f"camera: {note}", "warning"))

    def _tell_trouble(self, health: CameraHealth) -> None:
        now_s = self._clock.now_s()
        trouble, good_s = health.trouble(now_s), health.good_since_s
        if trouble is not None:
            self._set_trouble(trouble)
        elif self._problem is not None and good_s is not None and now_s - good_s >= GOOD_AGAIN_S:
            self._problem = None
            self._pause_s = FIRST_PAUSE_S
            self._reported.clear()
            text = f"camera: frames again after {good_s - self._trouble_s:.1f} s"
            self._reports.put_nowait(CameraReport(text, "info"))

    def _set_trouble(self, text: str) -> None:
        """Note what is wrong; report it unless this trouble has had the same report, numbers aside."""
        if self._problem is None:
            self._trouble_s = self._clock.now_s()
        self._problem = text
        shape = NUMBER.sub("", text)
        if shape not in self._reported:
            self._reported.add(shape)
            self._reports.put_nowait(CameraReport(f"camera: {text}", "error"))


async def _next_within(source: LiveSource, wait_s: float) -> Frame | None:
    """The next frame, None after so long without one; the camera's own time-out is an error as any other."""
    try:
        async with asyncio.timeout(wait_s) as waiting:
            return await source.next()
    except TimeoutError:
        if not waiting.expired():
            raise
        return None
