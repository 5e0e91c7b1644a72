"""What crosses a border between stages: frozen dataclasses in SI units.

`time_s` is when the thing was measured on the app's monotonic clock (a frame: mid-exposure), never when
it arrived. Frames are in the field's name: `_ned_`, `_body_` (FRD), `_camera_`, `_pad_`.

Relative motion is the pad minus the vehicle's reference point, from the sighting to the controller. A place
in a frame that begins at the pad (`Reference` with origin "pad") is a place like any other: it counts from
the frame's origin.
"""

from __future__ import annotations  # message_json reads the fields' kinds as they are written

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, ZERO3, FloatArray, Quaternion, Vector3, scale
from companion.base.motion import Motion

# ---------------------------------------------------------------- sense

MarkerGroup = Literal["F", "M", "C"]


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One gyroscope and accelerometer sample; at rest and level the specific force is (0, 0, -9.8).

    `interval_s` is the time since the sample before by the sensor's own clock, None where the difference of
    the times is that. A time that was turned from another clock into ours has that mapping's jitter in it,
    an interval has not.
    """

    time_s: float
    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3
    temperature_c: float
    interval_s: float | None = None


@dataclass(frozen=True, slots=True)
class MagSample:
    """One magnetometer sample in body axes, after the factory's sensitivity adjustment."""

    time_s: float
    field_body_ut: Vector3


@dataclass(frozen=True, slots=True)
class GpsFix:
    """One three-dimensional fix (no fix is no message). Altitude (m) is above mean sea level.

    Of a receiver that sends NAV-SOL alone it is above the ellipsoid; its driver says so, and
    `vertical_accuracy_m` contains what the two may differ by.
    `vertical_speed_accuracy_m_s` is given when it differs from `speed_accuracy_m_s`: a source without a
    vertical speed gives 0 with an accuracy that says so.
    """

    time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    velocity_ned_m_s: Vector3
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_m_s: float
    satellites: int
    vertical_speed_accuracy_m_s: float | None = None


@dataclass(frozen=True, slots=True)
class RangeSample:
    """One echo of the downward ultrasonic, along the sensor's axis."""

    time_s: float
    distance_m: float


@dataclass(frozen=True, slots=True)
class AutopilotAttitude:
    """The autopilot's own attitude (body to its NED), when it measured it on our clock.

    `same_imu`: our samples are its IMU's too, by telemetry. `round_trip_s` is the link's; 0: not known.
    `in_air`: it says that it flies.
    """

    time_s: float
    attitude: Quaternion
    same_imu: bool = False
    round_trip_s: float = 0.0
    in_air: bool = False


@dataclass(frozen=True, slots=True)
class Frame:
    """One grey image (height, width), 0 to 255; `time_s` is the middle of its exposure, at the middle row."""

    time_s: float
    received_s: float
    sequence: int
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PadPrior:
    """What the estimators expect of the pad at a frame's exposure; guides search and ambiguity, not pose.

    `pad_position_body_m`/`body_from_pad` are None when the pad's place is unknown; `down_body` is the
    gravity direction, a unit vector, and is known as soon as there is an attitude. `climb_m_s` is how fast
    the height over the pad is expected to change, `rate_body_rad_s` how the vehicle turns meanwhile.
    """

    time_s: float
    down_body: Vector3
    pad_position_body_m: Vector3 | None = None
    body_from_pad: Quaternion | None = None
    position_std_m: float = 1.0
    climb_m_s: float = 0.0
    rate_body_rad_s: Vector3 = ZERO3


@dataclass(frozen=True, slots=True)
class PadSighting:
    """The pad's pose by one frame, body axes: the pad's centre minus the vehicle's reference point, and turn.

    `covariance` is 6x6: position (m) then a small rotation about the body's axes (rad). Of each axis of the
    position's, `common_variance_m2` is no noise: the calibration's error, the same from frame to frame.
    """

    time_s: float
    sequence: int
    pad_position_body_m: Vector3
    body_from_pad: Quaternion
    covariance: FloatArray = field(metadata={"columns": 6})
    group: MarkerGroup
    marker_ids: tuple[int, ...]
    marker_count: dict[MarkerGroup, int]
    reprojection_error_px: float
    common_variance_m2: float = 0.0


