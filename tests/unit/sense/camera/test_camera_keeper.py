"""A camera that is kept: lost in every way, told, and opened anew; in virtual time."""

import asyncio
import itertools
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.clock import Clock, run_in_virtual_time, sleep_s
from companion.base.messages import Frame
from companion.config import CameraConfig, ConfigError
from companion.sense.camera import keeper as camera_keeper
from companion.sense.camera.health import CameraHealth, patience_with
from companion.sense.camera.keeper import CameraReport, KeptCamera, LiveSource
from companion.sense.camera.reader import Device, EndOfFrames, Newest, ThreadedCamera, grey
from tests.unit.sense.camera.camera_frames import AGE_S, ScriptedCamera, noisy_frame
from tests.virtual_time import in_virtual_time

Act = Callable[[Frame], Frame | None]


@dataclass
class KeeperRun:
    """What came of a run: reports and frames with the time at which they came, and openings."""

    reports: list[tuple[float, CameraReport]] = field(default_factory=list)
    frames: list[tuple[float, Frame]] = field(default_factory=list)
    openings: list[float] = field(default_factory=list)
    problems: list[str | None] = field(default_factory=list)
    error: Exception | None = None

    def told(self, text: str) -> list[float]:
        """When something was told."""
        return [time_s for time_s, report in self.reports if text in report.text]

    def frames_between(self, from_s: float, to_s: float) -> int:
        """How many frames came then."""
        return sum(from_s <= time_s <= to_s for time_s, _ in self.frames)


def good(frame: Frame) -> Frame:
    return frame


def until(end_s: float, act: Act) -> Act:
    """Good frames up to that time (s, loop's), then what `act` says."""
    return lambda frame: frame if frame.time_s < end_s else act(frame)


def silent(_: Frame) -> None:
    return None


def gone(_: Frame) -> Frame:
    raise OSError("unplugged")


@in_virtual_time
async def run(
    camera: CameraConfig,
    acts: list[Act | Exception],
    lasting_s: float,
    *,
    socket: bool = False,
    held_for_s: float = 0.0,
) -> KeeperRun:
    """A camera whose first life is as the first of `acts` says, the next as the next; then as the last."""
    seen, lives = KeeperRun(), iter(acts)
    last: list[Act | Exception] = [good]

    async def open_it() -> LiveSource:
        seen.openings.append(Clock().now_s())
        last[0] = next(lives, last[0])
        if isinstance(last[0], Exception):
            raise last[0]
        return ScriptedCamera(last[0], held_for_s=held_for_s)

    async def collect(get: Callable[[], Awaitable[Any]], into: list[tuple[float, Any]]) -> None:
        while True:
            into.append((Clock().now_s(), await get()))
            into[-1] = (Clock().now_s(), into[-1][1])

    kept = KeptCamera(await open_it(), open_it, patience_with(camera, "socket" if socket else "device"))
    tasks = [
        asyncio.create_task(collect(kept.report, seen.reports)),
        asyncio.create_task(collect(kept.next, seen.frames)),
    ]
    for _ in range(round(lasting_s / 0.1)):
        await asyncio.sleep(0.1)
        seen.problems.append(kept.problem)
    if tasks[1].done():
        seen.error = tasks[1].exception()  # type: ignore[assignment]
    for task in tasks:
        task.cancel()
    kept.close()
    return seen


def test_a_good_camera_is_handed_on_frame_by_frame_and_says_nothing(camera: CameraConfig) -> None:
    seen = run(camera, [good], 3.0)
    assert len(seen.frames) == pytest.approx(90, abs=2)
    assert [frame.sequence for _, frame in seen.frames] == list(range(len(seen.frames)))
    assert seen.reports == []
    assert seen.problems == [None] * 30


