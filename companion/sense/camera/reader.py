"""A camera whose driver blocks, read by a thread of its own; the loop never waits for it.

The thread opens the device, reads it and closes it, so that a driver that hangs in any of the three hangs
alone: it is asked to stop and given up on. As a daemon it cannot keep the app from ending either.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.messages import Frame
from companion.base.signals import DRIVER_THREAD
from companion.config import CaptureConfig, ConfigError

OPENING_S: Final = 6.0
CLOSE_PATIENCE_S: Final = 1.2


@dataclass(frozen=True, slots=True)
class Shot:
    """A grey image (height, width), mid-exposure of its middle row and its arrival (s, CLOCK_MONOTONIC)."""

    time_s: float
    received_s: float
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ReadBack:
    """What the driver says of itself; None: it does not say. Gain as in `CaptureConfig.gain`."""

    exposure_s: float | None = None
    gain: float | None = None

    def __str__(self) -> str:
        """For a person."""
        exposure = (
            "exposure unknown" if self.exposure_s is None else f"exposure {1e3 * self.exposure_s:.2f} ms"
        )
        return f"{exposure}, " + ("gain unknown" if self.gain is None else f"gain {self.gain:g}")


class Device(Protocol):
    """A camera by its driver. Used by one thread; `read_back` and `notes` may be looked at by others."""

    read_back: ReadBack
    notes: deque[str]  # what a person should know, a line each; who takes them empties it

    def read(self) -> Shot:
        """Wait for the next frame.

        Raises:
            OSError: the camera is gone, or there is nothing more to come (`EndOfFrames`).
            ConfigError: its images are not of the size asked for.
        """

    def close(self) -> None:
        """Give the camera back."""


class EndOfFrames(OSError):  # noqa: N818 - it reads as what happened
    """A recording is over: the only end that is none of the camera's faults."""


# a device is made in the thread that uses it; the event is set when it is to come to an end
MakeDevice = Callable[[threading.Event], Device]


class OpeningHangs(ConfigError):  # noqa: N818 - it reads as what happens
    """A driver does not come back from being opened; `camera` is what to keep an eye on."""

    def __init__(self, camera: ThreadedCamera) -> None:
        super().__init__(f"the camera does not open within {OPENING_S:g} s: its driver hangs")
        self.camera = camera


class Newest:
    """A slot for the newest frame, or for the reason why there will be none."""

    def __init__(self) -> None:
        self._frame: Frame | None = None
        self._error: Exception | None = None
        self._arrived = asyncio.Event()

    def put(self, frame: Frame) -> None:
        """A frame; one that nobody has taken yet is dropped."""
        self._frame = frame
        self._arrived.set()

    def fail(self, error: Exception) -> None:
        """There will be no more."""
        self._error = error
        self._arrived.set()

    async def next(self) -> Frame:
        """Wait for a frame that has not been taken; raises the reason when there will be none."""
        await self._arrived.wait()
        if self._frame is not None:
            frame, self._frame = self._frame, None
            if self._error is None:
                self._arrived.clear()
            return frame
        assert self._error is not None
        raise self._error


class ThreadedCamera:
    """A `FrameSource` on a device that blocks. Made by `open`."""

    def __init__(self, make: MakeDevice) -> None:
        self._make = make
        self._loop = asyncio.get_running_loop()
        self._newest = Newest()
        self._opened: asyncio.Future[None] = self._loop.create_future()
        self._device: Device | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=DRIVER_THREAD, daemon=True)
        self._thread.start()

    @classmethod
    async def open(cls, make: MakeDevice) -> ThreadedCamera:
        """Open the device; given up meanwhile, it is closed, after a second at most.

        Raises:
            ConfigError, OSError: what its maker raised.
            OpeningHangs: it did not come back from that in time.
        """
        camera = cls(make)
        try:
            async with asyncio.timeout(OPENING_S):
                await camera._opened
        except TimeoutError as error:
            camera.let_go()
            raise OpeningHangs(camera) from error
        except BaseException:
            camera.close()  # a driver that comes back while the interpreter ends aborts the process
            raise
        return camera

    @property
    def held(self) -> bool:
        return self._thread.is_alive()

    @property
    def read_back(self) -> ReadBack:
        return ReadBack() if self._device is None else self._device.read_back

    def take_notes(self) -> list[str]:
        """What there is to say about the camera, each line once."""
        if self._device is None:
            return []
        notes = self._device.notes
        return [notes.popleft() for _ in range(len(notes))]

    async def next(self) -> Frame:
        return await self._newest.next()

    def let_go(self) -> None:
        """Have the device closed after the frame that is being read; waits for nothing."""
        self._stop.set()

    def close(self) -> None:
        """See `source.FrameSource`. Waits a second for the frame that is being read, so only at the end."""
        self.let_go()
        self._thread.join(CLOSE_PATIENCE_S)

    def _run(self) -> None:
        try:
            device = self._make(self._stop)
        except Exception as error:
            known = isinstance(error, (OSError, ConfigError))
            self._tell_loop(self._fail_opening, error if known else ConfigError(_words(error)))
            return
        try:
            self._tell_loop(self._succeed_opening, device)
            self._read_all(device)
        except Exception as error:
            # a driver may raise anything: whatever it is, there are no frames any more
            known = isinstance(error, (OSError, ConfigError))
            self._tell_loop(self._newest.fail, error if known else OSError(_words(error)))
        finally:
            with suppress(Exception):  # it is gone; how it went is of no interest
                device.close()

    def _read_all(self, device: Device) -> None:
        sequence = 0
        while not self._stop.is_set():
            shot = device.read()
            if not self._stop.is_set():
                frame = Frame(shot.time_s, shot.received_s, sequence, shot.image)
                self._tell_loop(self._newest.put, frame)
            sequence += 1

    def _succeed_opening(self, device: Device) -> None:
        self._device = device
        if not self._opened.done():
            self._opened.set_result(None)

    def _fail_opening(self, error: Exception) -> None:
        if not self._opened.done():
            self._opened.set_exception(error)

    def _tell_loop(self, function: Callable[[Any], None], argument: object) -> None:
        with suppress(RuntimeError):  # the loop has ended before us
            self._loop.call_soon_threadsafe(function, argument)


def _words(error: Exception) -> str:
    """One line for what a driver raised."""
    return " ".join(f"the camera's driver failed: {type(error).__name__}: {error}".split())


def check_size(width_px: int, height_px: int, camera: CaptureConfig) -> None:
    """Refuse images of another size.

    Raises:
        ConfigError: they are of another than was asked for, or calibrated.
    """
    if (width_px, height_px) != (camera.width_px, camera.height_px):
        raise ConfigError(
            f"camera '{camera.name}': images of {width_px}x{height_px}, "
            f"expected {camera.size_is} {camera.width_px}x{camera.height_px}"
        )


def grey(image: Any) -> NDArray[np.uint8]:
    """An image as vision takes it: (height, width); in colour it is taken for blue, green, red.

    Raises:
        ConfigError: its grey values are not of 8 bits.
    """
    array = np.asarray(image)
    if array.dtype != np.uint8:
        raise ConfigError(f"images of {8 * array.itemsize} bits a pixel ({array.dtype}); expected 8 bits")
    return array if array.ndim == 2 else np.asarray(cv2.cvtColor(array, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
