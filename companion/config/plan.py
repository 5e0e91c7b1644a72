"""Settings of the planner: obstacles, mission, search and landing, speed law and guidance."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from companion.config.reading import OPERATOR, StrictModel

# ---------------------------------------------------------------- search, landing and touchdown

_GUST_M_S: Final = 0.08  # what a gust adds to a planned sink


class SearchConfig(StrictModel):
    """Looking for the pad; Algorithm 1's other branch."""

    stream_s: float = Field(default=0.5, ge=0.1, le=5.0)
    """Time of setpoints before control is requested; raise it if the autopilot refuses"""
    hold_s: float = Field(default=0.7, ge=0.0, le=30.0)
    """Hold this long before the search; raise it for a pad that is often hidden briefly"""
    request_s: float = Field(default=1.5, ge=1.0, le=60.0)
    """How often the ground station is asked for the pad's position; raise it for a slow telemetry radio"""
    dwell_s: float = Field(default=2.0, ge=0.0, le=30.0)
    """Stay over the pad's likely position for this time before the spiral; raise it for a beacon with an
    accurate position"""
    spacing_m: float = Field(default=4.0, ge=0.5, le=30.0)
    """Spacing of the square spiral's turns; lower it for a narrow lens or a low search"""
    radius_m: float = Field(default=12.0, ge=1.0, le=200.0, json_schema_extra=OPERATOR)
    """Beyond this radius the spiral begins again; set it to the largest error of the pad's expected
    position"""
    trust_s: float = Field(default=12.0, ge=1.0, le=120.0)
    """The pad's last position, by its beacon or a sighting, is trusted this long; lower it for a fast pad"""
    lead_s: float = Field(default=5.0, ge=0.0, le=30.0)
    """Extrapolation time of a beacon's velocity; raise it for a beacon received rarely"""
    climb_m: float = Field(default=6.0, ge=0.0, le=30.0)
    """Greatest climb to look for a pad that was lost; announced. 0 keeps the height; lower it under a roof, a
    bridge or a low airspace limit"""
    floor_m: float = Field(default=1.5, ge=0.5, le=10.0)
    """Least height over home and over the last echoes while the pad is unseen; raise it over uneven ground;
    lower is worse: a pad that is not seen may stand above the ground"""
    sightings: int = Field(default=5, ge=1, le=100)
    """Number of sightings that confirm a pad; raise it where false markers occur"""
    velocity_std_m_s: float = Field(default=0.5, gt=0.0, le=5.0)
    """Uncertainty of the pad's velocity below which the approach begins. Larger is worse: the approach
    begins with an uncertain motion of the pad. Lower it for fast pads"""


class LandingConfig(StrictModel):
    """Approach and descent over the pad; heights are of the feet over the pad."""

    approach_height_m: float = Field(default=3.0, ge=1.0, le=20.0)
    """Height of the feet over the pad where the approach ends; raise it for a pad with masts or people near
    it, lower it for a pad of small markers"""
    approach_slope: float = Field(default=0.35, gt=0.0, le=3.0)
    """Slope of the approach, lateral metres per metre of height; lower it for a steeper approach"""
    cone_slope: float = Field(default=0.2, gt=0.0, le=1.0)
    """Descent cone: lateral metres allowed per metre of height; lower it for a narrow lens"""
    cone_floor_m: float = Field(default=0.10, gt=0.0, le=1.0)
    """Narrowest half width of the descent cone; lower it for a small pad"""
    wait_height_m: float = Field(default=0.35, ge=0.1, le=2.0)
    """Height of the feet where touchdown begins; raise it in gusts, within the camera's view"""
    retry_height_m: float = Field(default=1.5, ge=0.3, le=5.0)
    """Height to climb back to after a failed try. Lower is worse: the pad may heave or pitch beneath it.
    Raise it for a deck that heaves by more than a metre"""
    retries: int = Field(default=3, ge=0, le=20, json_schema_extra=OPERATOR)
    """Tries after the first; more is worse: each is a further risk low over the pad. Lower it for a small
    battery"""
    pause_unseen_s: float = Field(default=0.5, gt=0.0, le=5.0)
    """If the pad is unseen for this time, the descent pauses, and just over the pad the vehicle climbs and
    tries again. In the descent the time counts from the last exposure, just over the pad from the arrival of
    that sighting. Raise it where single frames are often lost"""
    lost_unseen_s: float = Field(default=5.0, gt=0.0, le=10.0)
    """If the pad is unseen for this time, it counts as lost; longer is worse: the vehicle follows a
    prediction. Lower it for a pad that changes its course often"""

    @model_validator(mode="after")
    def _waits_lowest(self) -> Self:
        for name in ("approach_height_m", "retry_height_m"):
            if getattr(self, name) < self.wait_height_m:
                raise ValueError(f"{name}: expected at least wait_height_m ({self.wait_height_m:g})")
        return self


