"""Devices that are not there yet: what reads them fails, what is written is dropped, they come back."""

from __future__ import annotations

import asyncio
import errno
import math
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.app import hardware
from companion.app.app import supervised
from companion.app.hardware import AwaitedBus, AwaitedPort, AwaitedTransport, Hardware, opened_if_there
from companion.app.sensing import SEARCH_LOOK_S, Notify, Sensing
from companion.base.clock import Clock
from companion.base.errors import ConfigError, DeviceMissing
from companion.base.messages import Frame, PadBeacon, PadObservation, PadPrior, RangeSample
from companion.config import CameraConfig, CompanionConfig, SenseConfig, VehicleConfig, find_file, load_model
from companion.config.reading import validate
from companion.flightlog.record import FlightLog
from companion.link.codec import Severity
from companion.link.transport import memory_pair
from companion.pad import load_pad
from companion.sense.camera.health import patience_with
from companion.sense.camera.keeper import KeptCamera, LiveSource
from companion.sense.vision.pipeline import Vision, VisionResult
from companion.tools.pad_check.moves import RecentSamples
from companion.tools.pad_check.session import PadCheck
from companion.tools.pad_check.wizard import Say
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from tests.unit.sense.camera.camera_frames import ScriptedCamera
from tests.virtual_time import in_virtual_time


class UnpluggedLine:
    """A port and a transport; `gone` while it is unplugged."""

    def __init__(self, shelf: Shelf) -> None:
        self.shelf, self.closed = shelf, False

    async def read(self) -> bytes:
        self.shelf.check(errno.EIO)
        return b"data"

    def write(self, data: bytes) -> None:
        self.shelf.check(errno.EIO)
        self.shelf.written.append(data)

    def set_baud(self, baud: int) -> None:
        self.shelf.check(errno.EIO)

    def close(self) -> None:
        self.closed = True
        self.shelf.closed += 1


class Bus:
    """A register bus on the same shelf."""

    def __init__(self, shelf: Shelf) -> None:
        self.shelf = shelf

    def read(self, address: int, register: int, length: int) -> bytes:
        self.shelf.check(self.shelf.bus_error)
        return bytes(length)

    def write(self, address: int, register: int, value: int) -> None:
        self.shelf.check(self.shelf.bus_error)

    def close(self) -> None:
        self.shelf.closed += 1


class Shelf:
    """Whether the device is plugged in, and what was done with it."""

    def __init__(self) -> None:
        self.there, self.opened, self.closed = False, 0, 0
        self.bus_error = errno.ENODEV
        self.written: list[bytes] = []

    def check(self, number: int) -> None:
        if not self.there:
            raise OSError(number, "unplugged")

    def open_line(self) -> UnpluggedLine:
        if not self.there:
            raise DeviceMissing("no such port")
        self.opened += 1
        return UnpluggedLine(self)

    async def open_transport(self) -> UnpluggedLine:
        return self.open_line()

    def open_bus(self) -> Bus:
        if not self.there:
            raise DeviceMissing("no such bus")
        self.opened += 1
        return Bus(self)


@pytest.mark.parametrize("kind", ["port", "transport"])
async def test_a_line_is_opened_when_it_is_there_and_again_after_it_went(kind: str) -> None:
    shelf = Shelf()
    line: AwaitedPort | AwaitedTransport
    line = (
        AwaitedPort(None, shelf.open_line) if kind == "port" else AwaitedTransport(None, shelf.open_transport)
    )
    line.write(b"into the void")
    with pytest.raises(OSError, match="no such port"):
        await line.read()
    shelf.there = True
    assert await line.read() == b"data"
    line.write(b"hello")
    shelf.there = False
    with pytest.raises(OSError, match="unplugged"):
        await line.read()
    with pytest.raises(OSError, match="no such port"):
        await line.read()
    shelf.there = True
    assert await line.read() == b"data"
    line.close()
    assert (shelf.opened, shelf.closed, shelf.written) == (2, 2, [b"hello"])


def test_a_port_that_goes_while_it_is_written_to_is_no_error_of_the_writer() -> None:
    shelf = Shelf()
    shelf.there = True
    port = AwaitedPort(shelf.open_line(), shelf.open_line)
    shelf.there = False
    port.set_baud(9600)
    port.write(b"lost")
    port.write(b"lost too")
    assert (shelf.closed, shelf.written) == (1, [])


