"""What lies below, whatever vision says: the ultrasonic's echoes and the height over home.

The pad's predicted height drifts while the pad is unseen; these two do not depend on it. A transducer with
ice or a leaf on it gives the same few centimetres for ever: taken for the ground, they kept the vehicle up
for good. What stands below gives echoes that grow as the vehicle climbs. Heights are of the vehicle's
reference point, m; down is the EKF's NED; s.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Final

from companion.base.geometry import Vector3, quat_rotate
from companion.base.messages import AutopilotState, RangeSample, VehicleState
from companion.plan.landing.contact import KNOWN_S

# One echo in a hundred is a spike: so many in a row have to agree.
_ECHOES: Final = 3
_AGREE_M: Final = 0.3
NEAR_ECHO_M: Final = 1.5  # an echo this near, and the pad thought to lie
_LOWER_M: Final = 0.8  # so much lower: what is below is not the pad
# The others have moved so far, and alike, within so long, and the echo has not: nothing is there.
_MOVED_M: Final = 0.5
_WITHIN_S: Final = 5.0
_STILL_M: Final = 0.1


class HeightAboveGround:
    """The newest of both, by `update`; `sensor_body_m` is the ultrasonic's place (FRD)."""

    def __init__(self, sensor_body_m: Vector3) -> None:
        self._sensor_m = sensor_body_m
        self._echoes: deque[RangeSample] = deque(maxlen=_ECHOES)
        self._stood_ned_m: Vector3 | None = None
        self._down_m: float | None = None
        self.surface_m: float | None = None
        self.over_home_m: float | None = None

    def stands_here(self, vehicle: VehicleState | None) -> None:
        """Remember home by our own estimate: the vehicle is about to take off."""
        self._stood_ned_m = None if vehicle is None else vehicle.position_ned_m

    def above(self, height_m: float) -> float | None:
        """`surface_m`, if it is near and a pad that is estimated `height_m` below lies well beneath it."""
        near_m = self.surface_m
        contradicts = near_m is not None and near_m <= NEAR_ECHO_M and height_m - near_m >= _LOWER_M
        return near_m if contradicts else None

    def update(
        self, vehicle: VehicleState | None, autopilot: AutopilotState, echo: RangeSample | None, now_s: float
    ) -> None:
        """Take in a cycle: `surface_m` is the height over what gave the last echoes, if they agree."""
        if echo is not None and (not self._echoes or echo.time_s > self._echoes[-1].time_s):
            self._echoes.append(echo)
        self._down_m = None if vehicle is None else vehicle.position_ned_m[2]
        self.surface_m = None if vehicle is None else self._over_surface_m(vehicle, now_s)
        self.over_home_m = self._over_home_m(autopilot)

    @property
    def clearance_m(self) -> float | None:
        """The least height that is known: over the last echoes' surface, over home."""
        known = [h for h in (self.surface_m, self.over_home_m) if h is not None]
        return min(known, default=None)

    @property
    def home_ned_m(self) -> Vector3 | None:
        """Where the vehicle stood before take-off (EKF's NED), its height by that over it that is flown.

        By our own estimate: two GPS receivers disagree by metres, while one drifts little during a flight.
        """
        if self._stood_ned_m is None or self._down_m is None or self.over_home_m is None:
            return None
        return (*self._stood_ned_m[:2], self._down_m + self.over_home_m)

    def floor_down_m(self, height_m: float) -> float:
        """Down (m) of where the vehicle is `height_m` over all that is known of; inf when nothing is."""
        clearance_m = self.clearance_m
        if clearance_m is None or self._down_m is None:
            return math.inf
        return self._down_m + clearance_m - height_m

    def _over_surface_m(self, vehicle: VehicleState, now_s: float) -> float | None:
        distances = [e.distance_m for e in self._echoes]
        if len(distances) < _ECHOES or now_s - self._echoes[0].time_s > KNOWN_S:
            return None
        if max(distances) - min(distances) > _AGREE_M:
            return None
        x, y, z = self._sensor_m
        return quat_rotate(vehicle.attitude, (x, y, z + median(distances)))[2]

    def _over_home_m(self, autopilot: AutopilotState) -> float | None:
        """As the autopilot has it, by our own climb when it does not say."""
        if autopilot.global_position is not None and autopilot.home is not None:
            return autopilot.global_position[2] - autopilot.home[2]
        if self._down_m is None or self._stood_ned_m is None:
            return None
        return self._stood_ned_m[2] - self._down_m


class EchoCheck:
    """Call `update` in every cycle in which the vehicle does not go by a pad that may heave below it."""

    def __init__(self) -> None:
        self.stuck = False
        self._heard_s = -math.inf
        self._from: tuple[float, float, float, float] | None = None

    def pause(self) -> None:
        """A cycle that tells nothing: what comes after it is not compared with what was before."""
        self._from = None

    def update(
        self, echo: RangeSample | None, ours_m: float | None, theirs_m: float | None, now_s: float
    ) -> bool:
        """Take in a cycle; whether the echo is found to be stuck in it.

        `ours_m`, `theirs_m`: the vehicle's height by our estimate and by the autopilot, from anywhere.
        """
        if echo is None or echo.time_s <= self._heard_s or ours_m is None or theirs_m is None:
            return False  # the last echo, of where it was then, contradicts nothing
        self._heard_s = echo.time_s
        if self._from is not None and now_s - self._from[0] > _WITHIN_S:
            self._from = None
        echo_m = echo.distance_m
        start = self._from or (now_s, echo_m, ours_m, theirs_m)
        moved_m, ours_moved_m, theirs_moved_m = echo_m - start[1], ours_m - start[2], theirs_m - start[3]
        # farther echoes keep nothing up (see `HeightAboveGround.above`)
        if abs(moved_m) > _STILL_M or echo_m > NEAR_ECHO_M:
            self.stuck, self._from = False, (now_s, echo_m, ours_m, theirs_m)
            return False
        alike = abs(ours_moved_m - theirs_moved_m) <= _AGREE_M
        found = alike and min(abs(ours_moved_m), abs(theirs_moved_m)) >= _MOVED_M and not self.stuck
        self.stuck = self.stuck or found
        self._from = start
        return found
