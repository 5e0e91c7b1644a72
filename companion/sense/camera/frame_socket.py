"""Frames from another process on a socket (`companion.base.formats.frame_format`), as a camera."""

from __future__ import annotations

import asyncio
from typing import Final

from companion.base.clock import Clock
from companion.base.errors import DeviceMissing
from companion.base.formats.frame_format import FrameHeader
from companion.base.formats.frame_stream import FrameStream
from companion.base.messages import Frame
from companion.config import CaptureConfig, ConfigError
from companion.sense.camera.reader import Newest, ReadBack, check_size, grey
from companion.sense.camera.rhythm import FrameRhythm

# a frame from another process that is further off than this was stamped by another clock than ours
EARLIEST_FOREIGN_S: Final = 0.05
OLDEST_FOREIGN_S: Final = 5.0
# after good ones, so many frames in a row of a time that cannot be right
MOST_STRANGE: Final = 30


class SocketCamera:
    """Frames from another process, grey or in colour."""

    def __init__(
        self, stream: FrameStream, camera: CaptureConfig, unstamped_latency_s: float, clock: Clock
    ) -> None:
        self._stream = stream
        self._camera = camera
        self._unstamped_latency_s = unstamped_latency_s
        self._clock = clock
        self._newest = Newest()
        self._rhythm = FrameRhythm(camera.rate_hz)
        self._task = asyncio.create_task(self._receive(), name="frames from the socket")

    @classmethod
    async def connect(cls, address: str, camera: CaptureConfig, unstamped_latency_s: float) -> SocketCamera:
        """Connect to whoever serves frames there.

        Raises:
            ConfigError: nobody does.
        """
        try:
            stream = await FrameStream.open(address)
        except OSError as error:
            raise DeviceMissing(f"sense.vision.source: {error}") from error
        except ValueError as error:
            raise ConfigError(f"sense.vision.source: {error}") from error
        return cls(stream, camera, unstamped_latency_s, Clock())

    async def next(self) -> Frame:
        return await self._newest.next()

    @property
    def held(self) -> bool:
        """A connection is parted from at once."""
        return False

    @property
    def read_back(self) -> ReadBack:
        """Of a camera in another process nothing is known."""
        return ReadBack()

    def take_notes(self) -> list[str]:
        """Nothing to say but by its frames."""
        return []

    def let_go(self) -> None:
        """The same as `close`: nothing waits."""
        self.close()

    def close(self) -> None:
        self._task.cancel()
        self._stream.close()

    async def _receive(self) -> None:
        """Frames as they come. One with a time that cannot be right is none, many in a row end them."""
        trusted, strange = False, 0
        try:
            while True:
                header = await self._stream.read_header()
                # before the image: what is of another size is not waited for
                check_size(header.width_px, header.height_px, self._camera)
                image = await self._stream.read_image(header)
                received_s = self._clock.now_s()
                if header.time_s is None and not self._rhythm.in_time(header.sequence, received_s):
                    continue
                try:
                    time_s = self._exposure_s(header, received_s)
                except ConfigError as error:
                    strange += 1
                    if not trusted:
                        raise
                    if strange >= MOST_STRANGE:
                        raise OSError(str(error)) from error
                    continue
                trusted, strange = True, 0
                self._newest.put(Frame(time_s, received_s, header.sequence, grey(image)))
        except (OSError, ConfigError) as error:
            self._newest.fail(error)

    def _exposure_s(self, header: FrameHeader, received_s: float) -> float:
        """When it was exposed on our clock; a frame without a time is as old as the settings say.

        Raises:
            ConfigError: the sender's clock is not CLOCK_MONOTONIC.
        """
        if header.time_s is None:
            return received_s - self._unstamped_latency_s
        age_s = received_s - header.time_s
        if not -EARLIEST_FOREIGN_S <= age_s <= OLDEST_FOREIGN_S:
            raise ConfigError(
                f"{self._stream.address}: a frame stamped {header.time_s:.3f} s came at {received_s:.3f} s; "
                "expected CLOCK_MONOTONIC at mid-exposure, or 0 where that is not known"
            )
        return header.time_s
