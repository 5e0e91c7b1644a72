"""What the app has to know of a make of autopilot, as data: another make is another of these."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

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
    # it does not get ready to arm in its control mode unless setpoints come
    needs_setpoints_to_arm: bool

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
