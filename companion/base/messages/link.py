"""What comes back over the link: what the autopilot says of itself, and where the pad reports to be."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import Quaternion, Vector3

UNKNOWN_TIMEOUT_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class AutopilotSetup:
    """What the autopilot's parameters say of how it obeys; None: unknown.

    `acceleration_m_s2` and `jerk_m_s3` bind velocity setpoints sideways. When setpoints stop, it keeps the
    last one for `setpoint_timeout_s`; then `setpoints_lost_action` follows (PX4's COM_OBL_RC_ACT), or
    (ArduPilot) it keeps level and its height, and goes with the wind until `drift_ends`, if anything does it.
    """

    tilt_deg: float | None = None
    hover_thrust: float | None = None
    acceleration_m_s2: float | None = None
    jerk_m_s3: float | None = None
    setpoint_timeout_s: float | None = None
    setpoints_lost_action: int | None = None
    drift_ends: bool | None = None

    @property
    def keeps_setpoint_s(self) -> float:
        """How long (s) it goes by the last setpoint; where it does not say, as short as any should."""
        return UNKNOWN_TIMEOUT_S if self.setpoint_timeout_s is None else self.setpoint_timeout_s


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
    `intended_mode`: the one that was asked for last, by a pilot or by us, while a failsafe may fly another;
    "" where it is not reported (ArduPilot, PX4 before 1.15).
    `motors_cut`: by the pilot's kill switch, the emergency stop, or the flight's termination.
    `round_trip_s`: how long a question and its answer take on the link, the quickest of the last three, at
    `round_trip_time_s`; None: not known. `twin_time_s`: when another companion with our ids was last
    received, whose setpoints and requests would be taken for ours. `rival`: system and component of who else
    has sent setpoints to the vehicle, last at `rival_time_s`. `refused_frames`: what came without a
    right signature, where the link demands one. `mavlink_1`: it speaks version 1 alone, which is not
    listened to; PX4 begins so, until it receives our version 2. `thrust`: what its rotors are asked for, as
    a share of full thrust (ArduPilot: the upward part), measured at `thrust_time_s`.
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
    position_ned_m: Vector3 | None = None
    velocity_ned_m_s: Vector3 | None = None
    global_position: Vector3 | None = None
    global_position_time_s: float = float("-inf")
    home: Vector3 | None = None
    texts: tuple[str, ...] = ()
    battery_share: float | None = None
    motors_cut: bool = False
    refused_frames: int = 0
    mavlink_1: bool = False
    round_trip_s: float | None = None
    round_trip_time_s: float = float("-inf")
    twin_time_s: float = float("-inf")
    rival: tuple[int, int] | None = None
    rival_time_s: float = float("-inf")
    thrust: float | None = None
    thrust_time_s: float = float("-inf")


@dataclass(frozen=True, slots=True)
class PadBeacon:
    """The pad's own GPS, sent by the ground station (MAVLink FOLLOW_TARGET): metres, not centimetres."""

    time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    velocity_ned_m_s: Vector3
    position_std_m: float
