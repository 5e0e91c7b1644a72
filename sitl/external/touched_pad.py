"""The pad of an external vehicle: it drives along its motion, and with the vehicle while that stands on it.

An external simulator's own ground stops a vehicle that comes down on a moving pad; a real deck would carry
it. Camera and rangefinder see the same of both: the vehicle at rest over the pad. So from the contact on the
pad goes where the vehicle goes, message by message: it stops with it. What their speeds differed by at the
contact is slowed down by the feet's friction, as on a deck. Once the feet are clear it drives on from there.

It drives by the clock of the vehicle's simulator: while that stands still, so do both.

NED, SI units. Pure; `at` may be called from another thread than the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, add, norm, scale, subtract
from sitl.external.pose import MEMORY_S, Pose
from sitl.pad.motion import PadMotion, PadTruth

PoseAt = Callable[[float], Pose]
_BEFORE_ALL: Final = -math.inf


class _Stretch(NamedTuple):
    """A part of the pad's way, after `since_s`; `phase_s` is how far along its motion it is then, and
    `simulated_s` the time by the vehicle's simulator.

    `displaced_m` is how far vehicles have taken it from that motion. With `contact`, the vehicle's pose then,
    it goes with the vehicle, and at first slides on beneath it by `slip_m_s`. Without, it drives or stands.
    """

    since_s: float = _BEFORE_ALL
    phase_s: float = 0.0
    displaced_m: Vector3 = ZERO3
    drives: bool = False
    contact: Pose | None = None
    slip_m_s: Vector3 = ZERO3
    simulated_s: float = 0.0


class TouchedPad:
    """A pad's motion that a vehicle interrupts; `pose_at` is the vehicle's at a time of the last second."""

    def __init__(self, motion: PadMotion, friction: float, pose_at: PoseAt) -> None:
        self._motion, self._pose_at = motion, pose_at
        self._slows_m_s2 = friction * GRAVITY_M_S2
        self.stop()

    def stop(self) -> None:
        """Back at its start, where it stands until it departs."""
        self._stretches: tuple[_Stretch, ...] = (_Stretch(),)

    @property
    def departed(self) -> bool:
        """Whether it has set off."""
        return self._stretches[-1].since_s > _BEFORE_ALL

    @property
    def carries(self) -> bool:
        """Whether the vehicle stands on it."""
        return self._stretches[-1].contact is not None

    def depart(self, time_s: float) -> None:
        """Set off."""
        self._append(_Stretch(time_s, drives=True, simulated_s=self._simulated_s(time_s)))

    def touch(self, pose: Pose) -> None:
        """Go with the vehicle, whose last pose before the contact this is."""
        pad, last = self.at(pose.time_s), self._stretches[-1]
        north, east, _ = subtract(pad.velocity_ned_m_s, pose.velocity_ned_m_s)
        slip = (north, east, 0.0) if last.drives else ZERO3
        self._append(
            _Stretch(pose.time_s, self._phase_s(last, pose.time_s), last.displaced_m, False, pose, slip)
        )

    def release(self, time_s: float) -> None:
        """Drive on: the vehicle has risen."""
        last = self._stretches[-1]
        displaced = add(last.displaced_m, self._carried_m(last, time_s))
        begun_s = self._simulated_s(time_s)
        self._append(_Stretch(time_s, last.phase_s, displaced, drives=True, simulated_s=begun_s))

    def at(self, time_s: float) -> PadTruth:
        """The pad at a time of the last second."""
        stretches = self._stretches
        stretch = next((s for s in reversed(stretches) if time_s > s.since_s), stretches[0])
        pad = self._motion.at(self._phase_s(stretch, time_s))
        moved = add(pad.position_ned_m, stretch.displaced_m)
        if stretch.drives:
            return pad._replace(position_ned_m=moved)
        velocity = ZERO3
        if stretch.contact is not None:
            moved = add(moved, self._carried_m(stretch, time_s))
            slows = self._sliding_s(stretch, time_s) * self._slows_m_s2
            north, east, _ = self._pose_at(time_s).velocity_ned_m_s
            velocity = add((north, east, 0.0), _shortened(stretch.slip_m_s, slows))
        return pad._replace(
            position_ned_m=moved,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=ZERO3,
            heading_rate_rad_s=0.0,
        )

    def _phase_s(self, stretch: _Stretch, time_s: float) -> float:
        return stretch.phase_s + (self._simulated_s(time_s) - stretch.simulated_s if stretch.drives else 0.0)

    def _simulated_s(self, time_s: float) -> float:
        return self._pose_at(time_s).simulated_s

    def _carried_m(self, stretch: _Stretch, time_s: float) -> Vector3:
        """How far it has gone with the vehicle since the contact, and slid beneath it."""
        assert stretch.contact is not None
        north, east, _ = subtract(self._pose_at(time_s).position_ned_m, stretch.contact.position_ned_m)
        slid_s = self._sliding_s(stretch, time_s)
        mean = _shortened(stretch.slip_m_s, 0.5 * slid_s * self._slows_m_s2)
        return add((north, east, 0.0), scale(mean, slid_s))

    def _sliding_s(self, stretch: _Stretch, time_s: float) -> float:
        """For how long it has slid by then."""
        lasts_s = norm(stretch.slip_m_s) / self._slows_m_s2 if self._slows_m_s2 > 0.0 else math.inf
        return min(max(time_s - stretch.since_s, 0.0), lasts_s)

    def _append(self, stretch: _Stretch) -> None:
        """Keep what may be asked for: a replaced tuple, never a changed one."""
        old = [k for k, s in enumerate(self._stretches) if s.since_s < stretch.since_s - MEMORY_S]
        self._stretches = (*self._stretches[old[-1] if old else 0 :], stretch)


def _shortened(v: Vector3, by: float) -> Vector3:
    length = norm(v)
    return scale(v, max(0.0, 1.0 - by / length)) if length > 0.0 else ZERO3