@dataclass(frozen=True, slots=True)
class PadBeacon:
    """The pad's own GPS over the link: metres off, or centimetres with RTK.

    Its clock is not ours: `time_s` is the arrival's, `fix_time_s` its own, 0 for none. Standard deviations
    are an axis's; `vertical_std_m` None: 1.5 times the horizontal one's, `velocity_std_m_s` None: the
    velocity is not measured.
    """

    time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    velocity_ned_m_s: Vector3
    position_std_m: float
    vertical_std_m: float | None = None
    velocity_std_m_s: float | None = None
    fix_time_s: float = 0.0


# what measures where the pad is, by the topic of the log in which it is recorded
PadObservation = PadSighting | PadBeacon
PAD_OBSERVATIONS: Final[dict[str, type[PadObservation]]] = {"sighting": PadSighting, "beacon": PadBeacon}


@dataclass(frozen=True, slots=True)
class FrameReport:
    """What became of a frame, seen or not: for the status line, the log and the score."""

    time_s: float
    received_s: float
    done_s: float
    sequence: int
    marker_count: dict[MarkerGroup, int]
    seen: bool
    searched_whole_frame: bool


# ---------------------------------------------------------------- estimate


@dataclass(frozen=True, slots=True)
class InputUse:
    """How many measurements of an input the estimator has used and refused since its start.

    `refused_in_a_row` counts since the last one used; `reason` is why the last one was refused, "" for none.
    """

    name: str
    used: int
    refused: int
    refused_in_a_row: int
    reason: str


@dataclass(frozen=True, slots=True)
class EstimatorInputs:
    """What became of the estimator's inputs until time_s."""

    time_s: float
    inputs: tuple[InputUse, ...]