def test_a_bus_is_opened_for_a_transaction_and_anew_once_its_adapter_went() -> None:
    shelf = Shelf()
    bus = AwaitedBus(None, shelf.open_bus)
    with pytest.raises(OSError, match="no such bus"):
        bus.read(0x68, 0, 1)
    shelf.there = True
    assert bus.read(0x68, 0, 3) == bytes(3)
    bus.write(0x68, 1, 2)
    shelf.there = False
    with pytest.raises(OSError, match="unplugged"):
        bus.write(0x68, 1, 2)
    shelf.there = True
    assert bus.read(0x68, 0, 1) == bytes(1)
    assert (shelf.opened, shelf.closed) == (2, 1)


def test_a_chip_that_does_not_answer_leaves_the_bus_open() -> None:
    shelf = Shelf()
    shelf.there, shelf.bus_error = True, errno.ENXIO
    bus = AwaitedBus(shelf.open_bus(), shelf.open_bus)
    shelf.there = False
    with pytest.raises(OSError, match="unplugged"):
        bus.read(0x68, 0, 1)
    shelf.there = True
    bus.read(0x68, 0, 1)
    assert (shelf.opened, shelf.closed) == (1, 0)


def test_only_what_is_missing_is_waited_for() -> None:
    shelf = Shelf()
    assert opened_if_there(shelf.open_line) is None

    def misspelt() -> UnpluggedLine:
        raise ConfigError("no such kind of port")

    with pytest.raises(ConfigError, match="no such kind"):
        opened_if_there(misspelt)


# ---------------- Which ports and buses are opened, by where the sensors are


class Opened:
    """Anything that can be opened; remembers that it was."""

    def __init__(self, name: str, names: list[str]) -> None:
        names.append(name)

    def close(self) -> None:
        """Nothing to give back."""


def opened(sense: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], hardware.Hardware]:
    names: list[str] = []

    async def transport(*_: object) -> Opened:
        return Opened("autopilot", names)

    async def camera(*_: object, waits: bool) -> Opened:
        return Opened("camera", names)

    monkeypatch.setattr(hardware, "open_transport", transport)
    monkeypatch.setattr(hardware, "keep_camera", camera)
    monkeypatch.setattr(hardware, "open_bus", lambda bus: Opened(bus, names))
    monkeypatch.setattr(hardware, "SerialPort", lambda port, baud: Opened(port, names))
    # an address where no companion of this machine is: two do not share one
    link = {"connection": "udpin:127.0.0.1:1"}
    config = validate(CompanionConfig, {"sense": sense, "link": link}, "test")

    async def main() -> hardware.Hardware:
        async with hardware.open_hardware(config) as found:
            return found

    return names, asyncio.run(main())


def test_our_boards_are_opened_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    names, found = opened({}, monkeypatch)
    defaults = SenseConfig()
    assert names == ["autopilot", defaults.imu.bus, defaults.gps.port, defaults.range.port, "camera"]
    assert None not in (found.imu_bus, found.gps_port, found.range_port)


def test_no_board_is_opened_when_the_autopilots_sensors_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    names, found = opened({"source": "autopilot"}, monkeypatch)
    assert names == ["autopilot", "camera"]
    assert (found.imu_bus, found.gps_port, found.range_port) == (None, None, None)


def test_the_ultrasonic_alone_may_be_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    sense = {"source": "autopilot", "autopilot": {"range_source": "boards"}}
    names, found = opened(sense, monkeypatch)
    assert names == ["autopilot", SenseConfig().range.port, "camera"]
    assert found.range_port is not None


# ---------------- What is told of a serial port that is not there, in virtual time

MISSING = "serial port /dev/ttyAMA0: cannot be opened"
PLUGGED_IN_S = 6.5


