"""Whether refused sightings show a pad whose velocity has changed at once: it was stopped, or hit.

Until a filter takes a sighting in, its expected track goes on as before. After a step dv of the velocity at
the time tau the pad leaves that track by dv (t - tau): the innovations of two sightings lie on one line, and
that line meets the track between the last accepted sighting and the first refused one. Another pad and a pose
that is off by as much again leave the track by a leap, which is no such line. A pose that slides off is one:
so the track before the step is kept until the next sighting, which tells. NED, SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import EYE3, FloatArray, Vector3, norm, vector3
from companion.estimate.gating import CHI_SQUARE_999, normalised_innovation_squared

# Two sightings farther apart do not show what happened in between.
_LONGEST_S: Final = 0.15
# The step has to exceed its own error by so much, squared over three axes: or what the filter knew of the
# velocity is worth more than two sightings.
_SIGNIFICANT: Final = 4.0 * CHI_SQUARE_999[3]
# How fast a pad may still accelerate meanwhile.
_ACCELERATION_STD_M_S2: Final = 3.0
# What stops a pad, or turns it back, makes it no faster than it was.
_FASTER_M_S: Final = 1.0


class RefusedSighting(NamedTuple):
    """One that the gate refused: its innovation (m) with the covariance (3, 3), and its own noise (3, 3)."""

    time_s: float
    innovation_m: FloatArray
    covariance_m2: FloatArray
    noise_m2: FloatArray

    @classmethod
    def of(cls, time_s: float, y: Vector3, S: tuple[float, ...], R: FloatArray) -> RefusedSighting:
        """Of an innovation, its covariance by its upper triangle, and the measurement's noise."""
        a, b, c, d, e, f = S
        return cls(time_s, np.array(y), np.array([[a, b, c], [b, d, e], [c, e, f]]), R)


class VelocityEstimate(NamedTuple):
    """A velocity, or its change (m/s, NED), its covariance (3, 3), and that with the position (3, 3)."""

    velocity_m_s: Vector3
    covariance_m2_s2: FloatArray
    with_position_m2_s: FloatArray


def recent(refused: Sequence[RefusedSighting], time_s: float) -> tuple[RefusedSighting, ...]:
    """Those of them with which one of `time_s` may show a step."""
    return tuple(r for r in refused if 0.0 < time_s - r.time_s <= _LONGEST_S)


def velocity_step(
    earlier: Sequence[RefusedSighting], later: RefusedSighting, seen_time_s: float
) -> VelocityEstimate | None:
    """The change of velocity that explains `later` and one of the earlier refused sightings; None: none does.

    `seen_time_s`: of the last sighting that was accepted.
    """
    steps = (_step(first, later, seen_time_s) for first in recent(earlier, later.time_s))
    return next((step for step in steps if step is not None), None)


def believable(before_m_s: Vector3, after_m_s: Vector3) -> bool:
    """Whether a pad's velocity (over ground) may have become that at once."""
    return norm(after_m_s) <= norm(before_m_s) + _FASTER_M_S


def _step(first: RefusedSighting, later: RefusedSighting, seen_time_s: float) -> VelocityEstimate | None:
    apart_s = later.time_s - first.time_s
    change = (later.innovation_m - first.innovation_m) / apart_s
    noise = (first.noise_m2 + later.noise_m2) / apart_s**2
    if not normalised_innovation_squared(change, noise) >= _SIGNIFICANT:
        return None
    # from the step to the first of them
    since_s = float(first.innovation_m @ change) / float(change @ change)
    since_s = min(max(since_s, 0.0), first.time_s - seen_time_s)
    leap = first.innovation_m - since_s * change
    # the change's own error moves where its line began
    leap_covariance = first.covariance_m2 + since_s**2 * noise
    if not normalised_innovation_squared(leap, leap_covariance) <= CHI_SQUARE_999[3]:
        return None
    drift = (_ACCELERATION_STD_M_S2 * apart_s) ** 2
    return VelocityEstimate(vector3(change.tolist()), noise + drift * EYE3, later.noise_m2 / apart_s)