IMU_TIMEOUT_S: Final = 1.5  # without the IMU for longer there is no state of the vehicle to report
ACCELERATION_FILTER_S: Final = 0.02  # low-pass of `VehicleState`'s acceleration and side force
IMU_PREDICTED_S: Final = 0.1  # beyond its newest sample motion is carried on for so long; then it is unknown


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The vehicle at time_s by the 31-state EKF.

    `position_ned_m` counts from `origin` (latitude deg, longitude deg, altitude m), which is the first GPS
    fix and None before it. Over the time since the newest IMU sample, `imu_age_s`, it is predicted, and over
    what the link is known to be late by besides.
    `side_force_ned_m_s2` is the part of the acceleration that no thrust makes (see `geometry.side_force`),
    `acceleration_density_m2_s3` the density of the accelerometer's noise on an axis, lately.
    """

    time_s: float
    attitude: Quaternion
    rate_body_rad_s: Vector3
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    gyro_bias_rad_s: Vector3
    accel_bias_m_s2: Vector3
    attitude_std_rad: float
    velocity_std_m_s: float
    position_std_m: float
    aligned: bool
    has_gps: bool
    origin: Vector3 | None = None
    imu_age_s: float = 0.0
    side_force_ned_m_s2: Vector3 = ZERO3
    acceleration_density_m2_s3: float = 0.0

    @property
    def sensed_time_s(self) -> float:
        """When the newest IMU sample was, by which the estimate goes."""
        return self.time_s - self.imu_age_s


@dataclass(frozen=True, slots=True)
class PadState:
    """The pad at time_s by the relative-motion filter; plan and control use this form, and no other.

    Relative means pad minus vehicle (reference point), NED axes: straight above the pad the relative
    position is (0, 0, +height). `covariance`, six rows of six, is that of relative position and velocity,
    the horizon's and the calibration's errors included. `turn_rate_rad_s` is that of the pad's course,
    `jerk_ned_m_s3` what its acceleration changes by beyond turning, `models` the probability of each model
    of its motion. `delay_s` is how long after its exposure the last sighting came, as the planner notes it;
    elsewhere it is 0.

    It is seen or predicted, and there is none only before the first sighting and `forget_s` (10 s) after the
    last. `age_s`, since the last exposure, is how old the knowledge is: approach, descent, `blind_s` and the
    signs of contact go by it. `unseen_s`, since that sighting came, is whether the camera still sees the pad:
    the wait over it and all that has to be seen at contact (`UNSEEN_S`) go by that.

    `seen_velocity_ned_m_s` is the relative velocity without what the vehicle has accelerated since the last
    sighting: where something else than the air pushed it, as at a contact, the pad may have been pushed too.

    The tilt is the horizontal part (north, east) of the pad's normal, which points down: rad while it is
    small. It swings about its mean by `tilt_swing_rad` (root mean square, both axes together) at
    `tilt_frequency_rad_s`; 0: it does not.
    """

    time_s: float
    relative_position_ned_m: Vector3
    relative_velocity_ned_m_s: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    heading_rad: float
    heading_rate_rad_s: float
    position_std_m: float
    velocity_std_m_s: float
    seen_time_s: float
    covariance: tuple[tuple[float, ...], ...] = field(default=(), metadata={"columns": 6})
    turn_rate_rad_s: float = 0.0
    jerk_ned_m_s3: Vector3 = ZERO3
    models: dict[str, float] = field(default_factory=dict)
    delay_s: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    tilt_rate_rad_s: tuple[float, float] = (0.0, 0.0)
    tilt_mean_rad: tuple[float, float] = (0.0, 0.0)
    tilt_swing_rad: float = 0.0
    tilt_frequency_rad_s: float = 0.0
    seen_velocity_ned_m_s: Vector3 = ZERO3

    @property
    def height_m(self) -> float:
        """Height (m) of the vehicle's reference point over the pad."""
        return self.relative_position_ned_m[2]

    @property
    def clearance_m(self) -> float:
        """Distance (m) of the vehicle's reference point from the pad's plane, along its normal.

        Of a vehicle that stands on a deck that rocks it stays the same, wherever the vehicle stands.
        """
        (north, east, down), (tilt_n, tilt_e) = self.relative_position_ned_m, self.tilt_rad
        upright = math.sqrt(max(0.0, 1.0 - tilt_n * tilt_n - tilt_e * tilt_e))
        return tilt_n * north + tilt_e * east + upright * down

    @property
    def sink_m_s(self) -> float:
        """Speed (m/s) at which that height decreases."""
        return -self.relative_velocity_ned_m_s[2]

    @property
    def lateral_m(self) -> float:
        """Horizontal distance (m) between the vehicle's reference point and the pad's centre."""
        return math.hypot(self.relative_position_ned_m[0], self.relative_position_ned_m[1])

    @property
    def lateral_speed_m_s(self) -> float:
        """Horizontal speed (m/s) between the two."""
        return math.hypot(self.relative_velocity_ned_m_s[0], self.relative_velocity_ned_m_s[1])

    @property
    def height_std_m(self) -> float:
        """Standard deviation (m) of `height_m`; without a covariance it is not known at all."""
        return math.sqrt(max(0.0, self.covariance[2][2])) if self.covariance else math.inf

    @property
    def sink_std_m_s(self) -> float:
        """Standard deviation (m/s) of `sink_m_s`; without a covariance it is not known at all."""
        return math.sqrt(max(0.0, self.covariance[5][5])) if self.covariance else math.inf

    def lateral_std_m(self, ahead_s: float = 0.0) -> float:
        """Standard deviation (m) of the horizontal relative position on an axis, `ahead_s` from `time_s`.

        At constant relative velocity; the mean of both axes' variances. 0 without a covariance.
        """
        if not self.covariance:
            return 0.0
        P = self.covariance
        variances = (P[k][k] + 2.0 * ahead_s * P[k][k + 3] + ahead_s**2 * P[k + 3][k + 3] for k in (0, 1))
        return math.sqrt(max(0.0, 0.5 * sum(variances)))

    @property
    def age_s(self) -> float:
        """Time (s) since the exposure in which the pad was last seen."""
        return max(0.0, self.time_s - self.seen_time_s)

    @property
    def unseen_s(self) -> float:
        """Time (s) since the last sighting came: its age without the camera's and the vision's delay."""
        return max(0.0, self.age_s - self.delay_s)

    @property
    def vehicle_from_pad(self) -> Motion:
        """The vehicle, without acceleration, in the frame of a `Reference` with origin "pad".

        A place in that frame counts from the pad, so it is minus the relative position.
        """
        return Motion(scale(self.relative_position_ned_m, -1.0), scale(self.relative_velocity_ned_m_s, -1.0))


@dataclass(frozen=True, slots=True)
class CarriedPad:
    """The pad at time_s by what carries its estimate while the camera does not see it.

    Enough to fly to it and to wait over it, never to land on it. Relative to the vehicle as in `PadState`;
    `lateral_std_m` is of an axis, `observed_time_s` when it was last heard of.
    """

    time_s: float
    relative_position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    lateral_std_m: float
    observed_time_s: float


