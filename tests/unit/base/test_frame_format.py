"""Frames as bytes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.formats.frame_format import HEADER_SIZE, pack_frame, unpack_header, unpack_image

IMAGE = np.arange(12, dtype=np.uint8).reshape(3, 4)


@pytest.mark.parametrize("image", [IMAGE, np.dstack([IMAGE, IMAGE + 20, IMAGE + 40])], ids=["grey", "colour"])
def test_a_frame_comes_back_as_it_went(image: NDArray[np.uint8]) -> None:
    data = pack_frame(image, 2**32 + 5, 123.456789)
    header = unpack_header(data[:HEADER_SIZE])
    assert (header.width_px, header.height_px, header.size) == (4, 3, image.size)
    assert (header.sequence, header.time_s) == (5, 123.456789)
    assert np.array_equal(unpack_image(header, data[HEADER_SIZE:]), image)


def test_a_time_that_is_not_known_is_none() -> None:
    assert unpack_header(pack_frame(IMAGE, 0, None)[:HEADER_SIZE]).time_s is None
    # not to be mistaken for it: the first instant of a clock
    assert unpack_header(pack_frame(IMAGE, 0, 0.0)[:HEADER_SIZE]).time_s == 1e-9


def test_the_layout_is_the_documented_one() -> None:
    data = pack_frame(IMAGE, 7, 1.0)
    assert data[:4] == b"CFRM"
    assert data[4:12] == bytes((1, 1, 0, 0, 4, 0, 3, 0))
    assert data[12:24] == bytes((7, 0, 0, 0, 12, 0, 0, 0, 0, 0, 0, 0))
    assert data[24:32] == (10**9).to_bytes(8, "little")
    assert data[32:] == IMAGE.tobytes()


@pytest.mark.parametrize(
    ("place", "value", "text"),
    [
        (0, b"X", "not a frame"),
        (4, b"\x02", "version 2, expected 1"),
        (5, b"\x03", "format 3"),
        (8, b"\x00\x00", "0x3, expected 1 to 8192"),
        (10, b"\xff\xff", "4x65535, expected 1 to 8192"),
        (16, b"\x0d", "13 bytes, expected 12"),
    ],
)
def test_what_is_not_a_known_frame_is_refused(place: int, value: bytes, text: str) -> None:
    data = bytearray(pack_frame(IMAGE, 0, 0.0)[:HEADER_SIZE])
    data[place : place + len(value)] = value
    with pytest.raises(ValueError, match=text):
        unpack_header(bytes(data))


def test_an_image_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(3, 4, 2\), expected"):
        pack_frame(np.dstack([IMAGE, IMAGE]), 0, 0.0)


def test_too_few_bytes_are_refused() -> None:
    data = pack_frame(IMAGE, 0, 0.0)
    with pytest.raises(ValueError, match="32 bytes"):
        unpack_header(data[:31])
    with pytest.raises(ValueError, match="reshape"):
        unpack_image(unpack_header(data[:HEADER_SIZE]), data[HEADER_SIZE:-1])
