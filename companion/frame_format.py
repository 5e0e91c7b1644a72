"""Frames on a local socket, from whatever takes them (the simulator in its own process) to the app.

A unix stream socket; one message a frame, little-endian:

    offset  size  field
    0       4     magic "CFRM"
    4       2     width (px)
    6       2     height (px)
    8       1     format: 1 = 8-bit grey, rows from the top, no padding
    9       3     zero
    12      4     sequence number of the frame, counts what was dropped too
    16      4     size of the image that follows (bytes)
    20      8     time (double, s): CLOCK_MONOTONIC at mid-exposure of the image's middle row
    28      size  the image
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

_HEADER: Final = struct.Struct("<4sHHB3xIId")
MAGIC: Final = b"CFRM"
FORMAT_GREY8: Final = 1
HEADER_SIZE: Final = _HEADER.size


@dataclass(frozen=True, slots=True)
class FrameHeader:
    """What precedes an image."""

    width_px: int
    height_px: int
    sequence: int
    time_s: float

    @property
    def size(self) -> int:
        """Bytes of the image."""
        return self.width_px * self.height_px


def pack_frame(image: NDArray[np.uint8], sequence: int, time_s: float) -> bytes:
    """The message of one grey image (height, width)."""
    height, width = image.shape
    header = _HEADER.pack(MAGIC, width, height, FORMAT_GREY8, sequence & 0xFFFFFFFF, width * height, time_s)
    return header + image.tobytes()


def unpack_header(data: bytes) -> FrameHeader:
    """Read a header of `HEADER_SIZE` bytes.

    Raises:
        ValueError: not a frame, or of a format that is not known here.
    """
    if len(data) != HEADER_SIZE:
        raise ValueError(f"a frame's header has {HEADER_SIZE} bytes, found {len(data)}")
    magic, width, height, pixel_format, sequence, size, time_s = _HEADER.unpack(data)
    if magic != MAGIC:
        raise ValueError(f"not a frame: begins with {magic!r}, expected {MAGIC!r}")
    if pixel_format != FORMAT_GREY8:
        raise ValueError(f"frame format {pixel_format}, expected {FORMAT_GREY8} (8-bit grey)")
    if size != width * height:
        raise ValueError(f"frame of {width}x{height} with {size} bytes, expected {width * height}")
    return FrameHeader(width, height, sequence, time_s)


def unpack_image(header: FrameHeader, data: bytes) -> NDArray[np.uint8]:
    """The image (height, width), read-only, of the bytes after a header.

    Raises:
        ValueError: not as many bytes as the header says.
    """
    return np.frombuffer(data, np.uint8).reshape(header.height_px, header.width_px)