def test_a_stall_is_reported_within_a_third_of_a_second_and_ends_by_opening_anew(
    camera: CameraConfig,
) -> None:
    seen = run(camera, [until(2.0, silent), good], 6.0)
    (told_s,) = seen.told("no frame for")
    assert 2.0 < told_s <= 2.3
    assert len(seen.openings) == 2
    assert seen.openings[1] == pytest.approx(3.25, abs=0.1)
    assert seen.frames_between(2.1, seen.openings[1]) == 0
    assert seen.frames_between(seen.openings[1], 6.0) > 75
    (back_s,) = seen.told("frames again after")
    assert back_s < seen.openings[1] + 0.7
    assert seen.problems[25] is not None
    assert seen.problems[-1] is None


def test_frames_go_on_being_counted_after_the_camera_was_opened_anew(camera: CameraConfig) -> None:
    seen = run(camera, [until(2.0, gone), good], 5.0)
    numbers = [frame.sequence for _, frame in seen.frames]
    assert numbers == list(range(len(numbers)))


def test_an_unplugged_camera_is_tried_again_and_again_with_a_bounded_pause(camera: CameraConfig) -> None:
    missing = ConfigError("no camera at /dev/video0")
    seen = run(camera, [until(1.0, gone), *[missing] * 15, good], 40.0)
    pauses = np.diff(seen.openings[1:])
    assert len(pauses) == 15
    assert pauses.max() == pytest.approx(camera_keeper.LONGEST_PAUSE_S, abs=0.1)
    (told_s,) = seen.told("unplugged")
    assert told_s <= 1.3
    assert len(seen.told("no camera at /dev/video0")) == 1  # once for the whole trouble
    assert len(seen.told("frames again after")) == 1
    assert seen.problems[-1] is None


def test_whatever_opening_raises_it_is_tried_again(camera: CameraConfig) -> None:
    seen = run(camera, [until(1.0, gone), RuntimeError("can't start new thread"), good], 6.0)
    assert len(seen.told("can't start new thread")) == 1
    assert seen.frames_between(3.0, 6.0) > 60


def test_a_camera_that_opens_and_gives_nothing_is_tried_with_growing_pauses_too(camera: CameraConfig) -> None:
    seen = run(camera, [until(1.0, gone), gone], 40.0)
    assert np.diff(seen.openings[-5:]) == pytest.approx(camera_keeper.LONGEST_PAUSE_S, abs=0.1)
    seen = run(camera, [until(1.0, gone), gone, gone, gone, until(15.0, gone), good], 20.0)
    assert seen.openings[-1] < 15.5  # after good ones the first pause is short again


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda frame: replace(frame, image=np.zeros((480, 640), np.uint8)), "one grey"),
        (lambda frame: replace(frame, time_s=frame.time_s - 9.0), "9.0 s before"),
        (lambda frame: replace(frame, time_s=2.0), "do not advance"),
    ],
)
def test_garbage_is_reported_kept_from_the_eyes_and_opened_anew(
    camera: CameraConfig, spoil: Act, told: str
) -> None:
    seen = run(camera, [until(2.0, spoil), good], 6.0)
    assert [time_s <= 2.35 for time_s in seen.told(told)] == [True]
    assert len(seen.openings) == 2
    assert seen.frames_between(2.1, seen.openings[1]) == 0
    assert seen.frames_between(seen.openings[1], 6.0) > 60
    assert len(seen.told("frames again after")) == 1


def test_a_dark_image_is_given_more_and_more_time(camera: CameraConfig) -> None:
    dark: Act = lambda frame: replace(frame, image=np.zeros((480, 640), np.uint8))  # noqa: E731
    seen = run(camera, [dark], 100.0)
    assert len(seen.told("one grey")) == 1
    pauses = np.diff(seen.openings)
    assert pauses[0] < 3.0
    assert pauses[-1] > camera_keeper.LONGEST_PATIENCE_S
    assert len(seen.openings) < 10


