"""Whether refused sightings show a pad whose velocity has changed at once: it was stopped, or hit.

Until a filter takes a sighting in, its expected track goes on as before. After a step dv of the velocity at
the time tau the pad leaves that track by dv (t - tau): the innovations of two sightings lie on one line, and
that line meets the track between the last accepted sighting and the first refused one. Another pad, a wrong
marker and a pose that is off leave the track by a leap, which is no such line. NED, SI units.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import FloatArray, Vector3, vector3
from companion.estimate.gating import CHI_SQUARE_999, normalised_innovation_squared

# Two sightings farther apart do not show what happened in between.
LONGEST_STEP_S: Final = 0.15
# The step has to exceed its own error by so much, squared over three axes: or what the filter knew of the
# velocity is worth more than two sightings.
_SIGNIFICANT: Final = 4.0 * CHI_SQUARE_999[3]
# How fast a pad may still accelerate meanwhile.
_ACCELERATION_STD_M_S2: Final = 3.0


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
    """A velocity, or its change (m/s, NED), and its covariance (3, 3)."""

    velocity_m_s: Vector3
    covariance_m2_s2: FloatArray


def velocity_step(
    earlier: RefusedSighting | None, later: RefusedSighting, seen_time_s: float
) -> VelocityEstimate | None:
    """The change of velocity that explains two refused sightings; the last one taken is of `seen_time_s`.

    None when there is no earlier one, or no step explains both.
    """
    if earlier is None or not 0.0 < later.time_s - earlier.time_s <= LONGEST_STEP_S:
        return None
    apart_s = later.time_s - earlier.time_s
    change = (later.innovation_m - earlier.innovation_m) / apart_s
    noise = (earlier.noise_m2 + later.noise_m2) / apart_s**2
    square = float(change @ change)
    if square == 0.0 or normalised_innovation_squared(change, noise) < _SIGNIFICANT:
        return None
    since_s = float(earlier.innovation_m @ change) / square  # from the step to the earlier sighting
    since_s = min(max(since_s, 0.0), earlier.time_s - seen_time_s)
    leap = earlier.innovation_m - since_s * change
    # the change's own error moves where its line began
    leap_covariance = earlier.covariance_m2 + since_s**2 * noise
    if normalised_innovation_squared(leap, leap_covariance) > CHI_SQUARE_999[3]:
        return None
    drift = (_ACCELERATION_STD_M_S2 * apart_s) ** 2
    return VelocityEstimate(vector3(change.tolist()), noise + drift * np.eye(3))
