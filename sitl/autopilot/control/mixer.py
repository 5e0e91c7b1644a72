"""From thrust and torques to motor commands for a layout of rotors, within what the motors can do.

When not everything fits, roll and pitch come first, then the collective thrust, then yaw; but at full thrust
yaw keeps a margin, for which the collective gives way (PX4 1.16, ControlAllocationSequentialDesaturation:
MINIMUM_YAW_MARGIN; ArduPilot's MOT_YAW_HEADROOM likewise keeps 0.2). Without it a vehicle that needs all its
thrust against the wind turns without end. FRD torques.
"""

from typing import Final

from companion.base.geometry import Vector3
from sitl.vehicle.quadrotor import QuadrotorParameters
from sitl.vehicle.rotors import RotorValues

YAW_MARGIN: Final = 0.15  # of the motors' range
_ROUNDING: Final = 1e-9


class MotorMixer:
    """`mix` for one airframe, in motor commands 0..1."""

    def __init__(self, airframe: QuadrotorParameters, idle: float) -> None:
        full, self._layout = airframe.max_thrust_n, airframe.layout
        self._per_roll_pitch_nm = 1.0 / (self._layout.tilting * airframe.arm_length_m * full)
        self._per_yaw_nm = 1.0 / (self._layout.count * airframe.torque_to_thrust_m * full)
        self._idle = idle
        self.saturated = False

    def mix(self, thrust: float, torque_nm: Vector3) -> RotorValues:
        """Motor commands for a collective thrust (0..1 of all of them) and body torques (N m)."""
        roll = torque_nm[0] * self._per_roll_pitch_nm
        pitch = torque_nm[1] * self._per_roll_pitch_nm
        yaw = torque_nm[2] * self._per_yaw_nm
        low, high, layout = self._idle, 1.0, self._layout
        tilts = [pitch * f - roll * r for f, r in zip(layout.forward, layout.right, strict=True)]
        reach = max(map(abs, tilts))
        room = 0.5 * (high - low)
        self.saturated = reach > room
        if self.saturated:
            tilts = [tilt * room / reach for tilt in tilts]
            reach = room
        centre = min(max(thrust, low + reach), high - reach)
        # yaw lifts every other motor and lowers the rest: what all still have room for
        beyond = high + YAW_MARGIN * (high - low)
        limit = max(0.0, min(min(centre - abs(tilt) - low, beyond - centre - abs(tilt)) for tilt in tilts))
        yaw = min(max(yaw, -limit), limit)
        turned = list(zip(tilts, layout.turns, strict=True))
        over = max(centre + abs(tilt) + turn * yaw for tilt, turn in turned) - high
        if over > _ROUNDING:
            return tuple(max(low, centre - over + tilt + turn * yaw) for tilt, turn in turned)
        return tuple(centre + tilt + turn * yaw for tilt, turn in turned)
