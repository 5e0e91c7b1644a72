"""How a camera encodes light as grey values: by sRGB's curve, in proportion, or by a table of its own.

What blurs an image (lens, motion, pixels) adds light, and grey values are not proportional to light. A place
between pixels is therefore found in light: in sRGB's grey values an edge seems to lie 0.4 of its blur's sigma
farther out of the white.

Light is relative: 0 is black, 1 what gives the grey value 255.

Source: IEC 61966-2-1:1999 (sRGB), section 5.2.
"""

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray

Encoding = Literal["srgb", "linear"] | Sequence[float]
GREYS: Final = 256
FULL: Final = 255.0


def light_of_greys(encoding: Encoding) -> FloatArray:
    """Light (256,) of each grey value, rising from 0 to 1; a table's numbers are of evenly spaced greys."""
    grey = np.linspace(0.0, 1.0, GREYS)
    if encoding == "linear":
        return grey
    if encoding == "srgb":
        return np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)
    table = np.asarray(encoding, dtype=np.float64)
    return np.interp(grey, np.linspace(0.0, 1.0, len(table)), table)


def grey_of_light(encoding: Encoding, light: FloatArray) -> FloatArray:
    """Grey values (0..255, not rounded) of light; what is brighter than 1 is cut off."""
    return np.interp(light, light_of_greys(encoding), np.arange(GREYS, dtype=np.float64))


def decoding_table(encoding: Encoding) -> NDArray[np.float32]:
    return (FULL * light_of_greys(encoding)).astype(np.float32)


def encoding_table(encoding: Encoding) -> NDArray[np.uint8]:
    """Look-up table (256,) from light times 255 to grey values."""
    light = np.linspace(0.0, 1.0, GREYS)
    return np.asarray(np.rint(grey_of_light(encoding, light)), dtype=np.uint8)
