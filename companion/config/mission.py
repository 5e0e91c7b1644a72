"""Settings of the mission: waypoints, bounds, phases and battery."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from companion.config.obstacles import Place
from companion.config.reading import OPERATOR, StrictModel

Height = Annotated[float, Field(ge=1.0, le=50.0)]
# north and east of home (m), and height over home (m, up) where it is not that of the take-off
Waypoint = tuple[Place, Place] | tuple[Place, Place, Height]


class PhaseTimesConfig(StrictModel):
    """How long each phase may last; standby waits for ever, and AUTO_LAND asks again while it is heard."""

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
    waiting for a gentle moment takes longer, as in high waves"""
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
    allowed where you fly. Higher is worse: a climb by a wrong height ends later"""
    pad_speed_m_s: float = Field(default=5.0, gt=0.0, le=30.0)
    """Speed of the pad above which it is not followed; raise it for a faster pad that your vehicle can keep
    up with. Higher is worse: a wrong estimate is followed, and the vehicle needs more room to stop"""
    pad_acceleration_m_s2: float = Field(default=5.0, gt=0.0, le=30.0)
    """Acceleration of the pad above which it is not followed; lower it for a vehicle that tilts little;
    higher is worse: a wrong estimate is followed"""
    largest_speed_std_m_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Away from the pad: a larger uncertainty of our velocity ends the mission. Larger is worse: the
    vehicle flies on with an uncertain speed. Lower it near people or walls, raise it for a poor GPS
    receiver over open ground"""
    largest_round_trip_s: float = Field(default=0.3, gt=0.0, le=2.0)
    """Round-trip time of TIMESYNC above which setpoints arrive too late: control returns to the autopilot,
    and no flight begins. Longer is worse: late setpoints make the vehicle swing. Lower it for a vehicle
    with a quick response"""
    total_timeout_s: float = Field(default=180.0, ge=10.0, le=3600.0)
    """Longest mission, from take-off or from the order to land; then control returns to the autopilot,
    which holds. Set it to your battery; longer is worse: only this limit ends a flight that repeats its
    phases without end"""
    action_retry_s: float = Field(default=2.0, ge=0.2, le=30.0)
    """A refused request is repeated after this; raise it for an autopilot that answers slowly"""
    action_answer_s: float = Field(default=6.0, ge=0.5, le=60.0)
    """A request without an answer counts as refused after this; raise it for a slow link"""
    action_attempts: int = Field(default=4, ge=1, le=20)
    """A request is given up after this number of tries; raise it for a lossy link"""
    phases: PhaseTimesConfig = PhaseTimesConfig()
    battery: BatteryConfig = BatteryConfig()