# ---------------------------------------------------------------- plan


class Phase(StrEnum):
    """The states of the mission, in the order of a good flight; standby, hold and abort are not."""

    STANDBY = "standby"
    CONNECT = "connect"
    ARM = "arm"
    TAKE_OFF = "take_off"
    WAYPOINT = "waypoint"
    ROUTE = "route"
    SEARCH = "search"
    APPROACH = "approach"
    DESCEND = "descend"
    TOUCHDOWN = "touchdown"
    LANDED = "landed"
    HOLD = "hold"
    ABORT = "abort"


class Outcome(StrEnum):
    """How a simulated flight ended, judged by the truth."""

    LANDED = "landed"
    MISSED = "missed"
    ABORTED = "aborted"
    TIMEOUT = "timeout"
    CRASHED = "crashed"


class ActionKind(StrEnum):
    """What a mission asks of the autopilot besides setpoints."""

    ARM = "arm"
    TAKE_OFF = "take_off"
    GO_TO = "go_to"
    TAKE_CONTROL = "take_control"
    HOLD_IF_OBEYED = "hold_if_obeyed"  # a HOLD, if a TAKE_CONTROL was obeyed
    LEAVE_OFFBOARD = "leave_offboard"
    HOLD = "hold"
    LAND = "land"
    DISARM = "disarm"
    REQUEST_PAD_POSITION = "request_pad_position"


@dataclass(frozen=True, slots=True)
class Action:
    """One request to the autopilot or the ground station.

    `position` is latitude (deg), longitude (deg) and height over home (m); so is `height_m`, over home: to
    take off to, and for a HOLD to rise to first unless 0. A DISARM is asked plainly; with `force` then by
    force, where the autopilot refuses because it considers itself in the air: in the air that drops the
    vehicle, so only one that is shown to rest on the pad for `land_after_s`, or to lie on its side, gets it.
    """

    kind: ActionKind
    height_m: float = 0.0
    position: Vector3 | None = None
    heading_rad: float | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class ActionResult:
    """How an action ended; a refused one carries the autopilot's text.

    `in_doubt`: it left, and neither was it denied nor has the autopilot's state shown it: an answer was lost.
    None: it never left, so that it says nothing of what was asked for before.
    """

    time_s: float
    kind: ActionKind
    accepted: bool
    text: str = ""
    in_doubt: bool | None = False


@dataclass(frozen=True, slots=True)
class DescentCone:
    """How far aside of the pad a descent may be: radius_m + slope * (height over the pad - apex_height_m)."""

    slope: float
    radius_m: float
    apex_height_m: float


@dataclass(frozen=True, slots=True)
class LevelOff:
    """When (app's clock) the vehicle may be tilted by no more than tilt_rad: its feet are about to touch."""

    from_s: float
    until_s: float
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the vehicle should be over the coming horizon, one row a step.

    origin "pad": rows count from the pad and move with it, NED axes (above the pad z is negative).
    origin "local": rows count from the EKF's origin, NED.
    Arrays are (n, 3); row k holds at time_s + k * step_s. `minimum_height_m` and `cone` bound where the
    vehicle may be about the pad, with origin "pad" alone.
    """

    time_s: float
    origin: Literal["pad", "local"]
    step_s: float
    position_m: FloatArray = field(metadata={"columns": 3})
    velocity_m_s: FloatArray = field(metadata={"columns": 3})
    acceleration_m_s2: FloatArray = field(metadata={"columns": 3})
    heading_rad: float
    minimum_height_m: float | None = None
    cone: DescentCone | None = None
    level_off: LevelOff | None = None


@dataclass(frozen=True, slots=True)
class Notice:
    """Something worth telling: to the log, the terminal and, as STATUSTEXT, the ground station."""

    time_s: float
    kind: str
    text: str
    severity: Literal["info", "warning", "error"] = "info"


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the speed of approach and descent goes by beside the way to go; `pace` is the factor on it.

    `sight_rad` is the standard deviation of the pad's place as an angle seen from the vehicle,
    `relative_speed_m_s` the horizontal speed over the pad beyond the planned, `gust_m_s2` the standard
    deviation of the horizontal acceleration that the wind makes.
    """

    sight_rad: float
    relative_speed_m_s: float
    gust_m_s2: float
    pace: float = 1.0


