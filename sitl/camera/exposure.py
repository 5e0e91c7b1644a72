"""From light to grey values: what exposure, lens and sensor do to the simulated camera's image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from companion.base.encoding import grey_of_light
from companion.base.geometry import FloatArray
from companion.config import CameraConfig, StrictModel
from sitl.camera.light import LightSettings
from sitl.camera.textures import PAD_WHITE, GreyImage

LONGEST_KERNEL_PX: Final = 2.5


class DirtSettings(StrictModel):
    """Dust and dried drops on the lens: soft dark blobs that stay where they are in the image."""

    blobs: int = Field(default=12, ge=1, le=200, description="How many")
    largest_share: float = Field(
        default=0.08,
        gt=0.005,
        le=0.5,
        description="Width of the largest blob as a share of the image's width",
    )
    opacity: float = Field(
        default=0.7, gt=0.0, le=1.0, description="Opacity of the most opaque blob's middle"
    )


# ---------------------------------------------------------------- sensor chip
# The camera's sensor: how long it exposes and how far it amplifies, and what that does to grey values.
#
# An incident-light meter's rule (ISO 2720: N^2 / t = E S / C with C = 250, S = 100, f/2) exposes a white
# sheet rightly when illuminance times exposure is 10 lux s. In less light an automatic exposure first takes
# longer, which smears, and then amplifies, which brings out noise: shot noise, whose variance goes with the
# light, and the amplifier's own.
#
# Noise that depends on the grey value is added where it does not: grey values are put through a table f with
# f' = 1 / sigma, constant noise is added, and the result is put through the inverse table (Anscombe's idea).


class ExposureSettings(StrictModel):
    """What an automatic exposure may do; with `automatic` off, `camera.exposure_s` and `gain` stay."""

    automatic: bool = Field(
        default=True, description="Exposure follows the mean brightness of the last pictures"
    )
    shortest_s: float = Field(default=0.0001, gt=0.0, le=0.03, description="Shortest exposure")
    longest_s: float = Field(
        default=0.01, gt=0.0, le=0.03, description="Longest exposure; in less light the gain rises"
    )
    gain: float = Field(default=1.0, ge=1.0, le=64.0, description="Fixed gain, if exposure is not automatic")
    most_gain: float = Field(
        default=16.0, ge=1.0, le=64.0, description="Largest gain, if exposure is automatic"
    )

    @model_validator(mode="after")
    def _shortest_first(self) -> ExposureSettings:
        if self.shortest_s > self.longest_s:
            raise ValueError(
                f"shortest_s is {self.shortest_s:g}; expected at most longest_s, {self.longest_s:g}"
            )
        return self


class ImagingSettings(StrictModel):
    """What the lens and the sensor do to the image, beyond the calibrated geometry.

    Exposure and readout default to the camera's own; a scenario may differ from what the app believes.
    The defaults of the lens are those of a small f/2 lens of 3 mm (a Raspberry Pi's camera): 1.5 mm
    aperture, focused at 1.5 m.
    """

    exposure_s: float | None = Field(default=None, ge=0.0, le=0.05)
    readout_s: float | None = Field(default=None, ge=0.0, le=0.05)
    noise_grey: float = Field(default=3.0, ge=0.0, le=50.0)
    lens_blur_px: float = Field(default=0.45, ge=0.0, le=5.0)
    aperture_m: float = Field(default=0.0015, ge=0.0, le=0.02)
    focus_m: float = Field(default=1.5, gt=0.01, le=100.0)
    vignette: float = Field(default=0.25, ge=0.0, le=1.0)
    gain: float = Field(default=1.0, gt=0.0, le=4.0)
    motion_blur: bool = True
    light: LightSettings | None = None
    exposure: ExposureSettings = ExposureSettings()
    dirt: DirtSettings | None = None


def motion_blur(image: GreyImage, right_px: float, down_px: float) -> GreyImage:
    """Smear the image along a straight stroke, centred, so that nothing moves on average.

    A long stroke is a short one applied to the mean of two copies, as often as needed: that costs two
    additions a doubling instead of a kernel of the stroke's length. Copies are moved by whole pixels and
    the short stroke takes up what remains.
    """
    while max(abs(right_px), abs(down_px)) > LONGEST_KERNEL_PX:
        x, y = round(0.25 * right_px), round(0.25 * down_px)
        image = _mean_of_two(image, x, y)
        right_px, down_px = right_px - 2.0 * x, down_px - 2.0 * y
    if max(abs(right_px), abs(down_px)) < 0.3:
        return image
    return np.asarray(cv2.filter2D(image, -1, _stroke_kernel(right_px, down_px)), dtype=np.uint8)


def _mean_of_two(image: GreyImage, x: int, y: int) -> GreyImage:
    """Mean of the image moved by (x, y) and by (-x, -y) whole pixels; edges repeat."""
    ax, ay = abs(x), abs(y)
    rows, columns = image.shape
    wide = cv2.copyMakeBorder(image, ay, ay, ax, ax, cv2.BORDER_REPLICATE)
    a = wide[ay + y : ay + y + rows, ax + x : ax + x + columns]
    b = wide[ay - y : ay - y + rows, ax - x : ax - x + columns]
    return np.asarray(cv2.addWeighted(a, 0.5, b, 0.5, 0.0), dtype=np.uint8)


def _stroke_kernel(right_px: float, down_px: float) -> FloatArray:
    """Kernel (n, n) of a line through its middle; each sample shared among its four neighbours."""
    half = math.ceil(0.5 * max(abs(right_px), abs(down_px)))
    size, samples = 2 * half + 1, 9
    kernel = [[0.0] * size for _ in range(size)]
    for k in range(samples):
        t = (k + 0.5) / samples - 0.5
        x, y = half + t * right_px, half + t * down_px
        j, i = min(int(x), 2 * half - 1), min(int(y), 2 * half - 1)
        fx, fy = x - j, y - i
        kernel[i][j] += (1 - fx) * (1 - fy)
        kernel[i][j + 1] += fx * (1 - fy)
        kernel[i + 1][j] += (1 - fx) * fy
        kernel[i + 1][j + 1] += fx * fy
    return np.array(kernel) / samples


def vignette(camera: CameraConfig, settings: ImagingSettings, rng: np.random.Generator) -> GreyImage | None:
    """How much light (0..255) reaches each pixel: falls with the square of the distance from the axis.

    Dirt takes its share of it.
    """
    if settings.vignette == 0.0 and settings.gain == 1.0 and settings.dirt is None:
        return None
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    r2 = (x - camera.cx_px) ** 2 + (y - camera.cy_px) ** 2
    corner2 = camera.cx_px**2 + camera.cy_px**2
    light = 255.0 * (1.0 - settings.vignette * r2 / corner2)
    if settings.dirt is not None:
        light *= _transmission(camera, settings.dirt, rng)
    return np.asarray(light.clip(0, 255), dtype=np.uint8)


def _transmission(camera: CameraConfig, dirt: DirtSettings, rng: np.random.Generator) -> FloatArray:
    """What dirt lets through (rows, columns): each blob a Gauss bell as wide as four standard deviations."""
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    clear = np.ones(x.shape)
    for _ in range(dirt.blobs):
        right, down, size, opacity = rng.uniform(0.0, 1.0, 4).tolist()
        std_px = 0.25 * camera.width_px * dirt.largest_share * (0.3 + 0.7 * size)
        r2 = (x - right * camera.width_px) ** 2 + (y - down * camera.height_px) ** 2
        clear *= 1.0 - dirt.opacity * (0.3 + 0.7 * opacity) * np.exp(-0.5 * r2 / std_px**2)
    return clear


class NoiseBank:
    """Noise of one strength, four images large: each picture takes a window of it at a random place."""

    def __init__(self, camera: CameraConfig, noise_grey: float, rng: np.random.Generator) -> None:
        """`noise_grey` is its standard deviation; `rng` draws it, and each picture's window."""
        self._rng = rng
        noise = rng.normal(128.0, noise_grey, (2 * camera.height_px, 2 * camera.width_px))
        self._about_128 = np.asarray(np.rint(noise).clip(0, 255), dtype=np.uint8)
        # sums of bytes that saturate cost a third of a weighted sum
        self._brighter = np.maximum(self._about_128, 128) - 128
        self._darker = 128 - np.minimum(self._about_128, 128)

    def add(self, image: GreyImage) -> None:
        """Noise to an image (rows, columns)."""
        window = self._window(image)
        cv2.add(image, self._brighter[window], dst=image)
        cv2.subtract(image, self._darker[window], dst=image)

    def add_times(self, factor: float, image: GreyImage) -> None:
        """The same, so many times as strong."""
        noise = self._about_128[self._window(image)]
        cv2.addWeighted(image, 1.0, noise, factor, -128.0 * factor, dst=image)

    def _window(self, image: GreyImage) -> tuple[slice, slice]:
        rows, columns = image.shape
        y, x = self._rng.integers(0, (rows, columns)).tolist()
        return slice(y, y + rows), slice(x, x + columns)


RIGHT_EXPOSURE_LUX_S: Final = 10.0
METERED_GREY: Final = 112.0
# share of the way to the right exposure that is gone from frame to frame, in stops
ADAPTION: Final = 0.25
# of a white pixel's variance at gain 1, what the light has no part in
DARK_SHARE: Final = 0.1
GREYS: Final = np.arange(256.0)


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


@lru_cache(maxsize=1)  # in daylight the gain stays
def levelled(
    white_std_grey: float, gain: float, encoding: Literal["srgb", "linear"] | tuple[float, ...] = "linear"
) -> tuple[GreyImage, GreyImage, float]:
    """Tables (256,) to a scale on which the noise is the same everywhere, and from it to encoded grey values.

    And how much the noise is there; it is `noise_std_grey` off it.
    """
    slope = 1.0 / noise_std_grey(white_std_grey, gain)
    scale = np.concatenate(([0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]))))
    stretch = 255.0 / scale[-1]
    there = np.rint(scale * stretch)
    back = np.rint(grey_of_light(encoding, np.interp(GREYS, scale * stretch, GREYS) / 255.0))
    return there.astype(np.uint8), back.astype(np.uint8), float(stretch)


def through(table: GreyImage, image: GreyImage, out: GreyImage) -> GreyImage:
    """Each grey value by a table (256,); `out` may be the image itself."""
    return np.asarray(cv2.LUT(image, table, dst=out), dtype=np.uint8)


def add_light(image: GreyImage, light_grey: NDArray[np.float32]) -> None:
    """More light (rows, columns), not negative, up to what the sensor holds."""
    cv2.add(image, np.minimum(light_grey, 255.0).astype(np.uint8), dst=image)
