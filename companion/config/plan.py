"""Settings of the planner: mission, guidance, search, landing and touchdown."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from companion.config.obstacles import MOST_OBSTACLES, Place, Shape
from companion.config.reading import StrictModel

Height = Annotated[float, Field(ge=1.0, le=50.0)]
# north and east of home (m), and height over home (m, up) where it is not that of the take-off
Waypoint = tuple[Place, Place] | tuple[Place, Place, Height]


_ROOM_M: Final = 2.0  # to stop in before fence and ceiling
_GUST_M_S: Final = 0.08  # what a gust adds to a planned sink


class PhaseTimesConfig(StrictModel):
    """How long each phase may last; standby waits for ever, and AUTO_LAND asks again while it is heard."""

    connect_s: float = Field(default=90.0, ge=5.0, le=3600.0)
    arm_s: float = Field(default=90.0, ge=2.0, le=300.0)
    take_off_s: float = Field(default=40.0, ge=5.0, le=300.0)
    waypoint_s: float = Field(default=60.0, ge=5.0, le=1800.0)
    route_s: float = Field(default=120.0, ge=5.0, le=1800.0)
    search_s: float = Field(default=60.0, ge=5.0, le=600.0)
    approach_s: float = Field(default=30.0, ge=5.0, le=300.0)
    descend_s: float = Field(default=30.0, ge=5.0, le=300.0)
    touchdown_s: float = Field(default=45.0, ge=5.0, le=300.0)
    hold_s: float = Field(default=10.0, ge=1.0, le=300.0)


class BatteryConfig(StrictModel):
    """Remaining charge as the autopilot reports it, as shares; nothing follows where it reports none."""

    low: float = Field(default=0.25, ge=0.0, le=0.9)  # no take-off and no new try
    critical: float = Field(default=0.12, ge=0.0, le=0.9)  # the vehicle is returned to the autopilot
    finish_descent: bool = True  # a descent over the pad is finished all the same

    @model_validator(mode="after")
    def _low_before_critical(self) -> Self:
        if self.critical > self.low:
            raise ValueError(f"critical: expected at most low ({self.low:g})")
        return self


class MissionConfig(StrictModel):
    """The flight: where to look for the pad, when to ask again, when to give up."""

    may_arm: bool = False  # the whole flight, arming and taking off, may be ordered; --sitl sets it
    take_off_height_m: float = Field(default=7.0, ge=1.0, le=50.0)
    waypoint_ned_m: tuple[Place, Place] = (10.0, 0.0)
    waypoints_ned_m: tuple[Waypoint, ...] = ()
    arrival_radius_m: float = Field(default=1.5, ge=0.2, le=20.0)
    arrival_speed_m_s: float = Field(default=0.8, ge=0.1, le=5.0)
    align_heading: bool = True
    fence_m: float = Field(default=150.0, ge=10.0, le=2000.0)  # from home; no beacon is followed beyond
    ceiling_m: float = Field(default=60.0, ge=5.0, le=500.0)  # over home
    pad_speed_m_s: float = Field(default=5.0, gt=0.0, le=30.0)  # horizontally; a faster pad is not followed
    pad_acceleration_m_s2: float = Field(default=5.0, gt=0.0, le=30.0)
    largest_speed_std_m_s: float = Field(default=1.0, gt=0.0, le=10.0)  # of our velocity, away from the pad
    largest_round_trip_s: float = Field(default=0.3, gt=0.0, le=2.0)
    total_timeout_s: float = Field(default=180.0, ge=10.0, le=3600.0)
    action_retry_s: float = Field(default=2.0, ge=0.2, le=30.0)
    action_answer_s: float = Field(default=6.0, ge=0.5, le=60.0)
    action_attempts: int = Field(default=4, ge=1, le=20)
    phases: PhaseTimesConfig = PhaseTimesConfig()
    battery: BatteryConfig = BatteryConfig()


class GuidanceConfig(StrictModel):
    """What the reference may ask for, relative to the pad: a fixed camera must keep it in view."""

    minimum_time_s: float = Field(default=1.0, ge=0.3, le=5.0)  # T_min of eq. 37
    horizontal_speed_m_s: float = Field(default=3.0, gt=0.0, le=10.0)
    vertical_speed_m_s: float = Field(default=1.2, gt=0.0, le=5.0)
    horizontal_acceleration_m_s2: float = Field(default=2.0, gt=0.0, le=5.0)
    vertical_acceleration_m_s2: float = Field(default=0.8, gt=0.0, le=5.0)
    heading_rate_deg_s: float = Field(default=30.0, gt=0.0, le=180.0)


class SearchConfig(StrictModel):
    """Looking for the pad; Algorithm 1's other branch."""

    stream_s: float = Field(default=0.5, ge=0.1, le=5.0)  # setpoints before control is asked for
    hold_s: float = Field(default=0.7, ge=0.0, le=30.0)
    request_s: float = Field(default=1.5, ge=1.0, le=60.0)
    dwell_s: float = Field(default=2.0, ge=0.0, le=30.0)  # over the pad's likely place, before the spiral
    spacing_m: float = Field(default=4.0, ge=0.5, le=30.0)
    radius_m: float = Field(default=12.0, ge=1.0, le=200.0)
    trust_s: float = Field(default=12.0, ge=1.0, le=120.0)  # a word of where the pad is, until it is stale
    lead_s: float = Field(default=5.0, ge=0.0, le=30.0)  # and how far its velocity is carried on
    climb_m: float = Field(default=6.0, ge=0.0, le=30.0)
    floor_m: float = Field(default=1.5, ge=0.5, le=10.0)  # over home and the last echoes, the pad unseen
    sightings: int = Field(default=5, ge=1, le=100)
    velocity_std_m_s: float = Field(default=0.5, gt=0.0, le=5.0)  # the pad's velocity, to take it up


