"""What crosses a border between stages: frozen dataclasses in SI units.

`time_s` is when the thing was measured on the app's monotonic clock (a frame: mid-exposure), never when
it arrived. Frames are in the field's name: `_ned_`, `_body_` (FRD), `_camera_`, `_pad_`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, ZERO3, FloatArray, Quaternion, Vector3

MarkerGroup = Literal["F", "M", "C"]
Manner = AutopilotKind


# ---------------------------------------------------------------- sense


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
    """One three-dimensional fix (no fix is no message).

    `vertical_speed_accuracy_m_s` is told when it differs from `speed_accuracy_m_s`: a source without a
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

    `same_imu`: our samples are its IMU's too, by telemetry.
    """

    time_s: float
    attitude: Quaternion
    same_imu: bool = False


@dataclass(frozen=True, slots=True)
class Frame:
    """One grey image."""

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
    """The pad's pose from one frame, body axes, origin the vehicle's reference point.

    `covariance` is 6x6: position (m) then a small rotation about the body's axes (rad). Of each axis of the
    position's, `common_variance_m2` is no noise: the calibration's error, the same from frame to frame.
    """

    time_s: float
    sequence: int
    pad_position_body_m: Vector3
    body_from_pad: Quaternion
    covariance: FloatArray
    group: MarkerGroup
    marker_ids: tuple[int, ...]
    marker_count: dict[MarkerGroup, int]
    reprojection_error_px: float
    common_variance_m2: float = 0.0


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
class VehicleState:
    """The vehicle at time_s by the 31-state EKF.

    `position_ned_m` counts from `origin` (latitude deg, longitude deg, altitude m), which is the first GPS
    fix and None before it. Of the time since the newest IMU sample, `imu_age_s`, it is foretold.
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


@dataclass(frozen=True, slots=True)
class PadState:
    """The pad at time_s by the relative-motion filter.

    Relative means pad minus vehicle (reference point), NED axes: straight above the pad the relative
    position is (0, 0, +height). `covariance`, six rows of six, is that of relative position and velocity,
    the horizon's and the calibration's errors included. `turn_rate_rad_s` is that of the pad's course,
    `models` the probability of each model of its motion.
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
    covariance: tuple[tuple[float, ...], ...] = ()
    turn_rate_rad_s: float = 0.0
    models: dict[str, float] = field(default_factory=dict)

    @property
    def height_m(self) -> float:
        """Height (m) of the vehicle's reference point over the pad."""
        return self.relative_position_ned_m[2]


# ---------------------------------------------------------------- link: what comes back


@dataclass(frozen=True, slots=True)
class AutopilotSetup:
    """What the autopilot's parameters say of how it obeys; None: not told.

    `acceleration_m_s2` and `jerk_m_s3` bind velocity setpoints sideways.
    """

    tilt_deg: float | None = None
    hover_thrust: float | None = None
    acceleration_m_s2: float | None = None
    jerk_m_s3: float | None = None


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

    `ready_to_arm` is what it says of its checks before arming. An ArduPilot makes them for the mode it is in,
    and STABILIZE needs no position: `ekf_ready` is whether its filter knows enough for GUIDED; None where
    nothing of the kind is told (PX4).
    """

    time_s: float
    connected: bool = False
    manner: Manner | None = None
    armed: bool = False
    mode: str = ""
    offboard: bool = False
    ready_to_arm: bool = False
    ekf_ready: bool | None = None
    landed: LandedState = LandedState.UNDEFINED
    landed_time_s: float = float("-inf")
    attitude: Quaternion | None = None
    attitude_time_s: float = float("-inf")
    position_ned_m: Vector3 | None = None
    velocity_ned_m_s: Vector3 | None = None
    global_position: Vector3 | None = None
    home: Vector3 | None = None
    texts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PadBeacon:
    """The pad's own GPS, sent by the ground station (MAVLink FOLLOW_TARGET): metres, not centimetres."""

    time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    velocity_ned_m_s: Vector3
    position_std_m: float


# ---------------------------------------------------------------- plan


class Phase(StrEnum):
    """The states of the mission, in the order of a good flight; the last two are not."""

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
    HOLD = "hold"
    LAND = "land"
    DISARM = "disarm"
    REQUEST_PAD_POSITION = "request_pad_position"


@dataclass(frozen=True, slots=True)
class Action:
    """One request to the autopilot or the ground station.

    `position` is latitude (deg), longitude (deg) and height over home (m). `force` lets a DISARM through
    that the autopilot refuses because it believes itself in the air: in the air it drops the vehicle, so
    only a touchdown that several signs have confirmed for seconds may ask for it.
    """

    kind: ActionKind
    height_m: float = 0.0
    position: Vector3 | None = None
    heading_rad: float | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class ActionResult:
    """How an action ended; a refused one carries the autopilot's words."""

    time_s: float
    kind: ActionKind
    accepted: bool
    text: str = ""


@dataclass(frozen=True, slots=True)
class DescentCone:
    """How far aside of the pad a descent may be: radius_m + slope * (height over the pad - apex_height_m)."""

    slope: float
    radius_m: float
    apex_height_m: float


@dataclass(frozen=True, slots=True)
class LevelOff:
    """When (app's clock) the vehicle may lean no further than tilt_rad: its feet are about to touch."""

    from_s: float
    until_s: float
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the vehicle should be over the coming horizon, one row a step.

    origin "pad": rows are the vehicle minus the pad, NED axes (above the pad z is negative).
    origin "local": rows are in the EKF's NED.
    Arrays are (n, 3); row k holds at time_s + k * step_s. `minimum_height_m` and `cone` bound where the
    vehicle may be about the pad, with origin "pad" alone.
    """

    time_s: float
    origin: Literal["pad", "local"]
    step_s: float
    position_m: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray
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
class PlanStep:
    """What the planner makes of one cycle. No reference: no setpoint leaves."""

    time_s: float
    phase: Phase
    reference: Reference | None = None
    actions: tuple[Action, ...] = ()
    notices: tuple[Notice, ...] = ()
    speed_m_s: float = 0.0
    time_to_go_s: float = 0.0
    on_ground: bool = False


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
class ControlReport:
    """How a setpoint came about: for the log and the status line.

    Not `solved`: the last plan was flown on; `late`: the clock ended the search; `stopped`: for want of a
    plan the vehicle was told to stand still. `hover_thrust` is the share of full thrust that carries the
    weight, as learnt by then; while not `obeyed`, the autopilot hears setpoints without following them.
    `blind`: for want of IMU samples the vehicle was told not to accelerate. `cycle_late_s` is how much later
    than due the cycle began: the event loop's delay.
    """

    time_s: float
    solved: bool
    iterations: int
    solve_s: float
    limited: tuple[str, ...] = ()
    disturbance_ned_m_s2: Vector3 = ZERO3
    predicted_position_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    late: bool = False
    stopped: bool = False
    hover_thrust: float | None = None
    obeyed: bool = True
    blind: bool = False
    cycle_late_s: float = 0.0


# ---------------------------------------------------------------- truth: the simulator's, for scoring alone


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
