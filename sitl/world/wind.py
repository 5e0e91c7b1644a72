"""Wind: steady, Dryden turbulence and "1-cosine" gusts, in NED (m/s, the motion of the air).

Turbulence after MIL-F-8785C, 3.7.3 (low altitude, h in feet, W20 the wind at 20 ft):
    sigma_w = 0.1 W20,  sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4,
    L_w = h,            L_u = L_v = h / (0.177 + 0.000823 h)^1.2,
taken at one height (20 ft), so that the filters are linear with constant coefficients and are stepped
exactly: their samples have the continuous spectrum's variance at any rate. The field is frozen and carried
past the vehicle by the mean wind. Along the wind is u, to its right v, down w. Near the surface the air
cannot go through it: w fades linearly below 10 ft, where the standard ends.

Shear after the same section: wind at height h is W20 ln(h / z0) / ln(20 ft / z0), z0 = 0.15 ft (landing), so
the mean given here is that at 20 ft, and half of it is left at half a metre. Gusts follow the same profile.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from companion.base.geometry import Vector3
from companion.config import StrictModel

FOOT_M: Final = 0.3048
KNOT_M_S: Final = 0.514444
# the standard's light, moderate and severe: wind at 20 ft
W20_M_S: Final = {
    "none": 0.0,
    "light": 15.0 * KNOT_M_S,
    "moderate": 30.0 * KNOT_M_S,
    "severe": 45.0 * KNOT_M_S,
}
REFERENCE_HEIGHT_FT: Final = 20.0
FADE_HEIGHT_M: Final = 10.0 * FOOT_M
ROUGHNESS_M: Final = 0.15 * FOOT_M
SHEAR_LOWEST_M: Final = 0.3
CARRIED_AT_LEAST_M_S: Final = 2.0
TURBULENCE_STEP_S: Final = 0.02
_PROFILE_AT_20_FT: Final = math.log(FOOT_M * REFERENCE_HEIGHT_FT / ROUGHNESS_M)


class GustSettings(StrictModel):
    """Discrete gusts: each rises and falls as (1 - cos) and blows roughly along the wind."""

    amplitude_m_s: float = Field(
        gt=0.0, le=15.0, description="Peak of a 1-cosine gust; gusts come at random if `gusts` is set"
    )
    duration_s: float = Field(default=3.0, ge=0.5, le=30.0, description="Duration of one gust")
    interval_s: float = Field(default=8.0, ge=1.0, le=120.0, description="Mean pause between two gusts")
    spread_deg: float = Field(
        default=45.0, ge=0.0, le=180.0, description="Largest angle between gust and mean wind"
    )


class DiscreteGust(StrictModel):
    """One gust at a known time, or the same again and again: rises and falls as (1 - cos)."""

    at_s: float = Field(ge=0.0, le=900.0, description="Begin of the gust, from the start of the simulation")
    amplitude_m_s: float = Field(gt=0.0, le=20.0, description="Peak, at 6.1 m like the mean wind")
    duration_s: float = Field(default=3.0, ge=0.2, le=60.0, description="Duration from calm to calm")
    from_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | Literal["wind"] = Field(
        default="wind", description="Where it comes from"
    )
    every_s: Annotated[float, Field(ge=1.0, le=900.0)] | None = Field(
        default=None, description="Period of repetition; none: once"
    )

    @model_validator(mode="after")
    def _one_after_another(self) -> DiscreteGust:
        if self.every_s is not None and self.every_s < self.duration_s:
            raise ValueError(
                f"every_s is {self.every_s:g}; expected at least duration_s, {self.duration_s:g}"
            )
        return self

    def speed_m_s(self, time_s: float) -> float:
        """How strongly it blows."""
        since_s = time_s - self.at_s
        if self.every_s is not None and since_s > 0.0:
            since_s %= self.every_s
        if not 0.0 < since_s < self.duration_s:
            return 0.0
        return 0.5 * self.amplitude_m_s * (1.0 - math.cos(math.tau * since_s / self.duration_s))


class WindSettings(StrictModel):
    """What blows: `mean_m_s` at 20 ft (6.1 m), `from_deg` where it comes from."""

    mean_m_s: float = Field(
        default=0.0, ge=0.0, le=20.0, description="Mean wind at 6.1 m (20 ft); less below"
    )
    from_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | Literal["random"] = Field(
        default="random", description="Direction the wind comes from"
    )
    turbulence: Literal["none", "light", "moderate", "severe"] = Field(
        default="none",
        description="Dryden turbulence after MIL-F-8785C (wind at 20 ft of 15, 30 and 45 knots)",
    )
    gusts: GustSettings | None = None
    gust: DiscreteGust | None = None


def shear(height_m: float) -> float:
    """Wind at a height over wind at 20 ft; taken as constant below 0.3 m, among grass and legs."""
    height = max(height_m, SHEAR_LOWEST_M)
    return math.log(height / ROUGHNESS_M) / _PROFILE_AT_20_FT


class DrydenTurbulence:
    """Three independent Dryden processes, sampled exactly in steps of 20 ms."""

    def __init__(self, w20_m_s: float, mean_m_s: float, rng: np.random.Generator) -> None:
        shape = 0.177 + 0.000823 * REFERENCE_HEIGHT_FT
        speed = max(mean_m_s, CARRIED_AT_LEAST_M_S)
        self.std_vertical_m_s = 0.1 * w20_m_s
        self.std_horizontal_m_s = self.std_vertical_m_s / shape**0.4
        length_m = FOOT_M * REFERENCE_HEIGHT_FT / shape**1.2
        self.time_horizontal_s = length_m / speed
        self.time_vertical_s = FOOT_M * REFERENCE_HEIGHT_FT / speed
        self._rng = rng
        self._u_decay = math.exp(-TURBULENCE_STEP_S / self.time_horizontal_s)
        self._v_filter = _second_order(self.time_horizontal_s, TURBULENCE_STEP_S)
        self._w_filter = _second_order(self.time_vertical_s, TURBULENCE_STEP_S)
        # start in the stationary distribution: x1 of unit variance, x2 of 1/2, covariance 1/2
        n = rng.standard_normal(5).tolist()
        self._u = n[0]
        self._v = (n[1], 0.5 * n[1] + 0.5 * n[2])
        self._w = (n[3], 0.5 * n[3] + 0.5 * n[4])

    def step(self) -> Vector3:
        """Velocities u, v, w (m/s) one turbulence step later."""
        n = self._rng.standard_normal(5).tolist()
        self._u = self._u_decay * self._u + math.sqrt(1.0 - self._u_decay**2) * n[0]
        self._v = _advance(self._v, self._v_filter, n[1], n[2])
        self._w = _advance(self._w, self._w_filter, n[3], n[4])
        return (
            self.std_horizontal_m_s * self._u,
            self.std_horizontal_m_s * _output(self._v),
            self.std_vertical_m_s * _output(self._w),
        )


_Filter = tuple[float, float, float, float, float]


def _second_order(time_s: float, dt_s: float) -> _Filter:
    """Exact discretisation of T x1' = -x1 + noise, T x2' = x1 - x2: decay, dt/T, and Q's Cholesky factor.

    With P the stationary covariance [[1, 1/2], [1/2, 1/2]], Q = P - F P F^T and F = e^-h [[1, 0], [h, 1]].
    """
    h = dt_s / time_s
    decay = math.exp(-h)
    e2 = decay * decay
    q11 = 1.0 - e2
    q12 = 0.5 - e2 * (h + 0.5)
    q22 = 0.5 - e2 * (h * h + h + 0.5)
    l11 = math.sqrt(q11)
    l21 = q12 / l11
    return decay, h, l11, l21, math.sqrt(max(0.0, q22 - l21 * l21))


def _advance(x: tuple[float, float], f: _Filter, n1: float, n2: float) -> tuple[float, float]:
    decay, h, l11, l21, l22 = f
    return decay * x[0] + l11 * n1, decay * (h * x[0] + x[1]) + l21 * n1 + l22 * n2


def _output(x: tuple[float, float]) -> float:
    """(1 + sqrt(3) T s) / (1 + T s)^2 in partial fractions, scaled to unit variance."""
    root3 = math.sqrt(3.0)
    return (root3 * x[0] + (1.0 - root3) * x[1]) / math.sqrt(2.0)


class Gusts:
    """A seeded row of gusts that never overlap."""

    def __init__(self, settings: GustSettings, towards_rad: float, rng: np.random.Generator) -> None:
        self._settings = settings
        self._towards_rad = towards_rad
        self._rng = rng
        self._start_s = 0.0
        self._direction_rad = 0.0
        self._draw(0.0)

    def at(self, time_s: float) -> tuple[float, float]:
        """North and east (m/s); time must not run backwards."""
        while time_s >= self._start_s + self._settings.duration_s:
            self._draw(self._start_s + self._settings.duration_s)
        if time_s <= self._start_s:
            return 0.0, 0.0
        phase = math.tau * (time_s - self._start_s) / self._settings.duration_s
        speed = 0.5 * self._settings.amplitude_m_s * (1.0 - math.cos(phase))
        return speed * math.cos(self._direction_rad), speed * math.sin(self._direction_rad)

    def _draw(self, after_s: float) -> None:
        spread = math.radians(self._settings.spread_deg)
        self._start_s = after_s + self._settings.interval_s * float(self._rng.uniform(0.5, 1.5))
        self._direction_rad = self._towards_rad + float(self._rng.uniform(-spread, spread))


class Wind:
    """The air at the vehicle."""

    def __init__(self, settings: WindSettings, rng: np.random.Generator) -> None:
        drawn = float(rng.uniform(0.0, math.tau))
        comes_from = drawn if settings.from_deg == "random" else math.radians(settings.from_deg)
        towards = comes_from + math.pi
        self._cos, self._sin = math.cos(towards), math.sin(towards)
        self._mean_m_s = settings.mean_m_s
        w20 = W20_M_S[settings.turbulence]
        self._turbulence = DrydenTurbulence(w20, settings.mean_m_s, rng) if w20 else None
        self._gusts = Gusts(settings.gusts, towards, rng) if settings.gusts else None
        self._gust = settings.gust
        from_deg = "wind" if self._gust is None else self._gust.from_deg
        self._gust_towards_rad = towards if from_deg == "wind" else math.radians(from_deg) + math.pi
        self._sample = self._next = self._turbulence.step() if self._turbulence else (0.0, 0.0, 0.0)
        self._next_s = 0.0

    def at(self, time_s: float, height_m: float) -> Vector3:
        """Wind NED (m/s) at a height (m) over the ground; time must not run backwards."""
        profile = shear(height_m)
        along, across, down = profile * self._mean_m_s, 0.0, 0.0
        if self._turbulence is not None:
            u, v, w = self._interpolated(self._turbulence, time_s)
            fade = min(1.0, max(0.0, height_m / FADE_HEIGHT_M))
            along, across, down = along + u, v, fade * w
        north = along * self._cos - across * self._sin
        east = along * self._sin + across * self._cos
        if self._gusts is not None:
            gust_north, gust_east = self._gusts.at(time_s)
            north, east = north + profile * gust_north, east + profile * gust_east
        if self._gust is not None and (speed := self._gust.speed_m_s(time_s)) > 0.0:
            north += profile * speed * math.cos(self._gust_towards_rad)
            east += profile * speed * math.sin(self._gust_towards_rad)
        return (north, east, down)

    def _interpolated(self, turbulence: DrydenTurbulence, time_s: float) -> Vector3:
        while time_s >= self._next_s:
            self._sample, self._next = self._next, turbulence.step()
            self._next_s += TURBULENCE_STEP_S
        k = (self._next_s - time_s) / TURBULENCE_STEP_S
        a, b = self._sample, self._next
        return (b[0] + k * (a[0] - b[0]), b[1] + k * (a[1] - b[1]), b[2] + k * (a[2] - b[2]))
