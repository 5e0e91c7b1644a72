"""From thrust and torques to four motor commands for a "+" frame, within what the motors can do.

Motors in order front (1), right (2), rear (3), left (4). FRD torques: roll = l (T4 - T2),
pitch = l (T1 - T3), yaw = k (T1 - T2 + T3 - T4).
When not everything fits, roll and pitch come first, then the collective thrust, then yaw; but at full thrust
yaw keeps a margin, for which the collective gives way (PX4 1.16, ControlAllocationSequentialDesaturation:
MINIMUM_YAW_MARGIN; ArduPilot's MOT_YAW_HEADROOM likewise keeps 0.2). Without it a vehicle that needs all its
thrust against the wind turns without end.
"""

from __future__ import annotations

from typing import Final

from companion.base.geometry import Vector3
from sitl.autopilot.control.airframe import Airframe

Motors = tuple[float, float, float, float]

YAW_MARGIN: Final = 0.15  # of the motors' range
_ROUNDING: Final = 1e-9


class MotorMixer:
    """`mix` for one airframe, in motor commands 0..1."""

    def __init__(self, airframe: Airframe, idle: float) -> None:
        full = airframe.max_thrust_n
        self._per_roll_pitch_nm = 1.0 / (2.0 * airframe.arm_length_m * full)
        self._per_yaw_nm = 1.0 / (4.0 * airframe.torque_to_thrust_m * full)
        self._idle = idle
        self.saturated = False

    def mix(self, thrust: float, torque_nm: Vector3) -> Motors:
        """Motor commands for a collective thrust (0..1 of all four) and body torques (N m)."""
        roll = torque_nm[0] * self._per_roll_pitch_nm
        pitch = torque_nm[1] * self._per_roll_pitch_nm
        yaw = torque_nm[2] * self._per_yaw_nm
        low, high = self._idle, 1.0
        reach = max(abs(roll), abs(pitch))
        room = 0.5 * (high - low)
        self.saturated = reach > room
        if self.saturated:
            roll, pitch, reach = roll * room / reach, pitch * room / reach, room
        centre = min(max(thrust, low + reach), high - reach)
        # yaw lifts one pair and lowers the other: what both pairs still have room for
        beyond = high + YAW_MARGIN * (high - low)
        pitch_room = min(centre - abs(pitch) - low, beyond - centre - abs(pitch))
        roll_room = min(centre - abs(roll) - low, beyond - centre - abs(roll))
        limit = max(0.0, min(pitch_room, roll_room))
        yaw = min(max(yaw, -limit), limit)
        over = max(centre + abs(pitch) + yaw, centre + abs(roll) - yaw) - high
        if over > _ROUNDING:
            front, right, rear, left = _motors(centre - over, roll, pitch, yaw)
            return (max(low, front), max(low, right), max(low, rear), max(low, left))
        return _motors(centre, roll, pitch, yaw)


def _motors(centre: float, roll: float, pitch: float, yaw: float) -> Motors:
    return (centre + pitch + yaw, centre - roll - yaw, centre - pitch + yaw, centre + roll - yaw)
