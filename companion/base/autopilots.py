"""The autopilots that the app flies with, as data: one profile for each make, and its flight modes."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

from companion.base.autopilot_kind import AutopilotKind


class OtherName(NamedTuple):
    """Another version's parameter, and the factor by which its value is in the first name's unit."""

    name: str
    scale: float


def version_text(version: tuple[int, int, int]) -> str:
    """As people write it: 1.17.0."""
    return ".".join(map(str, version))


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotMake:
    """One make. Modes by their names on the ground station, messages by MAVLink's names."""

    kind: AutopilotKind
    title: str
    # MAV_AUTOPILOT, as its heartbeat says it
    mavlink_autopilot: int
    # major and minor, of the versions whose real firmware has been flown with this program
    flown_versions: tuple[tuple[int, int], ...]

    # ------------------------------------------------------------ modes
    # HEARTBEAT.custom_mode of each
    modes: Mapping[str, int]
    # what of a custom mode that is not in the table still names one that is: its main mode
    main_mode_bits: int = 0
    # obeys our setpoints
    control_mode: str
    # stops and stays, by itself
    hold_mode: str
    land_mode: str
    # flown by hand: once one of these is received, another pilot has the vehicle
    stick_modes: frozenset[str]
    # Where it stands before the take-off, and where it flies at and after it, as long as nobody chooses
    # anything. A make that takes off in its control mode stays there.
    waits_in: frozenset[str]
    climbs_in: frozenset[str]
    after_take_off: str

    # ------------------------------------------------------------ control
    # the kind of setpoint that answers quickest
    setpoint: Literal["acceleration", "attitude"]
    # It adds thrust by its tilt, and reports the upward part of what it makes.
    raises_thrust_by_tilt: bool
    # an attitude setpoint's thrust is a climb rate, unless a parameter says otherwise
    thrust_may_be_climb_rate: bool
    # It changes into its control mode, and gets ready to arm there, only while setpoints come. One that may
    # be found in that mode gets none before control is granted: it would obey them.
    needs_setpoints: bool

    # ------------------------------------------------------------ commands and telemetry
    # a command's parameter that has no value
    unused_parameter: float
    # MAV_CMD_NAV_TAKEOFF's altitude counts from home, not from the sea
    takes_off_from_home: bool
    # message rates (Hz) that this make alone is asked for
    rates_hz: Mapping[str, float]
    # SYS_STATUS: the check before arming stands in `health` alone, `present` never has it
    prearm_in_health_alone: bool
    # SYS_STATUS says that its outputs are cut, EKF_STATUS_REPORT whether its filter is ready
    reports_outputs: bool

    # ------------------------------------------------------------ its own precision landing
    # LANDING_TARGET's position is taken in this frame alone: body axes (FRD), or its own local NED
    target_frame: Literal["body", "local_ned"]
    # it carries a target on at the velocity that it has found; else it flies to where the target was told
    carries_target_on: bool

    # ------------------------------------------------------------ its sensors
    # messages with the IMU, best first
    imu_messages: tuple[str, ...]
    # of a sample at its stamp
    imu_latency_s: float
    stream_advice: str

    # ------------------------------------------------------------ parameters
    # an integer parameter's bytes come in the float's place
    integers_as_bytes: bool
    # on which our loop depends: read, never written
    read_parameters: tuple[str, ...]
    # without these nobody knows what follows once setpoints stop; the first is for how long it keeps the last
    loss_parameters: tuple[str, ...]
    # then it levels, and obeys the next setpoint, whatever its parameters say
    levels_without_setpoints: bool
    other_names: Mapping[str, tuple[OtherName, ...]] = field(default_factory=dict)

    def unflown(self, version: tuple[int, int, int] | None) -> str:
        """Why this version (major, minor, patch) is new to us, in words; "" where it is not, or not known."""
        if version is None or version[:2] in self.flown_versions:
            return ""
        flown = ", ".join(f"{major}.{minor}" for major, minor in self.flown_versions)
        return f"{self.title} {version_text(version)} has not been flown; flown: {flown}"

    @property
    def takes_off_under_control(self) -> bool:
        """Whether it takes off in its control mode alone."""
        return self.control_mode in self.climbs_in


