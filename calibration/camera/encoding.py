"""How a camera encodes light, by the edges of the board between its corners. Pure.

Where four squares meet, a corner stays where it is however light is encoded. So the edge between two such
corners is known, and black and white blur alike to either hand of it, in light; in grey values the white
seems larger. The encoding is the one by which edges lie where the corners have them: of the curves that are
powers of sRGB's, the one by which they are off by nothing in the median. A bend of the edges by the lens goes
as much into white as into black: at a corner the two change sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.encoding import Encoding, light_of_greys
from companion.base.geometry import FloatArray

FEWEST_VIEWS: Final = 5
# places across an edge whose pixels are averaged
BINS: Final = 10
# powers of sRGB's curve that are looked at; what is in proportion to light is nearly its 0.45th power
POWERS: Final = (0.25, 3.0)
TABLE_SIZE: Final = 33
# that much is left of any curve's error when its power is known exactly
LEAST_ERROR: Final = 0.02


@dataclass(frozen=True, slots=True)
class MeasuredEncoding:
    """What was found: a power of sRGB's curve, its standard deviation, and what that makes of the camera."""

    power: float
    power_std: float
    encoding: Encoding

    @property
    def error(self) -> float:
        """By which share the exponent may be off."""
        return max(self.power_std / self.power, LEAST_ERROR)

    @property
    def text(self) -> str:
        """For a person."""
        name = self.encoding if isinstance(self.encoding, str) else "a table"
        return f"encoding: {name} (sRGB's curve to the power of {self.power:.2f} ± {self.power_std:.2f})"


def measure_encoding(views: Sequence[FloatArray]) -> MeasuredEncoding | None:
    """The encoding by the edges' pixels of views (`edge_pixels`); None where too few of them show edges."""
    usable = [pixels for pixels in views if len(pixels)]
    if len(usable) < FEWEST_VIEWS:
        return None
    power = _power(_joined(usable))
    if power is None:
        return None
    # views are independent, edges of one view are not: each left out in turn (jackknife)
    others = [_power(_joined([*usable[:k], *usable[k + 1 :]])) for k in range(len(usable))]
    known = np.array([p for p in others if p is not None])
    n = len(known)
    std = float(np.sqrt((n - 1) / n * ((known - known.mean()) ** 2).sum()))
    return MeasuredEncoding(power, std, _encoding(_joined(usable), power, std))


def _joined(views: Sequence[FloatArray]) -> FloatArray:
    """The pixels of all views, their edges counted through."""
    firsts = np.cumsum([0] + [1 + view[:, 0].max() for view in views[:-1]])
    return np.concatenate(
        [view + np.array((first, 0.0, 0.0, 0.0)) for view, first in zip(views, firsts, strict=True)]
    )


def _power(pixels: FloatArray) -> float | None:
    """The power of sRGB's curve by which edges lie where they should, by bisection."""
    low, high = POWERS
    if not _shift_px(pixels, low) < 0.0 < _shift_px(pixels, high):
        return None
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _shift_px(pixels, middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)


def _shift_px(pixels: FloatArray, power: float) -> float:
    """How far edges lie in the white, mean over all of them."""
    return _shift_in(pixels, light_of_greys("srgb") ** power)


def _shift_in(pixels: FloatArray, light_of_grey: FloatArray) -> float:
    """The same for any curve: by the share of the way across that is white, of each edge."""
    edge, place = (
        pixels[:, 0].astype(int),
        np.clip((0.5 * BINS * (pixels[:, 1] + 1.0)).astype(int), 0, BINS - 1),
    )
    cell = edge * BINS + place
    light = light_of_grey[pixels[:, 3].astype(int)]
    count = np.bincount(cell, minlength=BINS * (edge.max() + 1)).reshape(-1, BINS)
    total = np.bincount(cell, light, minlength=count.size).reshape(-1, BINS)
    reach = np.bincount(edge, pixels[:, 2]) / np.maximum(np.bincount(edge), 1)
    whole = (count > 0).all(axis=1)
    mean = total[whole] / count[whole]
    black, white = mean[:, :1], mean[:, -1:]
    share = ((mean - black) / (white - black)).mean(axis=1)
    return float(np.median((1.0 - 2.0 * share) * reach[whole]))


def _encoding(pixels: FloatArray, power: float, std: float) -> Encoding:
    """One that has a name, where it fits as well; else a table."""
    unsure = max(2.0 * std, LEAST_ERROR)
    if abs(power - 1.0) <= unsure:
        return "srgb"
    # a straight line is no power of sRGB's curve: by where it puts the edges, in terms of a power's
    slope = (_shift_px(pixels, power * 1.05) - _shift_px(pixels, power / 1.05)) / (0.1 * power)
    if abs(_shift_in(pixels, light_of_greys("linear"))) <= unsure * abs(slope):
        return "linear"
    light = light_of_greys("srgb") ** power
    table = np.interp(np.linspace(0.0, 255.0, TABLE_SIZE), np.arange(256.0), light)
    return tuple(float(f"{each:.4g}") for each in table)
