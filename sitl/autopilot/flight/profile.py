"""An autopilot's profile: what differs between PX4 and ArduPilot, as fields of one table.

`px4.profile.PX4` and `ardupilot.profile.ARDUPILOT` are its instances. Other code reads the fields and never
checks which autopilot it is.

The simulated autopilot's parameter table: what a ground station lists, reads and sets.

Small: the flight code reads the ones that act in flight, the others describe the vehicle. Values keep
the unit that the real autopilot gives them (ArduPilot: cm/s, cm); `ParameterRef` carries the factor to SI.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import Quaternion, Vector3
from sitl.autopilot.control.attitude_control import AttitudeGains
from sitl.autopilot.control.position_control import PositionControl
from sitl.autopilot.control.setpoints import (
    AttitudeSetpoint,
    MotionSetpoint,
    SetpointRefusal,
    StreamedAttitude,
    StreamedMotion,
)
from sitl.autopilot.flight.mission_items import MissionRules
from sitl.autopilot.flight.modes import (
    ArmingCheck,
    CommandResult,
    Failsafe,
    Mode,
    ModeCheck,
    Severity,
    Task,
    VehicleStatus,
)


class LandingTargetFrame(IntEnum):
    """MAV_FRAME of a target's position, of the supported ones."""

    LOCAL_NED = 1
    BODY_FRD = 12


@dataclass(frozen=True, slots=True)
class LandingTarget:
    """One LANDING_TARGET: a position in `frame` (a MAV_FRAME), or None and the angles off the camera's axis.

    `angles_rad`: to the right, and backwards (angle_y = -forward); `distance_m` 0: unknown.
    """

    frame: int
    position_m: Vector3 | None
    angles_rad: tuple[float, float]
    distance_m: float


class VehicleEstimate(NamedTuple):
    """The autopilot's estimate of the vehicle at one outer step; height over home (m)."""

    now_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    attitude: Quaternion
    height_m: float
    landing_speed_m_s: float


class PrecisionLanding(ABC):
    """An autopilot's own precision landing; `texts` are for the ground."""

    def __init__(self) -> None:
        self.texts: list[tuple[Severity, str]] = []
        self._pending: LandingTarget | None = None
        self._seen_s = -math.inf
        self._frame_reported = False

    def update_target(self, target: LandingTarget) -> None:
        """Take a LANDING_TARGET message; the next step uses the newest."""
        self._pending = target

    def _report_frame(self, severity: Severity, text: str) -> None:
        if not self._frame_reported:
            self.texts.append((severity, text))
        self._frame_reported = True

    @abstractmethod
    def watch(self, estimate: VehicleEstimate, dt_s: float) -> None:
        """Update the target's estimate at each outer step, landing or not."""

    @abstractmethod
    def begin(self, *, required: bool) -> None:
        """Start a landing; `required`: without a target it searches instead of landing at once."""

    @abstractmethod
    def fly(self, estimate: VehicleEstimate, dt_s: float) -> MotionSetpoint | None:
        """The setpoint; None: land as without a target."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry: its name (at most 16 characters), default, bounds, whether it is an integer, its bits."""

    name: str
    default: float
    minimum: float
    maximum: float
    integer: bool = False
    bits: int = 32


@dataclass(frozen=True, slots=True)
class ParameterRef:
    """A parameter as the flight code reads it: value times `scale` is in SI units."""

    name: str
    scale: float = 1.0