class TouchdownConfig(StrictModel):
    """The last third of a metre: when to commit, how fast, and what counts as contact."""

    lateral_speed_m_s: float = Field(default=0.12, gt=0.0, le=1.0)
    """Speed relative to the pad that the vehicle may gain while it is level for the contact. Twice as much is
    the limit at contact: if a contact within it is unlikely, the final descent does not begin, or is broken
    off. Raise it in strong gusts, up to what the landing gear bears"""
    settled_s: float = Field(default=0.2, ge=0.0, le=5.0)
    """Time for which the conditions of the final descent have to hold; raise it for a steadier vehicle at
    contact, after a longer wait"""
    contact_tilt_deg: float = Field(default=7.0, ge=1.0, le=30.0)
    """Largest tilt at contact, to which the vehicle levels; raise it for wind in which it cannot level;
    more is worse: one foot touches first, and the vehicle slides"""
    contact_deck_tilt_deg: float = Field(default=5.0, ge=1.0, le=30.0)
    """Largest tilt of a swinging deck at contact. Raise it for a wide landing gear on a rough sea"""
    giving_up_s: float = Field(default=30.0, ge=3.0, le=360.0)
    """Time after which a try that is not committed has failed. At first a contact within the limits has to be
    likely at 90 %, at the end at 50 %. Raise it on a rough deck"""
    contact_speed_m_s: float = Field(default=0.19, ge=0.05, le=0.4)
    """Sink rate at contact, relative to the pad; lower it for fragile legs; higher is worse: a harder
    contact, and a bounce"""
    firm_contact_m_s: float = Field(default=0.32, ge=0.05, le=0.4)
    """Largest planned sink rate at contact, for a vehicle that tilts with the pad or against the wind and
    levels off for the contact; lower it for fragile legs, raise it if the vehicle slides at contact in
    strong wind; higher is worse: a harder contact"""
    fastest_contact_m_s: float = Field(default=0.42, ge=0.05, le=1.0)
    """Greatest sink rate at contact: if a greater one is likely, the vehicle rises and waits again. Higher is
    worse: a harder contact. Raise it for a strong landing gear, lower it for a fragile one"""
    break_off_lateral_m: float = Field(default=0.07, gt=0.0, le=0.5)
    """Greatest lateral offset at contact: if a greater one is likely, the final descent does not begin, or is
    broken off. Larger is worse: the feet touch nearer to the edge. Raise it for a large pad in strong gusts,
    lower it for a small one"""
    break_off_above_m: float = Field(default=0.06, ge=0.03, le=1.0)
    """The final descent is broken off only with the feet higher than this, and than the way to stop the sink
    with a tilted foot takes: 8 cm at 0.19 m/s and 10 deg. Raise it for a vehicle that climbs slowly"""
    blend_s: float = Field(default=0.8, ge=0.2, le=3.0)
    """Time of the transition from waiting to the sink rate at contact; raise it for a heavy vehicle"""
    blind_s: float = Field(default=1.5, ge=0.1, le=5.0)
    """If the pad is unseen for this time in the final descent, counted from the last exposure, the vehicle
    climbs and tries again; without room to climb, LAND sets it down. Less than 10 cm over contact it goes on
    while an echo agrees. Longer is worse: the vehicle descends by a prediction. Lower it for a pad that
    changes its course often"""
    overdue_s: float = Field(default=1.5, ge=0.3, le=10.0)
    """If there is no contact within this time after the expected one, the vehicle climbs and tries again; if
    a height shows that the feet are down, or the vehicle has not sunk for as long over a pad out of view,
    LAND is commanded instead. Raise it for a pad whose height is uncertain"""
    escape_lateral_m: float = Field(default=0.18, gt=0.0, le=1.0)
    """Lateral offset in the final descent beyond which the vehicle climbs and tries again. Larger is worse:
    a foot may miss the pad. Raise it for a large pad, lower it for a small one"""
    contact_margin_m: float = Field(default=0.02, gt=0.0, le=0.2)
    """A foot lower than this counts as down by its height: there a contact that is felt is confirmed sooner,
    and an overdue one ends in LAND. Raise it if the height is uncertain"""
    contact_s: float = Field(default=0.15, ge=0.0, le=1.0)
    """Time in which the thrust is taken away once the feet probably stand. Without thrust it is contact: at
    once if a height has the feet down, else after 0.2 s without a fall. Shorter is worse: a false contact
    reduces the thrust in the air. Raise it for a springy landing gear"""
    land_after_s: float = Field(default=1.0, ge=0.5, le=30.0)
    """After this time at rest on the pad without thrust the app disarms, by force if refused. Longer is
    worse: a link lost meanwhile leaves the motors on. Much shorter is worse too: a bounce may look like rest.
    Raise it for a landing gear that bounces"""

    @model_validator(mode="after")
    def _has_room_to_break_off(self) -> TouchdownConfig:
        planned_m_s = max(self.contact_speed_m_s, self.firm_contact_m_s)
        if self.fastest_contact_m_s < planned_m_s + _GUST_M_S:
            raise ValueError(
                f"fastest_contact_m_s {self.fastest_contact_m_s:g}: expected {planned_m_s + _GUST_M_S:g} or "
                f"more, {_GUST_M_S:g} above contact_speed_m_s and firm_contact_m_s"
            )
        if self.break_off_above_m <= 2.0 * self.contact_margin_m:
            raise ValueError(
                f"break_off_above_m {self.break_off_above_m:g}: expected more than twice contact_margin_m, "
                f"{self.contact_margin_m:g}, below which the feet may be on the pad"
            )
        return self