def test_a_driver_that_hangs_is_left_alone(camera: CameraConfig) -> None:
    seen = run(camera, [until(2.0, silent), good], 8.0, held_for_s=1e6)
    assert len(seen.openings) == 2
    assert seen.frames_between(5.0, 8.0) > 60


def test_no_more_than_a_few_drivers_are_left_hanging(camera: CameraConfig) -> None:
    seen = run(camera, [silent], 200.0, held_for_s=1e6)
    assert len(seen.openings) == camera_keeper.MOST_HANGING
    assert len(seen.told("driver hangs")) == 1


@in_virtual_time
async def test_a_camera_whose_driver_hangs_in_opening_is_tried_a_few_times(camera: CameraConfig) -> None:
    never, makers = threading.Event(), list[float]()

    def hang(_: threading.Event) -> Device:
        never.wait()
        raise OSError

    async def open_it() -> LiveSource:
        makers.append(Clock().now_s())
        return await ThreadedCamera.open(hang)

    kept = KeptCamera(ScriptedCamera(gone), open_it, patience_with(camera, "device"))
    await asyncio.sleep(200.0)
    kept.close()
    told = [(await kept.report()).text for _ in range(3)]
    never.set()
    assert told == [
        "camera: unplugged",
        "camera: the camera does not open within 6 s: its driver hangs",
        "camera: driver hangs",
    ]
    assert len(makers) == camera_keeper.MOST_HANGING


class SteadySocket(ScriptedCamera):
    """Frames through a socket that the loop reads, one every 20 ms, whatever the loop does meanwhile."""

    def __init__(self) -> None:
        super().__init__(good)
        self._near, self._far = socket.socketpair()
        self._near.setblocking(False)
        self._newest = Newest()
        self._reading = asyncio.create_task(self._read())
        threading.Thread(target=self._send, daemon=True).start()

    def _send(self) -> None:
        with suppress(OSError):
            while True:
                sleep_s(0.02)
                self._far.send(b".")

    async def _read(self) -> None:
        for number in range(10_000):
            await asyncio.get_running_loop().sock_recv(self._near, 1)
            self._newest.put(noisy_frame(number, time.monotonic() - AGE_S))

    async def next(self) -> Frame:
        return await self._newest.next()

    def close(self) -> None:
        self._reading.cancel()
        self._far.close()


def test_opening_that_is_given_up_ends_with_its_thread() -> None:
    """A driver that comes back while the interpreter ends would abort the process."""
    opening, back = threading.Event(), threading.Event()

    def make(stop: threading.Event) -> Device:
        opening.set()
        stop.wait(10.0)
        time.sleep(0.05)
        back.set()
        raise OSError("given up")

    async def give_up() -> None:
        task = asyncio.create_task(ThreadedCamera.open(make))
        await asyncio.to_thread(opening.wait, 10.0)
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task

    asyncio.run(give_up())
    assert back.is_set()


def test_a_loop_that_was_held_up_does_not_blame_the_camera(camera: CameraConfig) -> None:
    """As when a service goes back to standby: what has come meanwhile counts before it is judged."""

    async def main() -> list[str]:
        async def open_it() -> LiveSource:
            return SteadySocket()

        kept = KeptCamera(await open_it(), open_it, patience_with(camera, "socket"))
        told: list[str] = []

        async def listen() -> None:
            while True:
                told.append((await kept.report()).text)

        listening = asyncio.create_task(listen())
        for _ in range(5):
            await kept.next()
        for held_up_s in (0.4, 1.2):
            sleep_s(held_up_s)
            for _ in range(5):
                await kept.next()
        listening.cancel()
        kept.close()
        return told

    assert asyncio.run(main()) == []


def test_images_of_another_size_from_the_start_are_a_mistake_in_the_settings(camera: CameraConfig) -> None:
    def another_size(_: Frame) -> Frame:
        raise ConfigError("images of 320x240")

    seen = run(camera, [another_size], 3.0)
    assert isinstance(seen.error, ConfigError)
    assert len(seen.openings) == 1


