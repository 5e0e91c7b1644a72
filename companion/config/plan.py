"""Settings of the planner: speed law, obstacles, guidance, and what mission.py and landing.py hold."""

from __future__ import annotations

import math
from typing import Final, Literal

from pydantic import Field, model_validator

from companion.config.landing import LandingConfig, SearchConfig, TouchdownConfig
from companion.config.mission import MissionConfig
from companion.config.obstacles import MOST_OBSTACLES, Shape
from companion.config.reading import OPERATOR, StrictModel

_ROOM_M: Final = 2.0  # to stop in before fence and ceiling


class GuidanceConfig(StrictModel):
    """What the reference may ask for, relative to the pad: a fixed camera must keep it in view."""

    minimum_time_s: float = Field(default=1.0, ge=0.3, le=5.0)
    """T_min of eq. 37: the shortest time for a trajectory; raise it for a vehicle with a slow response;
    lower it only to compare with the paper"""
    horizontal_speed_m_s: float = Field(default=3.0, gt=0.0, le=10.0)
    """Greatest horizontal speed of the reference relative to the pad, in addition to the pad's speed; raise
    it to catch up sooner"""
    vertical_speed_m_s: float = Field(default=1.2, gt=0.0, le=5.0)
    """Greatest vertical speed of the reference; lower it against vortex ring state"""
    horizontal_acceleration_m_s2: float = Field(default=2.0, gt=0.0, le=5.0)
    """Greatest horizontal acceleration of the reference; a fixed camera must keep the pad in view, so lower
    it for a narrow lens"""
    vertical_acceleration_m_s2: float = Field(default=0.8, gt=0.0, le=5.0)
    """Greatest vertical acceleration of the reference; lower it for a heavy vehicle with little thrust to
    spare"""
    heading_rate_deg_s: float = Field(default=30.0, gt=0.0, le=180.0)
    """Greatest turn rate of the reference, in addition to the pad's; lower it for a vehicle that yaws
    slowly"""


class PlanConfig(StrictModel):
    """The planner."""

    speed_law: Literal["fuzzy", "fixed", "log_polynomial"] = Field(default="fuzzy")
    """Approach speed: by the fuzzy rules, fixed, or a log polynomial of the distance; change it for
    comparison only"""
    fuzzy: str = Field(default="landing")
    """Rules for the approach speed: a name in configs/fuzzy, or a path; set it to rules of your own for a
    slower or faster approach (docs/explanation/fuzzy.md)"""
    pace: bool = Field(default=False)
    """Adapt the speed of approach and descent to the conditions: how well the pad is seen and followed, and
    gusts; set it to fly more slowly in bad conditions and faster in good ones
    (docs/explanation/fuzzy.md)"""
    fixed_speed_m_s: float = Field(default=0.9, ge=0.2, le=3.0)
    """With `speed_law: fixed`: the average speed over the remaining path; set it to the speed that you
    compare"""
    obstacles: tuple[Shape, ...] = Field(default=(), max_length=MOST_OBSTACLES, json_schema_extra=OPERATOR)
    """Obstacles to keep clear of (docs/how-to/obstacles.md); list them as they stand"""
    obstacle_margin_m: float = Field(default=1.5, ge=0.1, le=20.0, json_schema_extra=OPERATOR)
    """Distance kept between the rotor tips and every obstacle; it has to cover the drift of the position.
    Raise it for long flights or GPS loss"""
    obstacle_ceiling_m: float = Field(default=15.0, ge=1.0, le=120.0, json_schema_extra=OPERATOR)
    """Greatest height over home to pass over an obstacle; set it to the legal one"""
    mission: MissionConfig = MissionConfig()
    guidance: GuidanceConfig = GuidanceConfig()
    search: SearchConfig = SearchConfig()
    landing: LandingConfig = LandingConfig()
    touchdown: TouchdownConfig = TouchdownConfig()

    @model_validator(mode="after")
    def _what_is_planned_lies_within_bounds(self) -> PlanConfig:
        mission = self.mission
        highest_m = mission.take_off_height_m + self.search.climb_m + _ROOM_M
        if mission.ceiling_m < highest_m:
            raise ValueError(
                f"mission.ceiling_m {mission.ceiling_m:g}: expected at least {highest_m:g}, "
                f"take_off_height_m and search.climb_m with {_ROOM_M:g} m to stop in"
            )
        for north, east, *_ in (mission.waypoint_ned_m, *mission.waypoints_ned_m):
            if math.hypot(north, east) > mission.fence_m - _ROOM_M:
                raise ValueError(
                    f"mission: a waypoint {math.hypot(north, east):.0f} m from home, "
                    f"expected at most fence_m - {_ROOM_M:g} = {mission.fence_m - _ROOM_M:g}"
                )
        return self

    @model_validator(mode="after")
    def _a_try_fits_its_phase(self) -> PlanConfig:
        """Else the phase's time hands back in the middle of a try, however many are left."""
        c, limit_s = self.touchdown, self.mission.phases.touchdown_s
        down_s = c.blend_s + self.landing.wait_height_m / c.contact_speed_m_s + c.overdue_s + c.land_after_s
        if c.giving_up_s + down_s > limit_s:
            raise ValueError(
                f"mission.phases.touchdown_s {limit_s:g}: expected at least {c.giving_up_s + down_s:.1f}, "
                f"six times touchdown.gentle_wait_s ({c.gentle_wait_s:g}) and the way down"
            )
        return self