class Parameters:
    """Current values of a fixed set of parameters, in the order they are listed."""

    def __init__(self, table: Iterable[Parameter]) -> None:
        self._table = {parameter.name: parameter for parameter in table}
        self._names = tuple(self._table)
        self._indices = {name: index for index, name in enumerate(self._names)}
        self._values: dict[str, float] = {}
        self.reset()

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def name_at(self, index: int) -> str | None:
        """Name of the index-th parameter, None past either end."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        return self._indices[name]

    def is_integer(self, name: str) -> bool:
        return self._table[name].integer

    def bits(self, name: str) -> int:
        return self._table[name].bits

    def reset(self) -> None:
        self._values = {parameter.name: float(parameter.default) for parameter in self._table.values()}

    def si(self, setting: ParameterRef) -> float:
        return self._values[setting.name] * setting.scale

    def set(self, name: str, value: float) -> bool:
        """Store a value, rounded for an integer; False (and nothing stored) when unknown or out of bounds."""
        parameter = self._table.get(name)
        if parameter is None or not parameter.minimum <= value <= parameter.maximum:
            return False
        self._values[name] = float(round(value)) if parameter.integer else value
        return True


AnySetpoint = MotionSetpoint | AttitudeSetpoint

# MAV_MODE_FLAG bits without "armed"
FLAG_CUSTOM, FLAG_AUTO, FLAG_GUIDED, FLAG_STABILIZE, FLAG_MANUAL = 1, 4, 8, 16, 64


@dataclass(frozen=True, slots=True)
class ParameterMap:
    """Which parameter holds which setting; None: the autopilot has none for it.

    `landing_speed` holds down to `final_landing_height` (one of 0 is the descent speed), then the final one.
    A fence without `fence_enabled` is on as long as there is one; bit 0 of `fence_types` is a ceiling over
    home, bit 1 a circle about it. `rc_loss_enabled` at 0 lets a lost radio be; `rc_loss_exceptions` are bits
    of modes that a lost radio does not end: 1 mission, 2 hold, 4 external.
    `hover_thrust` is what the height law begins with, and learns in hover.
    """

    setpoint_timeout: ParameterRef
    cruise_speed: ParameterRef
    top_speed: ParameterRef
    climb_speed: ParameterRef
    descent_speed: ParameterRef
    take_off_speed: ParameterRef
    landing_speed: ParameterRef
    final_landing_speed: ParameterRef
    final_landing_height: ParameterRef
    return_height: ParameterRef
    acceptance_radius: ParameterRef
    rc_timeout: ParameterRef
    stick_speed: ParameterRef
    stick_climb: ParameterRef
    stick_descent: ParameterRef
    stick_tilt: ParameterRef
    stick_yaw_rate: ParameterRef
    fence_action: ParameterRef
    fence_enabled: ParameterRef | None = None
    fence_types: ParameterRef | None = None
    fence_ceiling: ParameterRef | None = None
    fence_radius: ParameterRef | None = None
    rc_loss_exceptions: ParameterRef | None = None
    rc_loss_enabled: ParameterRef | None = None
    gcs_system_id: ParameterRef | None = None
    take_off_height: ParameterRef | None = None
    still_speed: ParameterRef | None = None
    guided_options: ParameterRef | None = None
    setpoints_lost_action: ParameterRef | None = None
    hover_thrust: ParameterRef | None = None


@dataclass(frozen=True, slots=True)
class Texts:
    """Texts on events; empty: none."""

    boot: tuple[str, ...]
    aligned: tuple[str, ...]
    armed: str
    disarmed: str
    lifted: str = ""
    landed: str = ""
    landing: str = ""
    no_such_mode: str = ""
    terminated: str = ""
    no_mission: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotProfile:
    """The behaviour of one autopilot.

    `pitch_channel_reversed`: the RC channel of the pitch stick falls when it is pushed. `precision_landing`
    creates the precision landing controller, if the parameters enable it at boot; it flies the tasks in
    `precision_landing_tasks`. `read_motion` (fields, position, attitude, heading) and `read_attitude` convert
    streamed messages to setpoints, `as_aged` (setpoint, its age, the time-out, heading) applies the time-out;
    `position_control` creates the control law for a hover thrust. On the ground the thrust falls below
    `landed_thrust_share` of hover. With `thrust_is_upward` the thrust of an attitude setpoint gets tilt
    compensation, as by ArduPilot's ATC_ANGLE_BOOST; so does that of its height law, behind a low-pass of
    `throttle_hz`. The position controller runs every `outer_period_s`. `imu_messages` have the IMU's samples,
    `imu_filter` is the low-pass before them, as DLPF_CFG. `home_s` after boot, home is set, and the checks
    pass for a mode that needs no position; `alignment_s` after boot the position is known too.
    `prearm_in_health_only`: the pre-arm bit is in SYS_STATUS's health, but not in present and enabled.
    """

    name: AutopilotKind
    autopilot_id: int
    custom_mode: Callable[[int, int], int]
    flight_version: int
    capabilities: int
    parameters_bytewise: bool = False
    alignment_s: float
    landed_time_s: float
    landed_thrust_share: float
    still_speed_m_s: float
    modes: tuple[Mode, ...]
    boot_mode: str
    after_disarm_mode: str = ""
    take_off_mode: str
    after_take_off_mode: str
    hold_mode: str
    land_mode: str
    return_mode: str
    read_motion: Callable[[StreamedMotion, Vector3, Quaternion, float], MotionSetpoint | SetpointRefusal]
    read_attitude: Callable[[StreamedAttitude], AnySetpoint | SetpointRefusal]
    as_aged: Callable[[AnySetpoint, float, float, float], AnySetpoint]
    external_needs_setpoints: bool = False
    takes_off_by_setpoint: bool = False
    take_off_needs_guided: bool = False
    thrust_is_climb_rate: bool = False
    thrust_is_upward: bool = False
    pitch_channel_reversed: bool = False
    turns_by_command: bool = False
    refused: CommandResult
    refused_selection: CommandResult
    refused_disarming_text: str = ""
    unsupported_request: CommandResult
    parameter_map: ParameterMap
    texts: Texts
    mode_checks: tuple[ModeCheck, ...]
    arming_checks: tuple[ArmingCheck, ...]
    failsafes: tuple[Failsafe, ...]
    parameters: tuple[Parameter, ...]
    mission: MissionRules
    precision_landing: Callable[[Parameters], PrecisionLanding | None]
    precision_landing_tasks: frozenset[Task]
    position_control: Callable[[float], PositionControl]
    attitude_gains: AttitudeGains
    throttle_hz: float | None = None
    outer_period_s: float
    imu_messages: tuple[str, ...]
    imu_filter: int
    home_s: float
    prearm_in_health_only: bool = False

    def mode(self, name: str) -> Mode:
        """The mode of that name.

        Raises:
            KeyError: it has none.
        """
        for mode in self.modes:
            if mode.name == name:
                return mode
        raise KeyError(name)

    def mode_by_number(self, custom_mode: int) -> Mode | None:
        """The mode with that custom_mode, None when it is not offered."""
        return next((mode for mode in self.modes if mode.custom_mode == custom_mode), None)


def landed_after_flight(now: VehicleStatus) -> bool:
    return now.landed and now.has_flown


def level(now: VehicleStatus) -> bool:
    """Tilted by less than 20 degrees."""
    return now.tilt_rad < math.radians(20.0)


def mission_missing(mode: Mode, now: VehicleStatus) -> bool:
    """A mission is to be flown, and there is none."""
    return mode.task is Task.MISSION and not now.mission_ready


def not_from_flight(mode: Mode, now: VehicleStatus) -> bool:
    """A manual mode, in flight, without RC input."""
    return not mode.in_flight and now.armed and not now.landed and not now.rc_available


def fence_left(title: str, values: tuple[int, ...], mode: str) -> Failsafe:
    """What follows outside a geofence, where the autopilot's parameter has one of the values."""
    return Failsafe(
        lambda now: now.fence_broken and not now.landed and now.fence_action in values,
        0.2,
        Severity.CRITICAL,
        title,
        mode=mode,
        over=lambda now: not now.fence_broken,
    )


def setpoints_stopped(now: VehicleStatus) -> bool:
    """In a mode that needs streamed setpoints, and none arrives."""
    return now.streaming and now.setpoint_age_s > now.setpoint_timeout_s