def test_images_of_another_size_in_flight_are_trouble_like_any_other(camera: CameraConfig) -> None:
    def another_size(_: Frame) -> Frame:
        raise ConfigError("images of 320x240")

    seen = run(camera, [until(1.0, another_size), good], 4.0)
    assert len(seen.told("images of 320x240")) == 1
    assert seen.frames_between(2.0, 4.0) > 50


def test_the_end_of_a_recording_is_reported_and_not_played_again(camera: CameraConfig) -> None:
    def over(_: Frame) -> Frame:
        raise EndOfFrames("flight.mp4 has ended")

    seen = run(camera, [until(1.0, over)], 10.0)
    assert [report.text for _, report in seen.reports] == ["camera: flight.mp4 has ended"]
    assert len(seen.openings) == 1
    assert seen.problems[-1] == "flight.mp4 has ended"


def test_a_silent_server_is_reported_as_soon_but_parted_from_later(camera: CameraConfig) -> None:
    seen = run(camera, [until(1.0, silent), good], 9.0, socket=True)
    assert [time_s <= 1.3 for time_s in seen.told("no frame for")] == [True]
    assert seen.openings[1] > 5.5


def test_short_gaps_are_reported_once_each_and_the_camera_is_not_closed_for_them(
    camera: CameraConfig,
) -> None:
    gappy: Act = lambda frame: None if frame.time_s % 2.0 < 0.5 else frame  # noqa: E731
    seen = run(camera, [gappy], 10.0)
    assert len(seen.openings) == 1
    assert len(seen.told("no frame for")) == len(seen.told("frames again after")) == 4


@in_virtual_time
async def test_what_a_driver_did_not_take_is_reported_as_a_warning(camera: CameraConfig) -> None:
    source = ScriptedCamera(good)
    source.notes.append("gain 30 asked for, the driver says 0")
    kept = KeptCamera(source, lambda: asyncio.sleep(0, source), patience_with(camera, "device"))
    report = await kept.report()
    kept.close()
    assert source.closed
    assert report == CameraReport("camera: gain 30 asked for, the driver says 0", "warning")


def test_what_a_driver_never_takes_is_not_reported_at_every_opening(camera: CameraConfig) -> None:
    texts = list[str]()

    async def open_it() -> LiveSource:
        source = ScriptedCamera(until(Clock().now_s() + 1.0, gone))
        source.notes.append("gain 30 asked for, the driver says 0")
        return source

    async def main() -> None:
        kept = KeptCamera(await open_it(), open_it, patience_with(camera, "device"))
        while True:
            texts.append((await kept.report()).text)

    with pytest.raises(TimeoutError):
        run_in_virtual_time(asyncio.wait_for(main(), 10.0))
    assert sum("gain 30" in text for text in texts) == 1
    assert sum("unplugged" in text for text in texts) > 3


# ---------------- What is held to be wrong with a camera, frame by frame, with the clock handed in

PERIOD_S = 1 / 30
Spoil = Callable[[Frame, Frame], Frame]  # the frame, and the one before it


def images(change: Callable[[NDArray[np.uint8], NDArray[np.uint8]], NDArray[np.uint8]]) -> Spoil:
    """Frames of other images."""
    return lambda frame, before: replace(frame, image=change(frame.image, before.image))


def flat(grey: int) -> Spoil:
    """Frames of one grey."""
    return images(lambda image, _: np.full_like(image, grey))


def with_lower_part(of: Callable[[NDArray[np.uint8]], NDArray[np.uint8] | int], share: float = 0.4) -> Spoil:
    """Frames whose lower part is something else, made of the image before."""

    def change(image: NDArray[np.uint8], before: NDArray[np.uint8]) -> NDArray[np.uint8]:
        rows = round(share * len(image))
        torn, filling = image.copy(), of(before)
        torn[-rows:] = filling if isinstance(filling, int) else filling[-rows:]
        return torn

    return images(change)


