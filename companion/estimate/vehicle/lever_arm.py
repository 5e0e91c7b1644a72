"""The accelerometer's position relative to the centre of mass, learnt in the air.

At r from the centre of mass (body) the accelerometer also measures alpha x r + w x (w x r). Across a
multirotor's up axis there is no thrust. So a vehicle that swings at w rad/s under its thrust measures w^2 r
/ g of its acceleration there once more. The controller takes this for wind and counteracts it, which makes
the loop oscillate from 3 cm on. The same swing shows r within seconds. A linear Kalman filter uses means of
the force f over triangles of two blocks; alpha is the difference of the two blocks' mean rates:

    f = S r + b + noise      S r = alpha x r + mean(w x (w x r))
    r: a random walk         b: the other forces, a random walk: the air's across, the thrust along

A vehicle carried by hand, or rocking on its feet, turns about another point: r is learnt in flight only. SI
units, FRD.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.base.geometry import (
    EYE3,
    GRAVITY_M_S2,
    ZERO3,
    FloatArray,
    Vector3,
    add,
    scale,
    subtract,
    vector3,
)
from companion.estimate.gating import fits
from companion.estimate.motion import LEVER_STD_M

LEVER_WALK_M_RTS: Final = 1e-4  # dampers give way
BLOCK_S: Final = 0.04  # twice, as a triangle: rotor tones leave nothing in it, as in `imu_noise`
# what the air's force, with the vehicle's own speed, changes by in a second; a multirotor's thrust: all of it
AIR_WALK_M_S2_RTS: Final = 1.0
THRUST_WALK_M_S2_RTS: Final = GRAVITY_M_S2
# of all six states
_WALK: Final = np.diag([LEVER_WALK_M_RTS**2] * 3 + [AIR_WALK_M_S2_RTS**2] * 2 + [THRUST_WALK_M_S2_RTS**2])
_ARM, _ELSE = slice(0, 3), slice(3, 6)


class _Block:
    """Sums over a block: rate, its products, and the force weighed as it rises and falls."""

    def __init__(self) -> None:
        self.span_s = 0.0
        self.rate = self.rising = self.falling = ZERO3
        self.squares: Vector3 = ZERO3
        self.products: Vector3 = ZERO3  # yz, zx, xy

    def add(self, rate: Vector3, force: Vector3, dt_s: float) -> None:
        """Take the mean rate and force of dt_s."""
        rising_s = dt_s * (self.span_s + 0.5 * dt_s)
        (p, q, r), (u, v, w), (a, b, c) = rate, self.squares, self.products
        self.squares = (u + p * p * dt_s, v + q * q * dt_s, w + r * r * dt_s)
        self.products = (a + q * r * dt_s, b + r * p * dt_s, c + p * q * dt_s)
        (a, b, c), (x, y, z) = self.rate, force
        self.rate = (a + p * dt_s, b + q * dt_s, c + r * dt_s)
        (a, b, c), (u, v, w) = self.falling, self.rising
        self.falling = (a + x * dt_s, b + y * dt_s, c + z * dt_s)
        self.rising = (u + x * rising_s, v + y * rising_s, w + z * rising_s)
        self.span_s += dt_s


class LeverArm:
    """Feed it every sample; `position_body_m` is the accelerometer's place from the centre of mass."""

    def __init__(self, told_body_m: Vector3) -> None:
        """`told_body_m`: by the vehicle's file."""
        self.position_body_m = told_body_m
        self.in_air = False
        self._x = np.zeros(6)
        P = np.zeros((6, 6))
        self._x[_ARM], P[_ARM, _ARM] = told_body_m, LEVER_STD_M**2 * EYE3
        self._P = P
        self._last: _Block | None = None
        self._block, self._begun = _Block(), False

    @property
    def covariance_m2(self) -> FloatArray:
        """Of that place (3, 3)."""
        return self._P[_ARM, _ARM]

    def felt_m_s2(self, before_rad_s: Vector3, rate_rad_s: Vector3, dt_s: float) -> Vector3:
        """What is felt there of a turn (m/s2, body) between two rates dt_s apart.

        Means between samples rather than samples: these have the rotors' tones, and differences all of it.
        """
        place = self.position_body_m
        if place == ZERO3 or dt_s <= 0.0:
            return ZERO3
        (a, b, c), (u, v, w), (x, y, z), k = before_rad_s, rate_rad_s, place, 1.0 / dt_s
        p, q, r = (a + u) * 0.5, (b + v) * 0.5, (c + w) * 0.5
        a, b, c = (u - a) * k, (v - b) * k, (w - c) * k
        u, v, w = q * z - r * y, r * x - p * z, p * y - q * x
        return (
            b * z - c * y + (q * w - r * v),
            c * x - a * z + (r * u - p * w),
            a * y - b * x + (p * v - q * u),
        )

    def add(
        self, rate: Vector3, force: Vector3, dt_s: float, force_density: float, rate_density: float
    ) -> None:
        """Take what was measured over dt_s (means, biases and all), and its noise (m2/s3, rad2/s)."""
        if not self.in_air or dt_s > BLOCK_S:
            self._last, self._block, self._begun = None, _Block(), False
            return
        self._block.add(rate, force, dt_s)
        if self._block.span_s < BLOCK_S - 0.5 * dt_s:
            return
        last, self._last, self._block = self._last, self._block, _Block()
        if last is not None:
            self._learn(last, self._last, force_density, rate_density)

    def _learn(self, first: _Block, second: _Block, force_density: float, rate_density: float) -> None:
        span_s = 0.5 * (first.span_s + second.span_s)
        alpha = subtract(scale(second.rate, 1.0 / second.span_s), scale(first.rate, 1.0 / first.span_s))
        alpha = scale(alpha, 1.0 / span_s)
        rising = scale(first.rising, 1.0 / first.span_s)
        falling = subtract(second.falling, scale(second.rising, 1.0 / second.span_s))
        f = np.array(add(rising, falling)) / span_s
        xx, yy, zz = scale(add(first.squares, second.squares), 0.5 / span_s)
        yz, zx, xy = scale(add(first.products, second.products), 0.5 / span_s)
        a, b, c = alpha
        H = np.array(
            (
                (-yy - zz, xy - c, zx + b, 1.0, 0.0, 0.0),
                (xy + c, -zz - xx, yz - a, 0.0, 1.0, 0.0),
                (zx - b, yz + a, -xx - yy, 0.0, 0.0, 1.0),
            )
        )
        if not self._begun:
            self._begin(f - H[:, _ARM] @ self._x[_ARM])
            return
        self._P = self._P + span_s * _WALK
        north, east, down, *_ = self._P.diagonal().tolist()
        # neighbouring triangles share a block: together they tell as much as blocks do
        turned = north + east + down + float(self._x[_ARM] @ self._x[_ARM])
        noise = force_density / span_s + 2.0 * rate_density / span_s**3 * turned
        PH = self._P @ H.T
        innovation, spread = f - H @ self._x, H @ PH + noise * EYE3
        if not fits(innovation, spread):
            self._begun = False  # a blow, or the ground
            return
        K = np.linalg.solve(spread, PH.T).T
        self._x = self._x + K @ innovation
        P = self._P - K @ PH.T
        self._P = 0.5 * (P + P.T)
        self.position_body_m = vector3(self._x[_ARM])

    def _begin(self, other_m_s2: FloatArray) -> None:
        """What else is felt is anything."""
        self._x[_ELSE] = other_m_s2
        self._P[_ELSE, :], self._P[:, _ELSE] = 0.0, 0.0
        self._P[_ELSE, _ELSE] = GRAVITY_M_S2**2 * EYE3
        self._begun = True