@dataclass(frozen=True, slots=True)
class PlanStep:
    """What the planner makes of one cycle. No reference: no setpoint leaves.

    `on_ground`: the thrust is taken away, on the pad in the state STAND or AUTO_LAND, or on its side.
    `unloading`: the share of the thrust (0 to 1) to take away, since the feet may stand. `feet_near`: so low
    that, with no sink asked for, what holds it up may be what the feet stand on. `contact_probability`: that
    they stand on the pad, in the final descent.
    """

    time_s: float
    phase: Phase
    reference: Reference | None = None
    actions: tuple[Action, ...] = ()
    notices: tuple[Notice, ...] = ()
    speed_m_s: float = 0.0
    time_to_go_s: float = 0.0
    on_ground: bool = False
    conditions: Conditions | None = None
    unloading: float = 0.0
    feet_near: bool = False
    contact_probability: float = 0.0


# ---------------------------------------------------------------- control


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What leaves for the autopilot, in our NED; the link turns it into the autopilot's heading.

    `attitude` and `thrust` (0..1 of the autopilot's scale) are set in attitude mode only. Unless
    `holds_horizontal_velocity`, the horizontal velocity is for the log alone and is not sent.
    """

    time_s: float
    velocity_ned_m_s: Vector3 = ZERO3
    acceleration_ned_m_s2: Vector3 = ZERO3
    heading_rad: float = 0.0
    heading_rate_rad_s: float = 0.0
    attitude: Quaternion | None = None
    thrust: float | None = None
    exposure_time_s: float | None = None
    holds_horizontal_velocity: bool = True


@dataclass(frozen=True, slots=True)
class LandingTargetPose:
    """The pad, sent to an autopilot that lands on it by itself; `time_s` is the exposure that shows it.

    `position_body_m`: the pad's centre minus the vehicle's reference point, body axes at the exposure.
    `position_ned_m`: its place in the autopilot's own local NED, for one that takes that alone; else None.
    `attitude`: the pad's, in the frame of the position that is sent. `size_rad`: its width and length as seen
    from the vehicle.
    """

    time_s: float
    position_body_m: Vector3
    attitude: Quaternion
    size_rad: tuple[float, float]
    position_ned_m: Vector3 | None = None


@dataclass(frozen=True, slots=True)
class ControlReport:
    """How a setpoint came about: for the log and the status line.

    Not `solved`: the last plan was flown on; `late`: the clock ended the search; `stopped`: for want of a
    plan the vehicle was commanded to stand still. `hover_thrust` is the share of full thrust that carries the
    weight, as learnt by then; while not `obeyed`, the autopilot receives setpoints without following them.
    `blind`: for want of IMU samples it flew on by its last motion or the pad's. `cut_s`: for how long in a
    row what was flown is the optimum without constraints, cut to the inputs' bounds. `cycle_late_s` is how
    much later than due the cycle began: the event loop's delay. `failure`: why no plan is flown; "" while
    one is. `short_of`: what there has been too little of for a while ("thrust", "tilt").
    """

    time_s: float
    solved: bool
    iterations: int
    solve_s: float
    limited: tuple[str, ...] = ()
    disturbance_ned_m_s2: Vector3 = ZERO3
    predicted_position_m: FloatArray = field(
        default_factory=lambda: np.zeros((0, 3)), metadata={"columns": 3}
    )
    late: bool = False
    stopped: bool = False
    hover_thrust: float | None = None
    obeyed: bool = True
    blind: bool = False
    cycle_late_s: float = 0.0
    cut_s: float = 0.0
    failure: str = ""
    short_of: str = ""


# ---------------------------------------------------------------- link

UNKNOWN_TIMEOUT_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class AutopilotSetup:
    """What the autopilot's parameters say of how it obeys; None: unknown.

    `acceleration_m_s2` and `jerk_m_s3` bind velocity setpoints sideways. When setpoints stop, it keeps the
    last one for `setpoint_timeout_s`; then `setpoints_lost_action` follows (PX4's COM_OBL_RC_ACT), or
    (ArduPilot) it keeps level and its height, and goes with the wind until `drift_ends`, if anything does it.
    `guided_options`: ArduPilot's GUID_OPTIONS, which say what an attitude setpoint's thrust is.
    """

    tilt_deg: float | None = None
    hover_thrust: float | None = None
    acceleration_m_s2: float | None = None
    jerk_m_s3: float | None = None
    setpoint_timeout_s: float | None = None
    setpoints_lost_action: int | None = None
    drift_ends: bool | None = None
    guided_options: int | None = None

    @property
    def keeps_setpoint_s(self) -> float:
        """How long (s) it goes by the last setpoint; where it does not say, as short as any should."""
        return UNKNOWN_TIMEOUT_S if self.setpoint_timeout_s is None else self.setpoint_timeout_s


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """Whether the autopilot still goes by what we send: five degrees of one silence, by its own time-outs.

    With a `keeps_setpoint_s` of 0.5 s and `link.heartbeat_timeout_s` as delivered: `fresh` below 0.3 s,
    `maybe_unheard` above 0.25 s, `silent` from 0.4 s, `gave_up_setpoints` from 0.5 s, `lost` above 3 s.

    `silent_s`: since anything was last heard of it, or showed that it hears us, seen by an app that runs.
    `keeps_setpoint_s`: for how long it goes by the last setpoint that arrived. `lost_after_s`: a link that is
    silent for longer is lost.
    """

    silent_s: float = 0.0
    keeps_setpoint_s: float = UNKNOWN_TIMEOUT_S
    lost_after_s: float = math.inf

    @property
    def fresh(self) -> bool:
        """What it does is what it was asked for. Its attitude alone is sent at 50 Hz."""
        return self.silent_s < 0.3

    @property
    def maybe_unheard(self) -> bool:
        """Setpoints may have stopped arriving: a mode that it tells of next may be its own failsafe's."""
        return self.silent_s > 0.5 * self.keeps_setpoint_s

    @property
    def silent(self) -> bool:
        """It soon flies by itself, if it does not already: what it does says nothing by what we command."""
        return self.silent_s >= 0.8 * self.keeps_setpoint_s

    @property
    def gave_up_setpoints(self) -> bool:
        """It has given our setpoints up, unless they arrive all the same."""
        return self.silent_s >= self.keeps_setpoint_s

    @property
    def lost(self) -> bool:
        """Nothing has shown for as long as after which a link is lost that it hears us."""
        return self.silent_s > self.lost_after_s


class LandedState(StrEnum):
    """MAV_LANDED_STATE."""

    UNDEFINED = "undefined"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKEOFF = "takeoff"
    LANDING = "landing"


@dataclass(frozen=True, slots=True)
class AutopilotState:
    """The newest of what the autopilot says of itself. Its frame and origin are its own, not ours.

    `landed` and `global_position` are forgotten when no new one comes.
    `ready_to_arm` is what it says of its checks before arming. An ArduPilot makes them for the mode it is in,
    and STABILIZE needs no position: `ekf_ready` is whether its filter knows enough for GUIDED; None where
    nothing of the kind is reported (PX4). `battery_share` is the remaining charge, 0 to 1; None: not known.
    Both come in SYS_STATUS, the last at `status_time_s`, and are forgotten when no new one comes.
    `intended_mode`: the one that was asked for last, by a pilot or by us, while a failsafe may fly another;
    "" where it is not reported (ArduPilot, PX4 before 1.15).
    `motors_cut`: by the pilot's kill switch, the emergency stop, or the flight's termination.
    `round_trip_s`: how long a question and its answer take on the link, the quickest of the last three, at
    `round_trip_time_s`; None: not known. `twin_time_s`: when another companion with our ids was last
    received, whose setpoints and requests would be taken for ours. `rival`: system and component of who else
    has sent setpoints to the vehicle, last at `rival_time_s`. `refused_frames`: what came without a
    right signature, where the link demands one. `mavlink_1`: it speaks version 1 alone, which is not
    listened to; PX4 begins so, until it receives our version 2. `thrust`: what its rotors are asked for, as
    a share of full thrust (ArduPilot: the upward part), measured at `thrust_time_s`. `velocity_ned_m_s`: by
    its own filter, where that does not say that it knows none, measured at `velocity_time_s`.
    `version`: of its firmware: major, minor and patch.
    """

    time_s: float
    connected: bool = False
    autopilot_kind: AutopilotKind | None = None
    armed: bool = False
    mode: str = ""
    intended_mode: str = ""
    offboard: bool = False
    ready_to_arm: bool = False
    ekf_ready: bool | None = None
    landed: LandedState = LandedState.UNDEFINED
    landed_time_s: float = float("-inf")
    attitude: Quaternion | None = None
    attitude_time_s: float = float("-inf")
    global_position: Vector3 | None = None
    global_position_time_s: float = float("-inf")
    velocity_ned_m_s: Vector3 | None = None
    velocity_time_s: float = float("-inf")
    home: Vector3 | None = None
    texts: tuple[str, ...] = ()
    battery_share: float | None = None
    status_time_s: float = float("-inf")
    motors_cut: bool = False
    refused_frames: int = 0
    mavlink_1: bool = False
    version: tuple[int, int, int] | None = None
    round_trip_s: float | None = None
    round_trip_time_s: float = float("-inf")
    twin_time_s: float = float("-inf")
    rival: tuple[int, int] | None = None
    rival_time_s: float = float("-inf")
    thrust: float | None = None
    thrust_time_s: float = float("-inf")


# ---------------------------------------------------------------- orders


class OrderKind(StrEnum):
    """What may be asked for."""

    LAND = "land"  # take over where the vehicle flies, find the pad, land, disarm
    FLY = "fly"  # the whole flight: arm, take off, waypoint, land
    STOP = "stop"  # return control to the autopilot, which holds its position


class OrderOutcome(StrEnum):
    """The words of MAVLink's MAV_RESULT."""

    IN_PROGRESS = "in_progress"
    ACCEPTED = "accepted"  # carried out
    TEMPORARILY_REJECTED = "temporarily_rejected"  # not now
    DENIED = "denied"  # not with these settings
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class Order:
    """One order; `source` says in words where it came from."""

    time_s: float
    kind: OrderKind
    source: str


@dataclass(frozen=True, slots=True)
class OrderReply:
    """What became of an order: first refused or in progress, later how it ended."""

    time_s: float
    kind: OrderKind
    source: str
    outcome: OrderOutcome
    text: str = ""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why an order is not carried out; `lasting`: the settings forbid it, not the moment."""

    text: str
    lasting: bool = False


# ---------------------------------------------------------------- two sources of one number


class Quantity(StrEnum):
    """What holds the vehicle up, and is not believed on one word; see `companion.base.second_sources`."""

    HOVER_THRUST = "hover thrust"
    ATTITUDE = "attitude"
    HEADING = "heading"
    VELOCITY = "velocity"
    DECLINATION = "magnetic declination"
    HEIGHT_OVER_PAD = "height over the pad"
    PAD_SCALE = "pad's scale"
    CAMERA_ROTATION = "camera's rotation"
    CAMERA_DELAY = "camera's delay"
    IMU_DELAY = "IMU's delay"
    LEG_HEIGHT = "leg height"
    LINK_DELAY = "link's delay"
    CLOCK_RATE = "clock rate"
    BATTERY = "battery"


@dataclass(frozen=True, slots=True)
class SourceComparison:
    """What two sources say of a quantity at time_s, in words with their units, and how far they are apart.

    `difference` (not negative) and its standard deviation `std` are in the unit of the quantity's row.
    """

    time_s: float
    quantity: Quantity
    first: str
    second: str
    difference: float
    std: float


# ---------------------------------------------------------------- the simulator's truth


@dataclass(frozen=True, slots=True)
class Truth:
    """The simulator's world at time_s. Goes to the score and the plots, never to the app."""

    time_s: float
    vehicle_position_ned_m: Vector3
    vehicle_velocity_ned_m_s: Vector3
    vehicle_attitude: Quaternion
    pad_position_ned_m: Vector3
    pad_velocity_ned_m_s: Vector3
    pad_heading_rad: float
    wind_ned_m_s: Vector3 = ZERO3
    in_contact: bool = False
    rate_body_rad_s: Vector3 = ZERO3
    attitude_setpoint: Quaternion = IDENTITY
    pad_roll_rad: float = 0.0
    pad_pitch_rad: float = 0.0
    obstacle_clearance_m: float | None = None  # from the rotors' tips; None without obstacles


@dataclass(frozen=True, slots=True)
class ContactResult:
    """A contact with pad or ground: its first touch, and the worst of its touches, relative to what it met.

    `violations`: what of it makes the flight a failed one.
    """

    time_s: float
    surface: Literal["pad", "ground"]
    position_ned_m: Vector3
    lateral_error_m: float
    vertical_speed_m_s: float
    horizontal_speed_m_s: float
    tilt_deg: float
    touches: int
    violations: tuple[str, ...]
