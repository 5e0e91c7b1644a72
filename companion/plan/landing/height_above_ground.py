"""What lies below, whatever vision says: the ultrasonic's echoes and the height over home.

The pad's predicted height drifts while the pad is unseen; these two do not depend on it. Heights are of the
vehicle's reference point, m; down is the EKF's NED; s.
"""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Final

from companion.base.geometry import Vector3, quat_rotate
from companion.base.messages import AutopilotState, RangeSample, VehicleState

# One echo in a hundred is a spike: so many in a row have to agree.
_ECHOES: Final = 3
_SPREAD_M: Final = 0.3
_FRESH_S: Final = 0.5
NEAR_ECHO_M: Final = 1.5  # an echo this near, and the pad thought to lie
_LOWER_M: Final = 0.8  # so much lower: what is below is not the pad


class HeightAboveGround:
    """The newest of both, by `update`; `sensor_body_m` is the ultrasonic's place (FRD)."""

    def __init__(self, sensor_body_m: Vector3) -> None:
        self._sensor_m = sensor_body_m
        self._echoes: deque[RangeSample] = deque(maxlen=_ECHOES)
        self._home_down_m: float | None = None
        self._down_m: float | None = None
        self.surface_m: float | None = None
        self.over_home_m: float | None = None

    def stands_here(self, vehicle: VehicleState | None) -> None:
        """Remember home's height by our own estimate: the vehicle is about to take off."""
        self._home_down_m = None if vehicle is None else vehicle.position_ned_m[2]

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
    def home_down_m(self) -> float | None:
        """Down (m) of home, by the height over it that is flown."""
        known = self._down_m is not None and self.over_home_m is not None
        return self._down_m + self.over_home_m if known else None  # type: ignore[operator]

    def floor_down_m(self, height_m: float) -> float | None:
        """Down (m) of the point from which on the vehicle is `height_m` over all that is known of."""
        clearance_m = self.clearance_m
        if clearance_m is None or self._down_m is None:
            return None
        return self._down_m + clearance_m - height_m

    def _over_surface_m(self, vehicle: VehicleState, now_s: float) -> float | None:
        distances = [e.distance_m for e in self._echoes]
        if len(distances) < _ECHOES or now_s - self._echoes[0].time_s > _FRESH_S:
            return None
        if max(distances) - min(distances) > _SPREAD_M:
            return None
        x, y, z = self._sensor_m
        return quat_rotate(vehicle.attitude, (x, y, z + median(distances)))[2]

    def _over_home_m(self, autopilot: AutopilotState) -> float | None:
        """As the autopilot has it, by our own climb when it does not say."""
        if autopilot.global_position is not None and autopilot.home is not None:
            return autopilot.global_position[2] - autopilot.home[2]
        if self._down_m is None or self._home_down_m is None:
            return None
        return self._home_down_m - self._down_m
