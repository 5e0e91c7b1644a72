"""The path through the waypoints that the app flies itself: minimum jerk, around the obstacles between them.

Waypoints are north and east of home (m), with a height over home if it differs from the take-off height;
the flown path is in the EKF's NED. m, s.
"""

import math

import numpy as np

from companion.base.geometry import Vector3, add, norm
from companion.base.motion import Motion
from companion.config import ConfigError, MissionConfig, PlanConfig
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.obstacles.obstacles import Obstacle, clearance_m
from companion.plan.trajectory.reference_generator import SAME_POINT_M, ReferenceGenerator


def check_places(config: PlanConfig, vehicle_radius_m: float) -> None:
    """Refuse what could never be flown.

    Raises:
        ConfigError: the take-off touches an obstacle, or a waypoint is nearer to one than the margin.
    """
    mission, margin_m = config.mission, config.obstacle_margin_m + vehicle_radius_m
    places = places_from_home(mission)
    names = ["waypoint_ned_m", *(f"waypoints_ned_m.{k}" for k in range(len(places) - 1))]
    for index, shape in enumerate(config.obstacles):
        away_m = clearance_m(np.array([(0.0, 0.0, 0.0), *places]), [Obstacle.of(shape)])
        if away_m[0] < vehicle_radius_m:
            raise ConfigError(
                f"plan.obstacles.{index}: {away_m[0]:.1f} m from the take-off place, expected at least "
                f"{vehicle_radius_m:.1f} m"
            )
        for name, distance_m in zip(names, away_m[1:], strict=True):
            if distance_m < margin_m:
                raise ConfigError(
                    f"plan.mission.{name}: {distance_m:.1f} m from plan.obstacles.{index}, expected at least "
                    f"{margin_m:.1f} m: plan.obstacle_margin_m and the vehicle's radius"
                )


def places_from_home(mission: MissionConfig) -> list[Vector3]:
    """All waypoints, NED from home."""
    places: list[Vector3] = []
    for north, east, *height in (mission.waypoint_ned_m, *mission.waypoints_ned_m):
        places.append((north, east, -(height[0] if height else mission.take_off_height_m)))
    return places


class Waypoints:
    """One flight through them: `begin`, then `step` every cycle. Steers the reference in the EKF's NED."""

    def __init__(self, config: MissionConfig, generator: ReferenceGenerator) -> None:
        self._config, self._generator = config, generator
        self._places = places_from_home(config)
        self._left: list[Vector3] = []

    def begin(self, *, with_first: bool) -> None:
        """Start over; `with_first` when the autopilot has not flown to the first."""
        self._left = self._places[0 if with_first else 1 :]

    def step(self, actual: Motion, home_ned_m: Vector3, now_s: float) -> DetectedEvent | None:
        """One cycle with control ours; `actual` and home are in the EKF's NED."""
        reference = self._generator.at(now_s).position_m
        while self._left and math.dist(reference, add(self._left[0], home_ned_m)) <= SAME_POINT_M:
            self._left.pop(0)
        last = add(self._places[-1], home_ned_m)
        self._generator.fly_along([*(add(p, home_ned_m) for p in self._left[:-1]), last], now_s)
        slow = norm(actual.velocity_m_s) <= self._config.arrival_speed_m_s
        distance_m = math.dist(actual.position_m, last)
        if not self._left and slow and distance_m <= self._config.arrival_radius_m:
            return MissionEvent.ARRIVED, f"{distance_m:.1f} m from the last waypoint"
        return None