# ---------------------------------------------------------------- obstacles
# As an operator surveys them: upright cylinders and boxes that stand on the ground. Places are north and east
# of home (m), heights over home (m); what is under a top is solid down to the ground. The simulator's
# scenarios describe them by the same models, but share no geometry.

Place = Annotated[float, Field(ge=-2000.0, le=2000.0)]


class Cylinder(StrictModel):
    """A pole, a tree, a silo."""

    kind: Literal["cylinder"]
    centre_ned_m: tuple[Place, Place]
    """North, east of home"""
    radius_m: float = Field(gt=0.0, le=100.0)
    """Radius of its widest part"""
    height_m: float = Field(gt=0.0, le=500.0)
    """Height of its top over home"""


class Box(StrictModel):
    """A wall, a house, a parked truck."""

    kind: Literal["box"]
    centre_ned_m: tuple[Place, Place]
    """North, east of home"""
    length_m: float = Field(gt=0.0, le=500.0)
    """Length along its heading"""
    width_m: float = Field(gt=0.0, le=500.0)
    """Width across its heading"""
    heading_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Heading, clockwise from north"""
    height_m: float = Field(gt=0.0, le=500.0)
    """Height of its top over home"""


Shape = Annotated[Cylinder | Box, Field(discriminator="kind")]
# the ways round so many are ready within seconds; time and memory grow with the cube
MOST_OBSTACLES: Final = 24


# ---------------------------------------------------------------- mission

Height = Annotated[float, Field(ge=1.0, le=50.0)]
# north and east of home (m), and height over home (m, up) where it is not that of the take-off
Waypoint = tuple[Place, Place] | tuple[Place, Place, Height]


class PhaseTimesConfig(StrictModel):
    """How long each phase may last.

    Standby waits for ever; SET_DOWN and AUTO_LAND ask again while the autopilot is heard.
    """

    connect_s: float = Field(default=90.0, ge=5.0, le=3600.0)
    """Longest wait until everything is ready; then the app gives up on the ground; raise it where GPS takes
    longer to a first fix"""
    arm_s: float = Field(default=90.0, ge=2.0, le=300.0)
    """Longest time for arming; a refused request is repeated until then. Raise it for slow pre-arm
    checks"""
    take_off_s: float = Field(default=40.0, ge=5.0, le=300.0)
    """Longest climb; then land; raise it for a slow climb to a high waypoint"""
    waypoint_s: float = Field(default=60.0, ge=5.0, le=1800.0)
    """Longest flight to the waypoint; then the search begins where the vehicle is. Raise it for a far
    waypoint"""
    route_s: float = Field(default=120.0, ge=5.0, le=1800.0)
    """Longest time for the further waypoints, then search; raise it for a long route"""
    search_s: float = Field(default=60.0, ge=5.0, le=600.0)
    """Longest search; then control returns to the autopilot, which holds. Longer is worse: the vehicle
    flies around an assumed position. Raise it for a wide search at a known site"""
    approach_s: float = Field(default=30.0, ge=5.0, le=300.0)
    """Longest approach; then search again; raise it for a far or fast pad"""
    descend_s: float = Field(default=30.0, ge=5.0, le=300.0)
    """Longest descent; then approach again, as a failed try; raise it for a slow descent from high up"""
    touchdown_s: float = Field(default=45.0, ge=5.0, le=300.0)
    """Longest touchdown, disarming included. After that a vehicle that waits or rises over the pad climbs
    clear and returns control to the autopilot; later in the touchdown LAND is commanded. Raise it if
    the pad rarely allows contact, as in high waves"""
    hold_s: float = Field(default=10.0, ge=1.0, le=300.0)
    """Longest hold by the app's own setpoints; then control returns to the autopilot. Shorter is worse:
    control may return low over the pad. Raise it if a pilot needs longer to take over"""


class BatteryConfig(StrictModel):
    """Remaining charge as the autopilot reports it, as shares; nothing follows where it reports none."""

    low: float = Field(default=0.25, ge=0.0, le=0.9, json_schema_extra=OPERATOR)
    """Remaining charge (share) at which no flight and no new try begins; raise it for an old battery or a
    long way home"""
    critical: float = Field(default=0.12, ge=0.0, le=0.9, json_schema_extra=OPERATOR)
    """Remaining charge at which control returns to the autopilot; lower is worse: the vehicle falls when
    the battery is empty. Raise it for an old battery"""
    finish_descent: bool = Field(default=True)
    """Whether a descent over the pad is finished at a critical charge; set it to false if a landing on your
    pad takes longer than the battery lasts"""

    @model_validator(mode="after")
    def _low_before_critical(self) -> Self:
        if self.critical > self.low:
            raise ValueError(f"critical: expected at most low ({self.low:g})")
        return self


class MissionConfig(StrictModel):
    """The flight: where to look for the pad, when to ask again, when to give up."""

    may_arm: bool = Field(default=False, json_schema_extra=OPERATOR)
    """Whether the app may arm and take off (`companion --fly`, `companion order fly`); always allowed with
    `--sitl`. Set it for flights without a pilot's take-off; if it is off, the app only lands a vehicle that
    a pilot or a mission flies"""
    take_off_height_m: float = Field(default=7.0, ge=1.0, le=50.0, json_schema_extra=OPERATOR)
    """Height over home to climb to and to fly at; lower it for a small pad or camera (docs/how-to/pads.md)"""
    waypoint_ned_m: tuple[Place, Place] = Field(default=(10.0, 0.0), json_schema_extra=OPERATOR)
    """North and east of home, where the search begins; set it near the pad"""
    waypoints_ned_m: tuple[Waypoint, ...] = Field(default=(), json_schema_extra=OPERATOR)
    """Further waypoints, flown through by our own setpoints: `[north, east]` or `[north, east, height]`
    (up), from home. Set them if the straight path is not clear (docs/how-to/obstacles.md)"""
    arrival_radius_m: float = Field(default=1.5, ge=0.2, le=20.0)
    """Nearer than this to a waypoint counts as arrived; raise it in strong gusts"""
    arrival_speed_m_s: float = Field(default=0.8, ge=0.1, le=5.0)
    """Slower than this at the waypoint counts as arrived; raise it in strong gusts"""
    align_heading: bool = Field(default=True)
    """Turn to the pad's heading over the pad; set it when the pad's orientation matters, as on a charging
    deck"""
    fence_m: float = Field(default=150.0, ge=10.0, le=2000.0, json_schema_extra=OPERATOR)
    """Distance from home at which control returns to the autopilot, with room to stop, and beyond which no
    beacon is followed; lower it to your site's size. Farther is worse: only this limit stops a vehicle that
    follows a pad away"""
    ceiling_m: float = Field(default=60.0, ge=5.0, le=500.0, json_schema_extra=OPERATOR)
    """Height over home at which control returns to the autopilot, with room to stop; lower it to what is
    allowed where you fly. Higher is worse: a climb caused by a wrong height ends later"""
    pad_speed_m_s: float = Field(default=5.0, gt=0.0, le=30.0)
    """Speed of the pad above which it is not followed; raise it for a faster pad that your vehicle can keep
    up with. Higher is worse: a wrong estimate is followed, and the vehicle needs more room to stop"""
    pad_acceleration_m_s2: float = Field(default=5.0, gt=0.0, le=30.0)
    """Acceleration of the pad above which it is not followed; lower it for a vehicle that tilts little;
    higher is worse: a wrong estimate is followed"""
    largest_speed_std_m_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Largest standard deviation of our velocity away from the pad; beyond it the mission ends. Larger is
    worse: the vehicle flies on with an uncertain speed. Lower it near people or walls, raise it for a poor
    GPS receiver over open ground"""
    largest_round_trip_s: float = Field(default=0.3, gt=0.0, le=2.0)
    """Round-trip time of TIMESYNC above which setpoints arrive too late: control returns to the autopilot,
    and no flight begins. Longer is worse: late setpoints make the vehicle swing. Lower it for a vehicle
    with a quick response"""
    total_timeout_s: float = Field(default=180.0, ge=10.0, le=3600.0)
    """Longest mission, from take-off or from the order to land; then control returns to the autopilot,
    which holds. Set it to your battery; longer is worse: only this limit ends a flight that repeats its
    phases without end"""
    action_retry_s: float = Field(default=2.0, ge=0.2, le=30.0)
    """A refused request is repeated after this time; raise it for an autopilot that answers slowly"""
    action_answer_s: float = Field(default=6.0, ge=0.5, le=60.0)
    """A request without an answer counts as refused after this time; raise it for a slow link"""
    action_attempts: int = Field(default=4, ge=1, le=20)
    """A request is given up after this number of tries; raise it for a lossy link"""
    phases: PhaseTimesConfig = PhaseTimesConfig()
    battery: BatteryConfig = BatteryConfig()


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
        # as long again as a contact is overdue it may take until what stands is told
        missed_s = 2.0 * c.overdue_s
        down_s = c.blend_s + self.landing.wait_height_m / c.contact_speed_m_s + missed_s + c.land_after_s
        if c.giving_up_s + down_s > limit_s:
            raise ValueError(
                f"mission.phases.touchdown_s {limit_s:g}: expected at least {c.giving_up_s + down_s:.1f}, "
                f"touchdown.giving_up_s ({c.giving_up_s:g}) and the way down"
            )
        return self
