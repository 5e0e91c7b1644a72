"""The pad as a target for the autopilot's own landing: a position in its frame, at an exposure. Pure.

ArduPilot predicts its target at constant velocity: it does not lag behind a pad that drives straight, but
behind one that accelerates, as in every curve. PX4 flies to the reported position and lags by the pad's
speed as well. Body axes are FRD.
"""

import math
from dataclasses import dataclass, replace

from companion.base.autopilots import AutopilotMake
from companion.base.geometry import (
    Quaternion,
    Vector3,
    add,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    scale,
)
from companion.base.messages import LandingTargetPose, PadSighting, PadState


@dataclass(frozen=True, slots=True)
class SeenPad:
    """The pad's centre from the vehicle's reference point, and its turn, in body axes at an exposure."""

    time_s: float
    position_body_m: Vector3
    body_from_pad: Quaternion

    @classmethod
    def by_sighting(cls, sighting: PadSighting) -> "SeenPad":
        """As one frame shows it."""
        return cls(sighting.time_s, sighting.pad_position_body_m, sighting.body_from_pad)

    @classmethod
    def by_estimate(cls, pad: PadState, attitude: Quaternion) -> "SeenPad":
        """As the filter has it, at its time, where the vehicle has `attitude` in the same NED."""
        level = quat_from_euler(0.0, 0.0, pad.heading_rad)
        position = quat_rotate_inverse(attitude, pad.relative_position_ned_m)
        return cls(pad.time_s, position, quat_multiply(quat_conjugate(attitude), level))

    def moved(self, by_body_m: Vector3) -> "SeenPad":
        """The same, elsewhere."""
        return replace(self, position_body_m=add(self.position_body_m, by_body_m))


class TargetLead:
    """By what the target is moved so that the autopilot, which follows late by T, comes over the pad.

    One that flies to where the target was told follows it as 1 / (1 + T s / 2)^2 does: the inverse adds the
    pad's velocity times T and its acceleration times T^2 / 4. One that carries its target on at the target's
    velocity follows it as (1 + T s) / (1 + T s + T^2 s^2 / 2): the inverse adds the acceleration times
    T^2 / 2, through a low pass of T. Horizontal.
    """

    def __init__(self, lead_s: float) -> None:
        self._lead_s = lead_s
        self._time_s = -math.inf
        self._carried_m = (0.0, 0.0)

    def ned_m(self, pad: PadState, sent_s: float, make: AutopilotMake) -> Vector3:
        """The shift (m, NED) for the estimate at an exposure; exposures come in order of time."""
        if make.carries_target_on:
            return self._carried(pad)
        late_s = sent_s - pad.time_s + self._lead_s
        moved = add(scale(pad.velocity_ned_m_s, late_s), scale(pad.acceleration_ned_m_s2, 0.25 * late_s**2))
        return (moved[0], moved[1], 0.0)

    def _carried(self, pad: PadState) -> Vector3:
        north, east, _ = scale(pad.acceleration_ned_m_s2, 0.5 * self._lead_s**2)
        kept = math.exp((self._time_s - pad.time_s) / self._lead_s)  # none of it at first
        self._time_s = pad.time_s
        before_north, before_east = self._carried_m
        self._carried_m = (north + kept * (before_north - north), east + kept * (before_east - east))
        return (*self._carried_m, 0.0)


def landing_target(
    seen: SeenPad, size_m: tuple[float, float], own_pose: tuple[Vector3, Quaternion] | None = None
) -> LandingTargetPose:
    """The target; `own_pose`: position and attitude of an autopilot that takes its own NED alone, by itself.

    `size_m` is the pad's width and length.
    """
    x, y, z = seen.position_body_m
    distance_m = max(norm((x, y, z)), 1e-3)
    size_rad = (2.0 * math.atan2(0.5 * size_m[0], distance_m), 2.0 * math.atan2(0.5 * size_m[1], distance_m))
    if own_pose is None:
        return LandingTargetPose(seen.time_s, seen.position_body_m, seen.body_from_pad, size_rad)
    position, attitude = own_pose
    return LandingTargetPose(
        seen.time_s,
        seen.position_body_m,
        quat_multiply(attitude, seen.body_from_pad),
        size_rad,
        add(position, quat_rotate(attitude, seen.position_body_m)),
    )