class Fed:
    """A camera that has given good frames for a second, and then others."""

    def __init__(self, camera: CameraConfig) -> None:
        self.health = CameraHealth(patience_with(camera, "device"), opened_s=99.9)
        self.now_s, self.number, self.used = 100.0, 0, 0
        self.before = noisy_frame(-1, 99.9)
        self.feed(1.0, lambda frame, _: frame)
        assert self.health.trouble(self.now_s) is None
        self.spoilt_s = self.now_s

    def feed(self, lasting_s: float, spoil: Spoil) -> str | None:
        """Frames for so long; the first trouble."""
        self.used = 0
        for _ in range(round(lasting_s / PERIOD_S)):
            self.now_s += PERIOD_S
            self.number += 1
            frame = noisy_frame(self.number, self.now_s - AGE_S)
            self.before = spoil(frame, self.before)
            self.used += self.health.take(self.before, self.now_s)
            if (trouble := self.health.trouble(self.now_s)) is not None:
                return trouble
        return None


@pytest.fixture
def fed(camera: CameraConfig) -> Fed:
    return Fed(camera)


FROZEN = noisy_frame(0, 0.0).image


@pytest.mark.parametrize(
    ("spoil", "told", "used"),
    [
        (flat(0), "one grey (0 of 255)", False),
        (flat(128), "one grey (128 of 255)", False),
        (flat(255), "one grey (255 of 255)", False),
        (with_lower_part(lambda _: 0), "lower part empty", True),
        (with_lower_part(lambda _: 128, share=0.15), "lower part empty", True),
        (with_lower_part(lambda before: before), "lower part of the previous one", False),
        (images(lambda *_: FROZEN), "the same image repeated", False),
        (lambda frame, _: replace(frame, time_s=101.0 - AGE_S), "frame stamps do not advance", False),
        (lambda frame, _: replace(frame, time_s=frame.time_s - 0.4), "frame stamps jump back", False),
        (lambda frame, _: replace(frame, time_s=frame.time_s - 7.0), "7.0 s before arrival", False),
        (lambda frame, _: replace(frame, time_s=frame.time_s + 2.0), "2.0 s after arrival", False),
    ],
)
def test_garbage_is_named_within_a_third_of_a_second(fed: Fed, spoil: Spoil, told: str, used: bool) -> None:
    trouble = fed.feed(2.0, spoil)
    assert trouble is not None
    assert told in trouble
    assert fed.now_s - fed.spoilt_s <= 0.3
    assert (fed.used > 5) if used else (fed.used <= 1)  # the first frozen one may be new


def film(path: Path, moving_rows: int) -> list[NDArray[np.uint8]]:
    """Frames as MPEG-4 gives them back: a ground that moves by, a leg below that does not, and noise."""
    rng = np.random.default_rng(1)
    ground = cv2.resize(rng.integers(60, 200, (120, 120)).astype(np.uint8), (960, 960)).astype(float)
    leg = cv2.GaussianBlur(cv2.resize(rng.integers(15, 60, (4, 16)).astype(np.uint8), (640, 480)), (0, 0), 9)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (640, 480))
    for k in range(60):
        image = ground[2 * k : 2 * k + 480, 3 * k : 3 * k + 640].copy()
        image[moving_rows:] = leg[moving_rows:]
        noisy_image = np.clip(image + rng.normal(0.0, 0.3, image.shape), 0, 255).astype(np.uint8)
        writer.write(cv2.cvtColor(noisy_image, cv2.COLOR_GRAY2BGR))
    writer.release()
    reader, frames = cv2.VideoCapture(str(path)), []
    while (read := reader.read())[0]:
        frames.append(grey(read[1]))
    return frames


