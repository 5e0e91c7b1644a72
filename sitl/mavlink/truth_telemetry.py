"""The truth by MAVLink, as real simulators send it: for an external world around this vehicle.

ArduPilot's SITL sends SIM_STATE, PX4's HIL_STATE_QUATERNION. The truth is sent only by a simulator that
was started to serve it, and only on request; the app never requests it. Integers as the real ones send them.
"""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from companion.base.geometry import GRAVITY_M_S2, Vector3, euler_from_quat, geodetic_from_ned
from sitl.autopilot import SimulatedAutopilot
from sitl.mavlink.telemetry import milliseconds
from sitl.world.world import World

Message = Any  # pymavlink's classes are generated without types

SIM_STATE: Final = mavlink.MAVLINK_MSG_ID_SIM_STATE
HIL_STATE: Final = mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
_I16: Final = 32767


class TruthMessages:
    """Builds the one message that a simulator of this autopilot's kind has."""

    def __init__(self, autopilot: SimulatedAutopilot, world: World, home: Vector3) -> None:
        """`home` is the world's origin: latitude (deg), longitude (deg), altitude (m)."""
        self._autopilot, self._world, self._home = autopilot, world, home
        is_px4 = autopilot.profile.autopilot_id == mavlink.MAV_AUTOPILOT_PX4
        self._message_id = HIL_STATE if is_px4 else SIM_STATE

    def __contains__(self, message_id: int) -> bool:
        """Whether there is such a message."""
        return bool(message_id == self._message_id)

    def build(self, message_id: int, now_s: float) -> Message:
        """The message of this moment."""
        return self._hil_state(now_s) if message_id == HIL_STATE else self._sim_state()

    def _sim_state(self) -> Message:
        state = self._world.state
        latitude, longitude, altitude = geodetic_from_ned(state.position_ned_m, self._home)
        # the float fields hold 1e-7 deg as well, as ArduPilot fills them in (SITL.cpp, sim_state_send)
        return mavlink.MAVLink_sim_state_message(
            *state.attitude, *euler_from_quat(state.attitude), *state.specific_force_body_m_s2,
            *state.rate_body_rad_s, latitude * 1e7, longitude * 1e7, altitude, 0.0, 0.0,
            *state.velocity_ned_m_s, int(latitude * 1e7), int(longitude * 1e7),
        )  # fmt: skip

    def _hil_state(self, now_s: float) -> Message:
        state = self._world.state
        latitude, longitude, altitude = geodetic_from_ned(state.position_ned_m, self._home)
        vx, vy, vz = (_bounded(100.0 * speed) for speed in state.velocity_ned_m_s)
        ax, ay, az = (_bounded(1e3 * force / GRAVITY_M_S2) for force in state.specific_force_body_m_s2)
        return mavlink.MAVLink_hil_state_quaternion_message(
            1000 * milliseconds(self._autopilot, now_s), list(state.attitude), *state.rate_body_rad_s,
            int(latitude * 1e7), int(longitude * 1e7), int(altitude * 1e3), vx, vy, vz, 0, 0, ax, ay, az,
        )  # fmt: skip


def _bounded(value: float) -> int:
    """Cut off as the C cast does, within 16 bits."""
    return max(-_I16, min(_I16, int(value)))