# ---------------------------------------------------------------- PX4, versions 1.14 to 1.17


def _custom_mode(main: int, sub: int = 0) -> int:
    """The main mode in bits 16 to 23, the sub mode in bits 24 to 31 (px4_custom_mode.h)."""
    return (main << 16) | (sub << 24)


PX4: Final = AutopilotMake(
    kind="px4",
    title="PX4",
    mavlink_autopilot=12,
    flown_versions=((1, 16), (1, 17)),
    modes={
        "MANUAL": _custom_mode(1),
        "ALTCTL": _custom_mode(2),
        "POSCTL": _custom_mode(3),
        "AUTO.READY": _custom_mode(4, 1),
        "AUTO.TAKEOFF": _custom_mode(4, 2),
        "AUTO.LOITER": _custom_mode(4, 3),
        "AUTO.MISSION": _custom_mode(4, 4),
        "AUTO.RTL": _custom_mode(4, 5),
        "AUTO.LAND": _custom_mode(4, 6),
        "AUTO.FOLLOW_TARGET": _custom_mode(4, 8),
        "AUTO.PRECLAND": _custom_mode(4, 9),
        "ACRO": _custom_mode(5),
        "OFFBOARD": _custom_mode(6),
        "STABILIZED": _custom_mode(7),
    },
    # outside AUTO only POSCTL and the VTOL modes use sub modes
    main_mode_bits=0xFF0000,
    control_mode="OFFBOARD",
    hold_mode="AUTO.LOITER",
    land_mode="AUTO.LAND",
    stick_modes=frozenset({"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED"}),
    waits_in=frozenset({"LOITER", "TAKEOFF", "READY", "HOLD"}),
    # it flies to a position in LOITER as well
    climbs_in=frozenset({"LOITER", "TAKEOFF"}),
    after_take_off="AUTO.LOITER",
    # It skips its horizontal velocity loop for a setpoint without such a velocity; that loop's integral and
    # derivative, and its own estimate of the velocity, would else act on every turn and gust besides ours.
    setpoint="acceleration",
    raises_thrust_by_tilt=False,
    thrust_may_be_climb_rate=False,
    needs_setpoints=True,  # mode_req_offboard_signal of its failsafe_flags
    unused_parameter=math.nan,
    takes_off_from_home=False,
    # the mode is a pilot's word, and it refuses another rate of HEARTBEAT (1 Hz)
    rates_hz={"CURRENT_MODE": 10.0},
    prearm_in_health_alone=True,
    reports_outputs=False,
    target_frame="local_ned",  # mavlink_receiver.cpp; other positions are refused with a text
    carries_target_on=False,
    # its RAW_IMU is in counts, and its SCALED_IMU has the field in the compass's own axes
    imu_messages=("HIGHRES_IMU",),
    imu_latency_s=0.004,  # half the integration interval and the chip's filter
    stream_advice="PX4: MAV_x_MODE Onboard, MAV_x_RATE for the bandwidth",
    integers_as_bytes=True,
    read_parameters=("MPC_TILTMAX_AIR", "MPC_THR_HOVER", "COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    loss_parameters=("COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    levels_without_setpoints=False,
)

# ---------------------------------------------------------------- ArduPilot's ArduCopter, versions 4.3 to 4.7

ARDUPILOT: Final = AutopilotMake(
    kind="ardupilot",
    title="ArduPilot",
    mavlink_autopilot=3,
    flown_versions=((4, 6),),
    modes={  # COPTER_MODE of MAVLink's ardupilotmega dialect
        "STABILIZE": 0,
        "ACRO": 1,
        "ALT_HOLD": 2,
        "AUTO": 3,
        "GUIDED": 4,
        "LOITER": 5,
        "RTL": 6,
        "CIRCLE": 7,
        "LAND": 9,
        "POSHOLD": 16,
        "BRAKE": 17,
        "GUIDED_NOGPS": 20,
        "SMART_RTL": 21,
    },
    control_mode="GUIDED",
    # LOITER reads the pilot's sticks, and without a radio it sinks: BRAKE stops and holds
    hold_mode="BRAKE",
    land_mode="LAND",
    stick_modes=frozenset({"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "POSHOLD"}),
    # it takes off in its control mode alone
    waits_in=frozenset({"GUIDED"}),
    climbs_in=frozenset({"GUIDED"}),
    after_take_off="GUIDED",
    # it shapes velocities and accelerations so slowly that no loop around them is quick
    setpoint="attitude",
    raises_thrust_by_tilt=True,
    thrust_may_be_climb_rate=True,  # GUID_OPTIONS
    needs_setpoints=False,
    unused_parameter=0.0,  # it takes NaN for a number
    takes_off_from_home=True,
    # the mode is a pilot's word, and it has no CURRENT_MODE
    rates_hz={"EKF_STATUS_REPORT": 2.0, "HEARTBEAT": 5.0},
    prearm_in_health_alone=False,  # an old one has no such bit at all
    reports_outputs=True,
    target_frame="body",  # AC_PrecLand_Companion.cpp; other positions are dropped
    carries_target_on=True,  # with bit 0 of PLND_OPTIONS
    # HIGHRES_IMU is not in every firmware, and replaces RAW_IMU where another client asked for it
    imu_messages=("RAW_IMU", "SCALED_IMU", "HIGHRES_IMU"),
    # the two-pole filters at 20 Hz (INS_GYRO_FILTER, INS_ACCEL_FILTER) delay by sqrt(2) / (2 pi 20 Hz)
    imu_latency_s=0.011,
    stream_advice="ArduPilot: SRx_RAW_SENS, SRx_EXTRA3, and the port's baud rate",
    integers_as_bytes=False,
    read_parameters=(
        "ANGLE_MAX",
        "WPNAV_ACCEL",
        "PSC_JERK_XY",
        "MOT_THST_HOVER",
        "GUID_TIMEOUT",
        "GUID_OPTIONS",
        "FENCE_ENABLE",
        "FENCE_TYPE",
        "FENCE_ACTION",
        "FS_GCS_ENABLE",
        "SYSID_MYGCS",
    ),
    loss_parameters=("GUID_TIMEOUT",),
    levels_without_setpoints=True,
    # ArduCopter 4.7 renamed and rescaled (ardupilot.org, parameter name changes from 4.6 to 4.7)
    other_names={
        "ANGLE_MAX": (OtherName("ATC_ANGLE_MAX", 100.0),),  # centidegrees; degrees
        "LAND_SPEED": (OtherName("LAND_SPD_MS", 100.0),),  # cm/s; m/s
        "WPNAV_ACCEL": (OtherName("WP_ACC", 100.0),),  # cm/s²; m/s²
        "PSC_JERK_XY": (OtherName("PSC_NE_JERK", 1.0),),  # m/s³
        "SYSID_MYGCS": (OtherName("MAV_GCS_SYSID", 1.0),),
    },
)

PROFILES: Final[Mapping[AutopilotKind, AutopilotMake]] = {
    profile.kind: profile for profile in (PX4, ARDUPILOT)
}

# ---------------------------------------------------------------- modes: MAVLink's numbers and their names

_NAMES: Final = {
    kind: {number: name for name, number in profile.modes.items()} for kind, profile in PROFILES.items()
}


def custom_mode(autopilot_kind: AutopilotKind, mode: str) -> int:
    """HEARTBEAT.custom_mode of a named mode.

    Raises:
        KeyError: the autopilot has no such mode.
    """
    return PROFILES[autopilot_kind].modes[mode]


def mode_name(autopilot_kind: AutopilotKind, mode: int) -> str:
    """Name of HEARTBEAT.custom_mode; "mode N" when it is none of the profile's."""
    names, main_mode_bits = _NAMES[autopilot_kind], PROFILES[autopilot_kind].main_mode_bits
    main_mode = mode & main_mode_bits if main_mode_bits else mode
    return names.get(mode) or names.get(main_mode, f"mode {mode}")


def mode_parameters(autopilot_kind: AutopilotKind, mode: str) -> tuple[float, float, float]:
    """The first three parameters of MAV_CMD_DO_SET_MODE: custom mode enabled, (main) mode, sub mode."""
    number = custom_mode(autopilot_kind, mode)
    if not PROFILES[autopilot_kind].main_mode_bits:
        return (1.0, float(number), 0.0)
    return (1.0, float(number >> 16 & 0xFF), float(number >> 24))