class PortPluggedInLate:
    """One that is not there before `PLUGGED_IN_S`, and says nothing then."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    async def read(self) -> bytes:
        await self._clock.sleep_until(self._clock.now_s() + 0.01)
        if self._clock.now_s() < PLUGGED_IN_S:
            raise OSError(MISSING)
        await asyncio.Event().wait()
        return b""

    def write(self, data: bytes) -> None: ...

    def set_baud(self, baud: int) -> None: ...

    def close(self) -> None: ...


@in_virtual_time
async def test_a_port_that_is_not_there_is_told_once_and_its_silence_only_when_it_is() -> None:
    told: list[tuple[float, str]] = []
    clock = Clock()

    def notify(kind: str, text: str, severity: Severity) -> None:
        del kind, severity
        told.append((clock.now_s(), text))

    camera: Any = SimpleNamespace(next=asyncio.Event().wait)
    vision: Any = None
    hardware = Hardware(
        memory_pair()[0], camera, gps_port=PortPluggedInLate(clock), range_port=PortPluggedInLate(clock)
    )
    sensing = Sensing(
        CompanionConfig(), hardware, vision, RecentSamples(),
        clock=clock, log=FlightLog(None, start_unix_s=0.0), notify=notify,
    )  # fmt: skip
    tasks = [
        asyncio.create_task(supervised(name, work, notify, lambda: True))
        for name, work in sensing.tasks().items()
    ]
    await clock.sleep_until(20.0)
    for task in tasks:
        task.cancel()
    before = sorted(text for time_s, text in told if time_s < PLUGGED_IN_S)
    assert before == [f"gps lost: {MISSING}", f"ultrasonic lost: {MISSING}"]
    after = {text for time_s, text in told if time_s > PLUGGED_IN_S}
    assert after >= {"gps is back", "ultrasonic is back", "ultrasonic: nothing received"}
    assert "NEO-6M: nothing received: check its power and wiring" in after


@in_virtual_time
async def test_a_spike_of_the_autopilots_rangefinder_is_kept_out_as_one_of_our_own_is() -> None:
    samples = RecentSamples()
    sensing = vision_task(SimpleNamespace(next=asyncio.Event().wait), samples, lambda *_: None)
    taken = list[float | None]()
    for k, distance_m in enumerate((2.0, 2.0, 0.4, 1.95, 1.9)):
        sensing.take_samples([RangeSample(0.05 * k, distance_m)])
        taken.append(None if sensing.last_range is None else sensing.last_range.distance_m)
    assert taken == [None, 2.0, 2.0, 1.95, 1.9]
    assert [sample.distance_m for sample in samples.range] == [2.0, 1.95, 1.9]


# ---------------- The app's own vision task on a camera that is lost and comes back, in virtual time

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
PAD = load_pad("moving_1300")
ABOVE_IT = ScenePose((0.0, 0.0, -2.3), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -0.3), 0.0)
LOST_S, FOUND_S = 1.0, 2.5


def vision_task(
    source: Any, samples: RecentSamples, notify: Notify, *, vision: Any = None, **settings: Any
) -> Sensing:
    """The app's sensing, of which a test runs the camera's task."""
    config = CompanionConfig.model_validate(settings)
    vision = vision or Vision(PAD, CAMERA, VEHICLE, config.sense.vision)
    return Sensing(
        config, Hardware(memory_pair()[0], source), vision, samples,
        clock=Clock(), log=FlightLog(None, start_unix_s=0.0), notify=notify,
    )  # fmt: skip


@in_virtual_time
async def test_the_pad_is_seen_again_and_people_are_reported_when_the_camera_comes_back() -> None:
    told = list[tuple[float, str, str, str]]()
    samples, problems = RecentSamples(), dict[float, str | None]()
    clock = Clock()
    sensing = vision_task(
        over_the_pad(unplugged_from_s=LOST_S, until_s=FOUND_S),
        samples,
        lambda kind, text, severity: told.append((clock.now_s(), kind, text, severity)),
    )
    tasks = [asyncio.ensure_future(work()) for work in sensing.tasks().values()]
    for time_s in (0.9, 1.5, 4.5):
        await clock.sleep_until(time_s)
        problems[time_s] = sensing.camera_problem
    for task in tasks:
        task.cancel()
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
        return self._model.render(time_s, lambda _: ABOVE_IT)

    async def next(self) -> Frame:
        await asyncio.sleep(1.0 / 30.0)
        now_s, self._count = self._clock.now_s(), self._count + 1
        if now_s < self._from_s:
            self._image = self._render(now_s)
        return Frame(now_s - 0.01, now_s, self._count, self._image)

    def close(self) -> None:
        pass


@in_virtual_time
async def test_a_picture_that_stands_still_with_new_stamps_is_no_sighting() -> None:
    told, samples = list[str](), RecentSamples()
    frozen = FrozenPicture(frozen_from_s=1.0)
    sensing = vision_task(frozen, samples, lambda _kind, text, _severity: told.append(text))
    task = asyncio.ensure_future(sensing.tasks()["camera"]())
    await Clock().sleep_until(2.0)
    task.cancel()
    times = [sighting.time_s for sighting in samples.sightings]
    assert len(times) > 10
    assert max(times) < 1.05
    assert [text.partition(": ")[2] for text in told] == ["the same image repeated"]


@in_virtual_time
async def test_before_take_off_a_look_at_the_pad_now_and_then_is_enough() -> None:
    samples, counts = RecentSamples(), list[int]()
    clock = Clock()
    sensing = vision_task(FrozenPicture(frozen_from_s=math.inf), samples, lambda *_: None)
    sensing.on_ground = lambda: clock.now_s() < 2.0
    task = asyncio.ensure_future(sensing.tasks()["camera"]())
    for time_s in (2.0, 4.0):
        await clock.sleep_until(time_s)
        counts.append(sensing.frame_count)
    task.cancel()
    times = [sighting.time_s for sighting in samples.sightings]
    on_ground = sum(time_s < 1.95 for time_s in times)
    assert 8 <= on_ground <= 11
    assert len(times) - on_ground > 3 * on_ground
    assert counts[0] > 3 * on_ground  # every frame is judged and counts all the same


@pytest.mark.parametrize("expected", [False, True])
@in_virtual_time
async def test_while_it_is_neither_seen_nor_expected_the_pad_is_looked_for_less_often(expected: bool) -> None:
    looks = list[float]()

    class Blind:
        def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult:
            del prior
            looks.append(frame.time_s)
            return VisionResult(None, {"F": 0, "M": 0, "C": 0}, searched_whole_frame=True)

    class Expecting(RecentSamples):
        def pad_prior(self, time_s: float) -> PadPrior | None:
            return PadPrior(time_s, (0.0, 0.0, 1.0), (0.0, 0.0, 5.0) if expected else None)

    clock = Clock()
    frames = FrozenPicture(frozen_from_s=math.inf)
    sensing = vision_task(frames, Expecting(), lambda *_: None, vision=Blind())
    sensing.on_ground = lambda: False
    task = asyncio.ensure_future(sensing.tasks()["camera"]())
    await clock.sleep_until(1.0)
    task.cancel()
    apart_s = np.diff(looks)
    # a frame and the time that vision is modelled to take: 58 ms
    assert (apart_s.min() >= SEARCH_LOOK_S) == (not expected)
    assert apart_s.max() < 0.1


def over_the_pad(*, unplugged_from_s: float, until_s: float) -> KeptCamera:
    """A camera two metres over the pad that is unplugged for a while."""
    model = CameraModel(CAMERA, VEHICLE, PAD, ImagingSettings(), np.random.default_rng(5))
    clock = Clock()

    def show(frame: Frame) -> Frame:
        if unplugged_from_s <= clock.now_s() < until_s:
            raise OSError("unplugged")
        return replace(frame, image=model.render(frame.time_s, lambda _: ABOVE_IT))

    async def open_it() -> LiveSource:
        if unplugged_from_s <= clock.now_s() < until_s:
            raise OSError("no camera at /dev/video0")
        return ScriptedCamera(show)

    return KeptCamera(ScriptedCamera(show), open_it, patience_with(CAMERA, "device"))


@in_virtual_time
async def test_the_check_says_how_the_camera_does() -> None:
    said, transport = list[Say](), memory_pair()[0]
    frames = over_the_pad(unplugged_from_s=1e6, until_s=1e6)
    check = PadCheck(CompanionConfig(), Hardware(transport, frames), said.append, linked=False)
    with suppress(TimeoutError):
        await asyncio.wait_for(check.run(), 4.0)
    (line,) = [line.text for line in said if line.text.startswith("camera")]
    rate, rest = line.split(" frames/s looked at, ")
    assert 25.0 < float(rate.removeprefix("camera: ")) < 32.0
    assert rest == "20 ms old on arrival; the driver says: exposure 4.00 ms, gain 2"


# ---------------- A beacon's fixes

BEACON = PadBeacon(5.0, 47.0, 8.0, 400.0, (1.0, 0.0, 0.0), 1.5, fix_time_s=100.0)


class ObservedSamples(RecentSamples):
    """Keeps what is no camera's."""

    def __init__(self) -> None:
        super().__init__()
        self.observed: list[PadObservation] = []

    def observe(self, observation: PadObservation) -> None:
        self.observed.append(observation)


@pytest.mark.parametrize(("use", "taken"), [("track", [5.0, 7.0, 8.0, 9.0]), ("search", [])])
@in_virtual_time
async def test_each_fix_of_a_beacon_is_taken_once_where_it_is_to_be(use: str, taken: list[float]) -> None:
    samples, camera = ObservedSamples(), SimpleNamespace(next=asyncio.Event().wait)
    sensing = vision_task(
        camera, samples, lambda *_: None, vision=SimpleNamespace(), estimate={"pad": {"beacon": use}}
    )
    sensing.take_beacon(None)
    for time_s, fix_s in ((5.0, 100.0), (5.0, 100.0), (6.0, 100.0), (7.0, 102.0), (8.0, 0.0), (9.0, 0.0)):
        sensing.take_beacon(replace(BEACON, time_s=time_s, fix_time_s=fix_s))
    assert [observation.time_s for observation in samples.observed] == taken
