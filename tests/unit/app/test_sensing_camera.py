"""The app's own vision task on a camera that is lost and comes back, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from companion.app.hardware import Hardware
from companion.app.sensing import Sensing
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import Frame
from companion.config import CameraConfig, CompanionConfig, VehicleConfig, find_file, load_model
from companion.flightlog.record import FlightLog
from companion.link.inbox import memory_pair
from companion.pad import load_pad
from companion.sense.camera.health import patience_with
from companion.sense.camera.keeper import KeptCamera, LiveSource
from companion.sense.vision.pipeline import Vision
from companion.tools.pad_check.moves import RecentSamples
from companion.tools.pad_check.session import Outlets, PadCheck
from companion.tools.pad_check.wizard import Say
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from tests.unit.sense.camera.camera_frames import ScriptedCamera

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
PAD = load_pad("moving_1300")
LOST_S, FOUND_S = 1.0, 2.5


def test_the_pad_is_seen_again_and_people_are_reported_when_the_camera_comes_back() -> None:
    told = list[tuple[float, str, str, str]]()
    samples, problems = RecentSamples(), dict[float, str | None]()

    async def main() -> None:
        clock = Clock()
        sensing = Sensing(
            CompanionConfig(),
            Hardware(memory_pair()[0], over_the_pad(unplugged_from_s=LOST_S, until_s=FOUND_S)),
            Vision(PAD, CAMERA, VEHICLE, CompanionConfig().sense.vision),
            samples,
            clock=clock,
            log=FlightLog(None, start_unix_s=0.0),
            notify=lambda kind, text, severity: told.append((clock.now_s(), kind, text, severity)),
        )
        tasks = [asyncio.create_task(run(work)) for work in sensing.tasks().values()]
        for time_s in (0.9, 1.5, 4.5):
            await clock.sleep_until(time_s)
            problems[time_s] = sensing.camera_problem
        for task in tasks:
            task.cancel()

    run_in_virtual_time(main())
    times = [sighting.time_s for sighting in samples.sightings]
    assert min(times) < 0.2
    assert not [time_s for time_s in times if LOST_S + 0.05 < time_s < FOUND_S]
    assert sum(FOUND_S < time_s < 4.5 for time_s in times) > 25
    lost, back = told[0], told[-1]
    assert lost[0] - LOST_S <= 0.3
    assert lost[1:] == ("device_lost", "camera: unplugged", "error")
    assert back[1] == "sensor"
    assert back[2].startswith("camera: frames again after")
    assert [text for _, _, text, _ in told[1:-1]] == ["camera: no camera at /dev/video0"]
    assert (problems[0.9], problems[4.5]) == (None, None)
    assert problems[1.5] is not None


class FrozenPicture:
    """Frames with new stamps and numbers, and from a moment on with the same picture."""

    def __init__(self, frozen_from_s: float) -> None:
        self._model = CameraModel(CAMERA, VEHICLE, PAD, ImagingSettings(), np.random.default_rng(5))
        self._from_s, self._count, self._clock = frozen_from_s, 0, Clock()
        self._image = self._render(0.0)

    def _render(self, time_s: float) -> np.ndarray:
        still = ScenePose((0.0, 0.0, -2.3), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -0.3), 0.0)
        return self._model.render(time_s, lambda _: still)

    async def next(self) -> Frame:
        await asyncio.sleep(1.0 / 30.0)
        now_s, self._count = self._clock.now_s(), self._count + 1
        if now_s < self._from_s:
            self._image = self._render(now_s)
        return Frame(now_s - 0.01, now_s, self._count, self._image)

    def close(self) -> None:
        pass


def test_a_picture_that_stands_still_with_new_stamps_is_no_sighting() -> None:
    told = list[str]()
    samples = RecentSamples()

    async def main() -> None:
        clock = Clock()
        sensing = Sensing(
            CompanionConfig(),
            Hardware(memory_pair()[0], FrozenPicture(frozen_from_s=1.0)),
            Vision(PAD, CAMERA, VEHICLE, CompanionConfig().sense.vision),
            samples,
            clock=clock,
            log=FlightLog(None, start_unix_s=0.0),
            notify=lambda _kind, text, _severity: told.append(text),
        )
        task = asyncio.create_task(run(sensing.tasks()["camera"]))
        await clock.sleep_until(2.0)
        task.cancel()

    run_in_virtual_time(main())
    times = [sighting.time_s for sighting in samples.sightings]
    assert len(times) > 10
    assert max(times) < 1.05
    assert [text.partition(": ")[2] for text in told] == ["the same image repeated"]


async def run(work: Callable[[], Awaitable[None]]) -> None:
    await work()


def over_the_pad(*, unplugged_from_s: float, until_s: float) -> KeptCamera:
    """A camera two metres over the pad that is unplugged for a while."""
    model = CameraModel(CAMERA, VEHICLE, PAD, ImagingSettings(), np.random.default_rng(5))
    still = ScenePose((0.0, 0.0, -2.3), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -0.3), 0.0)
    clock = Clock()

    def show(frame: Frame) -> Frame:
        if unplugged_from_s <= clock.now_s() < until_s:
            raise OSError("unplugged")
        return replace(frame, image=model.render(frame.time_s, lambda _: still))

    async def open_it() -> LiveSource:
        if unplugged_from_s <= clock.now_s() < until_s:
            raise OSError("no camera at /dev/video0")
        return ScriptedCamera(show)

    return KeptCamera(ScriptedCamera(show), open_it, patience_with(CAMERA, "device"))


def test_the_check_says_how_the_camera_does() -> None:
    async def main() -> list[str]:
        said, transport = list[Say](), memory_pair()[0]
        frames = over_the_pad(unplugged_from_s=1e6, until_s=1e6)
        check = PadCheck(CompanionConfig(), Hardware(transport, frames), Outlets(said.append), linked=False)
        with suppress(TimeoutError):
            await asyncio.wait_for(check.run(), 4.0)
        return [line.text for line in said if line.text.startswith("camera")]

    (line,) = run_in_virtual_time(main())
    rate, rest = line.split(" frames/s looked at, ")
    assert 25.0 < float(rate.removeprefix("camera: ")) < 32.0
    assert rest == "20 ms old on arrival; the driver says: exposure 4.00 ms, gain 2"
