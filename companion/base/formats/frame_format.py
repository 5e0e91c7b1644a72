"""Frames on a local socket, from whatever takes them (a simulator, a camera's own program) to the app.

A stream socket, unix or TCP on the loopback; the one who has the frames listens. One message a frame, all
numbers little-endian:

    offset  size  field
    0       4     magic "CFRM"
    4       1     version of this layout: 1
    5       1     format: 1 = 8-bit grey, 2 = 8-bit blue, green, red; rows from the top, no padding
    6       2     zero
    8       2     width (px)
    10      2     height (px)
    12      4     sequence number of the frame, counts what was dropped too
    16      4     size of the image that follows (bytes)
    20      4     zero
    24      8     time (ns): CLOCK_MONOTONIC at mid-exposure of the image's middle row; 0: not known
    32      size  the image

docs/reference/camera-frames.md is this for users. Pure.
"""

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

_HEADER: Final = struct.Struct("<4sBBHHHIIIQ")
MAGIC: Final = b"CFRM"
VERSION: Final = 1
FORMAT_GREY8: Final = 1
FORMAT_BGR8: Final = 2
HEADER_SIZE: Final = _HEADER.size
_CHANNELS: Final = {FORMAT_GREY8: 1, FORMAT_BGR8: 3}
# larger than any camera in use; a width of 60000 is a header that is none
LARGEST_SIDE_PX: Final = 8192
_NS: Final = 1e9


@dataclass(frozen=True, slots=True)
class FrameHeader:
    """What precedes an image; `time_s` is None when the sender does not know when it was exposed."""

    width_px: int
    height_px: int
    channels: int
    sequence: int
    time_s: float | None

    @property
    def size(self) -> int:
        return self.width_px * self.height_px * self.channels


def pack_frame(image: NDArray[np.uint8], sequence: int, time_s: float | None) -> bytes:
    """The message of one image: grey (height, width) or blue, green, red (height, width, 3).

    `time_s` is CLOCK_MONOTONIC at mid-exposure, None when that is not known.

    Raises:
        ValueError: the image has another shape.
    """
    if image.ndim != 2 and (image.ndim != 3 or image.shape[2] != 3):
        raise ValueError(f"image of shape {image.shape}, expected (height, width) or (height, width, 3)")
    height, width = image.shape[:2]
    pixel_format = FORMAT_GREY8 if image.ndim == 2 else FORMAT_BGR8
    time_ns = 0 if time_s is None else max(1, round(time_s * _NS))
    header = _HEADER.pack(
        MAGIC, VERSION, pixel_format, 0, width, height, sequence & 0xFFFFFFFF, image.size, 0, time_ns
    )
    return header + image.tobytes()


def unpack_header(data: bytes) -> FrameHeader:
    """Read a header of `HEADER_SIZE` bytes.

    Raises:
        ValueError: not a frame, or of a version, format or size that is not known here.
    """
    if len(data) != HEADER_SIZE:
        raise ValueError(f"a frame's header has {HEADER_SIZE} bytes, found {len(data)}")
    magic, version, pixel_format, _, width, height, sequence, size, _, time_ns = _HEADER.unpack(data)
    if magic != MAGIC:
        raise ValueError(f"not a frame: begins with {magic!r}, expected {MAGIC!r}")
    if version != VERSION:
        raise ValueError(f"frames of version {version}, expected {VERSION}")
    channels = _CHANNELS.get(pixel_format)
    if channels is None:
        raise ValueError(
            f"frame format {pixel_format}, expected {FORMAT_GREY8} (grey) or {FORMAT_BGR8} (blue, green, red)"
        )
    if not (0 < width <= LARGEST_SIDE_PX and 0 < height <= LARGEST_SIDE_PX):
        raise ValueError(f"frame of {width}x{height}, expected 1 to {LARGEST_SIDE_PX} px a side")
    header = FrameHeader(width, height, channels, sequence, time_ns / _NS if time_ns else None)
    if size != header.size:
        raise ValueError(f"frame of {width}x{height} with {size} bytes, expected {header.size}")
    return header


def unpack_image(header: FrameHeader, data: bytes | memoryview) -> NDArray[np.uint8]:
    """The image (height, width) or (height, width, 3), read-only, of the bytes after a header.

    Raises:
        ValueError: not as many bytes as the header says.
    """
    shape = (header.height_px, header.width_px)
    return np.frombuffer(data, np.uint8).reshape(shape if header.channels == 1 else (*shape, 3))