def test_what_a_compressed_video_did_not_send_again_is_no_tear(tmp_path: Path, camera: CameraConfig) -> None:
    frames = film(tmp_path / "leg.mp4", 384)
    assert any(np.array_equal(a[400:], b[400:]) for a, b in itertools.pairwise(frames))
    health = CameraHealth(patience_with(camera, "stream"), opened_s=99.9)
    for k, image in enumerate(frames):
        now_s = 100.0 + k * PERIOD_S
        assert health.take(Frame(now_s - AGE_S, now_s, k, image), now_s)
    assert health.trouble(now_s) is None


def test_what_lasts_makes_the_camera_lost(fed: Fed) -> None:
    fed.feed(2.0, flat(0))
    assert fed.health.lost(fed.now_s) is None
    while fed.now_s < fed.spoilt_s + 1.1:
        fed.feed(PERIOD_S, flat(0))
    assert fed.health.lost(fed.now_s) == "content"


def test_a_camera_that_still_shows_something_is_reported_and_kept(fed: Fed) -> None:
    torn = with_lower_part(lambda _: 0)  # a hood, a leg or a marker's black in the dark looks the same
    while fed.now_s < fed.spoilt_s + 40.0:
        fed.feed(PERIOD_S, torn)
        assert fed.health.lost(fed.now_s) is None
    assert "lower part empty" in (fed.health.trouble(fed.now_s) or "")


@pytest.mark.parametrize(
    "spoil",
    [
        with_lower_part(lambda _: 255),  # glare, or a bright floor
        with_lower_part(lambda _: 0, share=0.05),  # the rim of a hood
        images(lambda image, _: image // 10),  # dusk: a few greys, with noise
        images(lambda image, _: np.where(np.arange(480)[:, None] < 200, 255, image).astype(np.uint8)),
    ],
)
def test_light_is_no_fault(fed: Fed, spoil: Spoil) -> None:
    assert fed.feed(2.0, spoil) is None
    assert fed.used == 60


def test_single_bad_frames_are_passed_over_in_silence(fed: Fed) -> None:
    every_third: Spoil = lambda frame, before: frame if fed.number % 3 else flat(0)(frame, before)  # noqa: E731
    assert fed.feed(2.0, every_third) is None
    assert fed.used == 40


@pytest.mark.parametrize("rate_hz", [5.0, 30.0, 120.0])
def test_silence_is_trouble_within_a_third_of_a_second_at_any_rate(
    camera: CameraConfig, rate_hz: float
) -> None:
    slow = camera.model_copy(update={"rate_hz": rate_hz})
    health = CameraHealth(patience_with(slow, "device"), opened_s=99.0)
    health.take(noisy_frame(0, 100.0), 100.0)
    assert health.trouble(100.0 + 1.05 / rate_hz) is None
    assert "no frame" in (health.trouble(100.28) or "")
    assert health.lost(100.9) is None
    assert health.lost(101.1) == "silent"


def test_a_camera_that_never_begins_is_reported_and_lost(camera: CameraConfig) -> None:
    health = CameraHealth(patience_with(camera, "device"), opened_s=100.0)
    assert health.trouble(101.9) is None
    assert "since it was opened" in (health.trouble(102.1) or "")
    assert (health.lost(102.9), health.lost(103.1)) == (None, "silent")


def test_a_server_that_has_not_begun_yet_is_waited_for(camera: CameraConfig) -> None:
    health = CameraHealth(patience_with(camera, "socket"), opened_s=100.0)
    assert health.trouble(102.1) is not None
    assert health.lost(1000.0) is None


def test_the_good_run_begins_after_the_trouble(fed: Fed) -> None:
    assert fed.health.good_since_s is not None
    assert fed.health.good_since_s < 100.1
    fed.now_s += 0.4
    back_s = fed.now_s + PERIOD_S
    fed.feed(0.2, lambda frame, _: frame)
    assert fed.health.good_since_s == pytest.approx(back_s)
