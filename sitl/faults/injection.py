"""Fault injection: one function per fault of a sensor, a line or a motor.

`sitl.faults.schedule` clears all faults when one starts or ends and applies the active ones again, so that
faults may overlap. SI units, body axes (FRD). Pad, autopilot and computer:
`sitl.faults.non_sensor_injection`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from companion.base.geometry import GRAVITY_M_S2, ZERO3, add
from sitl.camera.frame_line import FrameLine
from sitl.devices.rack import SensorRack
from sitl.faults import faults
from sitl.faults.faulty_link import LinkChannel
from sitl.faults.non_sensor_faults import AutopilotReboots
from sitl.faults.non_sensor_injection import NON_SENSOR, NonSensorTargets
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.actuators import Motors


class FaultTargets:
    """The devices on which faults act."""

    def __init__(
        self,
        rack: SensorRack,
        autopilot_sensors: SimulatedAutopilotSensors,
        frames: FrameLine,
        motors: Motors,
        to_app: LinkChannel,
        to_vehicle: LinkChannel,
        non_sensor: NonSensorTargets | None = None,
    ) -> None:
        """`autopilot_sensors`: faults of the environment act on them too; `non_sensor`: what is no sensor."""
        self.non_sensor = non_sensor
        self.inertial, self.magnetometer, self.echo = rack.inertial, rack.magnetometer, rack.echo
        self.gps, self.bus, self.range, self.position = rack.gps, rack.imu, rack.range, rack.position
        self.mount = rack.mount
        self.autopilot_sensors = autopilot_sensors
        self.frames, self.motors = frames, motors
        self.to_app, self.to_vehicle = to_app, to_vehicle

    def clear_faults(self) -> None:
        """Clear all faults."""
        self.bus.wake()
        self.mount.clear_faults()
        self.inertial.rate_offset_rad_s = self.inertial.force_offset_m_s2 = ZERO3
        self.inertial.accel_limit_m_s2 = math.inf
        self.inertial.vibration_factor = self.autopilot_sensors.inertial.vibration_factor = 1.0
        self.inertial.gyro_glitches.clear_faults()
        self.inertial.accel_glitches.clear_faults()
        self.magnetometer.stray_field_ut = ZERO3
        self.magnetometer.glitches.clear_faults()
        self.bus.magnetometer.silent = False
        self.bus.nack_every, self.bus.fault = 0, "none"
        self.echo.clear_faults()
        self.range.silent = False
        self.gps.has_fix, self.gps.silent = True, False
        self.position.jump_ned_m, self.position.stuck = ZERO3, False
        self.position.glitches.clear_faults()
        self.autopilot_sensors.has_sky, self.autopilot_sensors.stray_field_ut = True, ZERO3
        self.frames.clear_faults()
        self.motors.clear_faults()
        self.to_app.clear_faults()
        self.to_vehicle.clear_faults()
        if self.non_sensor is not None:
            self.non_sensor.clear_faults()


# ---------------------------------------------------------------- IMU


def lose_imu(_fault: faults.ImuLost, targets: FaultTargets) -> None:
    """No acknowledge."""
    targets.bus.fault = "nack"


def disturb_bus(fault: faults.ImuBusError, targets: FaultTargets) -> None:
    """Transactions that fail."""
    targets.bus.nack_every = fault.every


def stick_imu(_fault: faults.ImuStuck, targets: FaultTargets) -> None:
    """Repeat the last readings."""
    targets.inertial.gyro_glitches.stuck = targets.inertial.accel_glitches.stuck = True


def saturate_imu(_fault: faults.ImuSaturated, targets: FaultTargets) -> None:
    """The ends of the ranges."""
    targets.bus.fault = "saturated"


def step_gyro_bias(fault: faults.GyroBiasStep, targets: FaultTargets) -> None:
    """An offset of the rate."""
    x, y, z = fault.rate_body_deg_s
    step = (math.radians(x), math.radians(y), math.radians(z))
    targets.inertial.rate_offset_rad_s = add(targets.inertial.rate_offset_rad_s, step)


def spike_gyro(fault: faults.GyroSpikes, targets: FaultTargets) -> None:
    """Wrong rates."""
    targets.inertial.gyro_glitches.spike(fault.share, math.radians(fault.size_deg_s))


def step_accel_bias(fault: faults.AccelBiasStep, targets: FaultTargets) -> None:
    """An offset of the force."""
    targets.inertial.force_offset_m_s2 = add(targets.inertial.force_offset_m_s2, fault.force_body_m_s2)


def spike_accel(fault: faults.AccelSpikes, targets: FaultTargets) -> None:
    """Wrong forces."""
    targets.inertial.accel_glitches.spike(fault.share, fault.size_m_s2)


def clip_accelerometer(fault: faults.AccelClips, targets: FaultTargets) -> None:
    """Less range, more vibration."""
    limit_m_s2 = fault.range_g * GRAVITY_M_S2
    targets.inertial.accel_limit_m_s2 = min(targets.inertial.accel_limit_m_s2, limit_m_s2)
    targets.inertial.vibration_factor *= fault.vibration_factor


def turn_board(fault: faults.ImuTurned, targets: FaultTargets) -> None:
    """Another mounting."""
    x, y, z = fault.rotation_body_deg
    targets.mount.target_rad = (math.radians(x), math.radians(y), math.radians(z))
    targets.mount.slips_for_s = fault.slips_for_s


def shake(fault: faults.Vibration, targets: FaultTargets) -> None:
    """More vibration, of all that is on board."""
    targets.inertial.vibration_factor *= fault.factor
    targets.autopilot_sensors.inertial.vibration_factor *= fault.factor


# ---------------------------------------------------------------- magnetometer


def lose_magnetometer(_fault: faults.MagLost, targets: FaultTargets) -> None:
    """It acknowledges nothing."""
    targets.bus.magnetometer.silent = True


def stick_magnetometer(_fault: faults.MagStuck, targets: FaultTargets) -> None:
    """Repeat the last field."""
    targets.magnetometer.glitches.stuck = True


def disturb_magnetometer(fault: faults.MagDisturbed, targets: FaultTargets) -> None:
    """An additional field."""
    for sensor in (targets.magnetometer, targets.autopilot_sensors):
        sensor.stray_field_ut = add(sensor.stray_field_ut, fault.field_body_ut)


def spike_magnetometer(fault: faults.MagSpikes, targets: FaultTargets) -> None:
    """Wrong fields."""
    targets.magnetometer.glitches.spike(fault.share, fault.size_ut)


# ---------------------------------------------------------------- GPS


def lose_gps(fault: faults.GpsLost, targets: FaultTargets) -> None:
    """No fix, or no data."""
    if fault.unplugged:
        targets.gps.silent = True
    else:
        targets.gps.has_fix = False
        targets.autopilot_sensors.has_sky = False


def stick_gps(_fault: faults.GpsStuck, targets: FaultTargets) -> None:
    """Repeat the last solution."""
    targets.position.stuck = True


def jump_gps(fault: faults.GpsJump, targets: FaultTargets) -> None:
    """An offset of every fix."""
    targets.position.jump_ned_m = add(targets.position.jump_ned_m, fault.position_ned_m)


def spike_gps(fault: faults.GpsSpikes, targets: FaultTargets) -> None:
    """An error of some fixes."""
    targets.position.glitches.spike(fault.share, fault.size_m)


# ---------------------------------------------------------------- ultrasonic


def lose_range(fault: faults.RangeLost, targets: FaultTargets) -> None:
    """Fewer echoes, or no data."""
    if fault.unplugged:
        targets.range.silent = True
    else:
        targets.echo.extra_lost = max(targets.echo.extra_lost, fault.share)


def stick_range(fault: faults.RangeStuck, targets: FaultTargets) -> None:
    """A constant distance."""
    targets.echo.stuck, targets.echo.stuck_m = True, fault.distance_m


def step_range_bias(fault: faults.RangeBiasStep, targets: FaultTargets) -> None:
    """An offset of the distance."""
    targets.echo.bias_m += fault.distance_m


def spike_range(fault: faults.RangeSpikes, targets: FaultTargets) -> None:
    """More wrong echoes."""
    targets.echo.extra_spikes = max(targets.echo.extra_spikes, fault.share)


def answer_from_nearer(fault: faults.RangeOtherEcho, targets: FaultTargets) -> None:
    """Echoes of something else."""
    targets.echo.other_m, targets.echo.other_share = fault.distance_m, fault.share


# ---------------------------------------------------------------- camera


def hold_frames_up(fault: faults.FrameLate, targets: FaultTargets) -> None:
    """A delay of some frames."""
    targets.frames.late_s, targets.frames.late_every = fault.extra_s, fault.every


def lose_frames(fault: faults.FrameLost, targets: FaultTargets) -> None:
    """Loss of some frames."""
    if fault.share >= targets.frames.lost_share:
        targets.frames.lost_share, targets.frames.burst_frames = fault.share, fault.burst_frames


def stick_frames(_fault: faults.FrameStuck, targets: FaultTargets) -> None:
    """Repeat the last picture."""
    targets.frames.stuck = True


def garble_frames(fault: faults.FrameGarbled, targets: FaultTargets) -> None:
    """Random data in some frames."""
    targets.frames.garbled_share = max(targets.frames.garbled_share, fault.share)


def cap_lens(_fault: faults.FrameBlack, targets: FaultTargets) -> None:
    """Black frames."""
    targets.frames.black = True


def fill_frames_with_garbage(_fault: faults.FrameGarbage, targets: FaultTargets) -> None:
    """Random data in all frames."""
    targets.frames.garbage = True


# ---------------------------------------------------------------- link and motors


def ways(direction: faults.LinkDirection, targets: FaultTargets) -> tuple[LinkChannel, ...]:
    """The directions of the line that a fault is in."""
    both = {"to_app": targets.to_app, "to_vehicle": targets.to_vehicle}
    return tuple(both.values()) if direction == "both" else (both[direction],)


def black_out_link(fault: faults.LinkBlackout, targets: FaultTargets) -> None:
    """No datagram arrives."""
    for way in ways(fault.way, targets):
        way.cut = True


def lose_datagrams(fault: faults.LinkLoss, targets: FaultTargets) -> None:
    """Some do not arrive."""
    for way in ways(fault.way, targets):
        way.extra_loss = max(way.extra_loss, fault.share)


def delay_datagrams(fault: faults.LinkDelay, targets: FaultTargets) -> None:
    """All arrive later."""
    for way in ways(fault.way, targets):
        way.extra_delay_s += fault.extra_s


def silence_link(_fault: AutopilotReboots, targets: FaultTargets) -> None:
    """Nothing is sent or taken."""
    targets.to_app.cut = targets.to_vehicle.cut = True


def weaken_motor(fault: faults.MotorWeak, targets: FaultTargets) -> None:
    """Less thrust."""
    targets.motors.weaken(None if fault.motor == "all" else fault.motor, fault.thrust_factor)


INJECT: Final[dict[str, Callable[[Any, FaultTargets], None]]] = {
    "imu_lost": lose_imu,
    "imu_bus_error": disturb_bus,
    "imu_stuck": stick_imu,
    "imu_saturated": saturate_imu,
    "gyro_bias_step": step_gyro_bias,
    "gyro_spikes": spike_gyro,
    "accel_bias_step": step_accel_bias,
    "accel_spikes": spike_accel,
    "accel_clips": clip_accelerometer,
    "imu_turned": turn_board,
    "vibration": shake,
    "mag_lost": lose_magnetometer,
    "mag_stuck": stick_magnetometer,
    "mag_disturbed": disturb_magnetometer,
    "mag_spikes": spike_magnetometer,
    "gps_lost": lose_gps,
    "gps_stuck": stick_gps,
    "gps_jump": jump_gps,
    "gps_spikes": spike_gps,
    "range_lost": lose_range,
    "range_stuck": stick_range,
    "range_bias_step": step_range_bias,
    "range_spikes": spike_range,
    "range_other_echo": answer_from_nearer,
    "frame_late": hold_frames_up,
    "frame_lost": lose_frames,
    "frame_stuck": stick_frames,
    "frame_garbled": garble_frames,
    "frame_black": cap_lens,
    "frame_garbage": fill_frames_with_garbage,
    "link_loss": lose_datagrams,
    "link_delay": delay_datagrams,
    "link_blackout": black_out_link,
    "motor_weak": weaken_motor,
    "autopilot_reboots": silence_link,
    **NON_SENSOR,
}
