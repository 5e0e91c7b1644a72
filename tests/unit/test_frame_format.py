"""Frames as bytes."""

from __future__ import annotations

import numpy as np
import pytest

from companion.frame_format import HEADER_SIZE, pack_frame, unpack_header, unpack_image

IMAGE = np.arange(12, dtype=np.uint8).reshape(3, 4)


def test_a_frame_comes_back_as_it_went() -> None:
    data = pack_frame(IMAGE, 2**32 + 5, 123.456789)
    header = unpack_header(data[:HEADER_SIZE])
    assert (header.width_px, header.height_px, header.size) == (4, 3, 12)
    assert (header.sequence, header.time_s) == (5, 123.456789)
    assert np.array_equal(unpack_image(header, data[HEADER_SIZE:]), IMAGE)


def test_the_layout_is_the_documented_one() -> None:
    data = pack_frame(IMAGE, 7, 1.0)
    assert data[:4] == b"CFRM"
    assert data[4:9] == bytes((4, 0, 3, 0, 1))
    assert data[12:20] == bytes((7, 0, 0, 0, 12, 0, 0, 0))
    assert data[28:] == IMAGE.tobytes()


@pytest.mark.parametrize(
    ("place", "value", "text"),
    [(0, b"X", "not a frame"), (8, b"\x02", "format 2"), (16, b"\x0d", "13 bytes, expected 12")],
)
def test_what_is_not_a_known_frame_is_refused(place: int, value: bytes, text: str) -> None:
    data = bytearray(pack_frame(IMAGE, 0, 0.0)[:HEADER_SIZE])
    data[place : place + 1] = value
    with pytest.raises(ValueError, match=text):
        unpack_header(bytes(data))


def test_too_few_bytes_are_refused() -> None:
    data = pack_frame(IMAGE, 0, 0.0)
    with pytest.raises(ValueError, match="28 bytes"):
        unpack_header(data[:27])
    with pytest.raises(ValueError, match="reshape"):
        unpack_image(unpack_header(data[:HEADER_SIZE]), data[HEADER_SIZE:-1])
