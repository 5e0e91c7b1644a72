"""The camera's sensor: how long it exposes and how far it amplifies, and what that does to grey values.

An incident-light meter's rule (ISO 2720: N^2 / t = E S / C with C = 250, S = 100, f/2) exposes a white sheet
rightly when illuminance times exposure is 10 lux s. In less light an automatic exposure first takes longer,
which smears, and then amplifies, which brings out noise: shot noise, whose variance goes with the light, and
the amplifier's own.

Noise that depends on the grey value is added where it does not: grey values are put through a table f with
f' = 1 / sigma, constant noise is added, and the result is put through the inverse table (Anscombe's idea).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from companion.base.encoding import Encoding, grey_of_light
from companion.base.geometry import FloatArray
from companion.config import StrictModel
from sitl.camera.textures import PAD_WHITE, GreyImage

RIGHT_EXPOSURE_LUX_S: Final = 10.0
METERED_GREY: Final = 112.0
# share of the way to the right exposure that is gone from frame to frame, in stops
ADAPTION: Final = 0.25
# of a white pixel's variance at gain 1, what the light has no part in
DARK_SHARE: Final = 0.1
GREYS: Final = np.arange(256.0)


class ExposureSettings(StrictModel):
    """What an automatic exposure may do; with `automatic` off, `camera.exposure_s` and `gain` stay."""

    automatic: bool = Field(default=True, description="Follows the mean of the last pictures")
    shortest_s: float = Field(default=0.0001, gt=0.0, le=0.03, description="Shutter")
    longest_s: float = Field(default=0.01, gt=0.0, le=0.03, description="Shutter; then it amplifies")
    gain: float = Field(default=1.0, ge=1.0, le=64.0, description="When it is not automatic")
    most_gain: float = Field(default=16.0, ge=1.0, le=64.0, description="When it is")

    @model_validator(mode="after")
    def _shortest_first(self) -> ExposureSettings:
        if self.shortest_s > self.longest_s:
            raise ValueError(
                f"shortest_s is {self.shortest_s:g}; expected at most longest_s, {self.longest_s:g}"
            )
        return self


@dataclass(frozen=True, slots=True)
class Exposure:
    """One frame's exposure (s) and gain."""

    exposure_s: float
    gain: float


class AutoExposure:
    """Chooses each frame's exposure from the picture before."""

    def __init__(self, settings: ExposureSettings, fixed_s: float, illuminance_lux: float) -> None:
        """`fixed_s` is the exposure when it is not automatic; else it starts adapted to the light."""
        self._settings = settings
        self._lux = illuminance_lux
        self._wanted_s = RIGHT_EXPOSURE_LUX_S / illuminance_lux
        self.now = self._split() if settings.automatic else Exposure(fixed_s, settings.gain)

    @property
    def brightness(self) -> float:
        """How much brighter than a right exposure has it the picture will be."""
        return self._lux * self.now.exposure_s * self.now.gain / RIGHT_EXPOSURE_LUX_S

    def look(self, image: GreyImage) -> None:
        """Take the last picture into account."""
        if not self._settings.automatic:
            return
        s, mean = self._settings, max(float(cv2.mean(image)[0]), 1.0)
        # a saturated picture underestimates the error: steps are bounded
        step = min(2.0, max(0.5, METERED_GREY / mean)) ** ADAPTION
        self._wanted_s = min(s.longest_s * s.most_gain, max(s.shortest_s, self._wanted_s * step))
        self.now = self._split()

    def _split(self) -> Exposure:
        """Shutter first, then gain."""
        s = self._settings
        exposure_s = min(s.longest_s, max(s.shortest_s, self._wanted_s))
        return Exposure(exposure_s, min(s.most_gain, max(1.0, self._wanted_s / exposure_s)))


def response(brightness: float, veil: float) -> GreyImage:
    """Table (256,): a grey value of a right exposure to that of this one; 255 is full."""
    scene = GREYS * (1.0 - veil) + PAD_WHITE * veil
    return np.asarray(np.rint((brightness * scene).clip(0.0, 255.0)), dtype=np.uint8)


def noise_std_grey(white_std_grey: float, gain: float) -> FloatArray:
    """Standard deviation (256,) of a pixel by its grey value; `white_std_grey` is a white one's at gain 1."""
    shot = (1.0 - DARK_SHARE) * gain * GREYS / PAD_WHITE
    return np.asarray(white_std_grey * np.sqrt(DARK_SHARE * gain**2 + shot))


def levelled(std_grey: FloatArray, encoding: Encoding = "linear") -> tuple[GreyImage, GreyImage, float]:
    """Tables (256,) to a scale on which the noise is the same everywhere, and from it to encoded grey values.

    And how much the noise is there.
    """
    slope = 1.0 / std_grey
    scale = np.concatenate(([0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]))))
    stretch = 255.0 / scale[-1]
    there = np.rint(scale * stretch)
    back = np.rint(grey_of_light(encoding, np.interp(GREYS, scale * stretch, GREYS) / 255.0))
    return there.astype(np.uint8), back.astype(np.uint8), float(stretch)


def through(table: GreyImage, image: GreyImage) -> GreyImage:
    """An image through a table."""
    return np.asarray(cv2.LUT(image, table), dtype=np.uint8)


def add_light(image: GreyImage, light_grey: NDArray[np.float32]) -> GreyImage:
    """More light, up to what the sensor holds."""
    return np.asarray(cv2.add(image, np.asarray(light_grey.clip(0.0, 255.0), np.uint8)), dtype=np.uint8)