class LandingConfig(StrictModel):
    """Approach and descent over the pad; heights are of the feet over the pad."""

    approach_height_m: float = Field(default=3.0, ge=1.0, le=20.0)
    approach_slope: float = Field(default=0.35, gt=0.0, le=3.0)  # metres aside for each metre of height
    cone_slope: float = Field(default=0.2, gt=0.0, le=1.0)
    cone_floor_m: float = Field(default=0.10, gt=0.0, le=1.0)
    wait_height_m: float = Field(default=0.35, ge=0.1, le=2.0)
    retry_height_m: float = Field(default=1.5, ge=0.3, le=5.0)
    retries: int = Field(default=3, ge=0, le=20)
    pause_unseen_s: float = Field(default=0.5, gt=0.0, le=5.0)
    lost_unseen_s: float = Field(default=5.0, gt=0.0, le=10.0)

    @model_validator(mode="after")
    def _waits_lowest(self) -> Self:
        for name in ("approach_height_m", "retry_height_m"):
            if getattr(self, name) < self.wait_height_m:
                raise ValueError(f"{name}: expected at least wait_height_m ({self.wait_height_m:g})")
        return self


class TouchdownConfig(StrictModel):
    """The last third of a metre: when to commit, how fast, and what counts as contact."""

    lateral_m: float = Field(default=0.06, gt=0.0, le=0.5)
    lateral_speed_m_s: float = Field(default=0.12, gt=0.0, le=1.0)
    settled_s: float = Field(default=0.2, ge=0.0, le=5.0)
    gentle_horizontal_m_s2: float = Field(default=1.2, gt=0.0, le=5.0)
    gentle_vertical_m_s2: float = Field(default=0.2, gt=0.0, le=5.0)
    contact_tilt_deg: float = Field(default=7.0, ge=1.0, le=30.0)  # levelled off to this as the feet touch
    gentle_tilt_m_s2: float = Field(default=1.6, gt=0.0, le=6.0)  # what tilting it takes to go with the pad
    contact_deck_tilt_deg: float = Field(default=5.0, ge=1.0, le=30.0)  # of a deck that swings
    gentle_wait_s: float = Field(default=5.0, ge=0.5, le=60.0)
    contact_speed_m_s: float = Field(default=0.19, ge=0.05, le=0.4)
    firm_contact_m_s: float = Field(default=0.32, ge=0.05, le=0.4)  # where it tilts far: the most planned
    fastest_contact_m_s: float = Field(default=0.42, ge=0.05, le=1.0)  # sinking faster,
    break_off_lateral_m: float = Field(default=0.07, gt=0.0, le=0.5)  # or farther aside, higher up than this:
    break_off_above_m: float = Field(default=0.06, ge=0.03, le=1.0)  # rise and wait again
    blend_s: float = Field(default=0.8, ge=0.2, le=3.0)
    blind_s: float = Field(default=1.5, ge=0.1, le=5.0)
    overdue_s: float = Field(default=1.5, ge=0.3, le=10.0)
    escape_lateral_m: float = Field(default=0.18, gt=0.0, le=1.0)
    contact_margin_m: float = Field(default=0.02, gt=0.0, le=0.2)
    contact_s: float = Field(default=0.15, ge=0.0, le=1.0)
    land_after_s: float = Field(default=1.0, ge=0.5, le=30.0)  # motors on meanwhile

    @property
    def giving_up_s(self) -> float:
        """So long a try may last until it has failed; the final descent may still follow."""
        return 6.0 * self.gentle_wait_s

    @model_validator(mode="after")
    def _goes_on_from_where_it_commits(self) -> TouchdownConfig:
        if self.break_off_lateral_m < self.lateral_m:
            raise ValueError(
                f"break_off_lateral_m {self.break_off_lateral_m:g}: expected no less than lateral_m, "
                f"{self.lateral_m:g}"
            )
        planned_m_s = max(self.contact_speed_m_s, self.firm_contact_m_s)
        if self.fastest_contact_m_s < planned_m_s + _GUST_M_S:
            raise ValueError(
                f"fastest_contact_m_s {self.fastest_contact_m_s:g}: expected {planned_m_s + _GUST_M_S:g} or "
                f"more, {_GUST_M_S:g} above contact_speed_m_s and firm_contact_m_s"
            )
        if self.break_off_above_m <= 2.0 * self.contact_margin_m:
            raise ValueError(
                f"break_off_above_m {self.break_off_above_m:g}: expected more than twice contact_margin_m, "
                f"{self.contact_margin_m:g}; so low the feet may stand"
            )
        return self


class PlanConfig(StrictModel):
    """The planner."""

    speed_law: Literal["fuzzy", "fixed", "log_polynomial"] = "fuzzy"
    fuzzy: str = "landing"
    pace: bool = False  # of the fuzzy rules, by the conditions
    fixed_speed_m_s: float = Field(default=0.9, ge=0.2, le=3.0)
    obstacles: tuple[Shape, ...] = Field(default=(), max_length=MOST_OBSTACLES)
    obstacle_margin_m: float = Field(default=1.5, ge=0.1, le=20.0)  # from the rotors' tips: our place errs
    obstacle_ceiling_m: float = Field(default=15.0, ge=1.0, le=120.0)  # over home: no higher to pass over one
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
