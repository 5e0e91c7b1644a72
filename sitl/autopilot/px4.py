"""PX4's manners: mode numbers, texts, results and rules of PX4 1.16.

Taken from a recording of PX4 with its own simulator. The landed detector waits until the thrust is under
MPC_THR_MIN + LNDMC_LOW_T_THR (hover - MPC_THR_MIN), which takes the climb's integral 6 s at a descent of
0.3 m/s, and then LNDMC_TRIG_TIME.
"""

from __future__ import annotations

from sitl.autopilot import px4_setpoints
from sitl.autopilot.attitude_control import AttitudeGains
from sitl.autopilot.manners import (
    FLAG_AUTO,
    FLAG_CUSTOM,
    FLAG_GUIDED,
    FLAG_MANUAL,
    FLAG_STABILIZE,
    Manner,
    Settings,
    Texts,
    aligned,
    landed_after_flight,
    level,
    mode_armable,
    never_flown,
    setpoints_stopped,
)
from sitl.autopilot.modes import ArmingCheck, Failsafe, Mode, Response, Result, Severity, Task
from sitl.autopilot.px4_control import Px4Control
from sitl.parameters import Parameter, Setting

_AUTO = FLAG_CUSTOM | FLAG_AUTO | FLAG_GUIDED | FLAG_STABILIZE
_STICKS = FLAG_CUSTOM | FLAG_STABILIZE | FLAG_MANUAL


def _number(main: int, sub: int = 0) -> int:
    """custom_mode of a main and a sub mode."""
    return main << 16 | sub << 24


PX4 = Manner(
    name="px4",
    autopilot_id=12,
    custom_mode=_number,
    flight_version=1 << 24 | 16 << 16 | 1 << 8 | 255,
    # MISSION_INT, COMMAND_INT, PARAM_ENCODE_BYTEWISE, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_*, MAVLINK2
    capabilities=4 | 8 | 16 | 64 | 128 | 256 | 8192,
    parameters_bytewise=True,
    alignment_s=3.0,
    landed_time_s=1.0,
    landed_thrust_share=0.47,
    still_speed_m_s=0.25,
    modes=(
        Mode("MANUAL", _number(1), FLAG_CUSTOM | FLAG_MANUAL, Task.HOLD, in_flight=False),
        Mode("POSCTL", _number(3), _STICKS, Task.HOLD),
        Mode("AUTO_TAKEOFF", _number(4, 2), _AUTO, Task.TAKE_OFF, takes_positions=True),
        Mode("AUTO_LOITER", _number(4, 3), _AUTO, Task.HOLD, takes_positions=True),
        Mode("AUTO_RTL", _number(4, 5), _AUTO, Task.RETURN, armable=False),
        Mode("AUTO_LAND", _number(4, 6), _AUTO, Task.LAND, armable=False),
        Mode("OFFBOARD", _number(6), FLAG_CUSTOM | FLAG_STABILIZE, Task.SETPOINT, takes_setpoints=True),
    ),
    boot_mode="AUTO_LOITER",
    after_disarm_mode="AUTO_LOITER",
    take_off_mode="AUTO_TAKEOFF",
    after_take_off_mode="AUTO_LOITER",
    hold_mode="AUTO_LOITER",
    land_mode="AUTO_LAND",
    return_mode="AUTO_RTL",
    read_motion=px4_setpoints.read_motion,
    read_attitude=px4_setpoints.read_attitude,
    as_aged=px4_setpoints.as_aged,
    external_needs_setpoints=True,
    takes_off_by_setpoint=True,
    take_off_needs_guided=False,
    thrust_is_climb_rate=False,
    refused_arming=Result.TEMPORARILY_REJECTED,
    refused_disarming=Result.TEMPORARILY_REJECTED,
    refused_disarming_text="Disarming denied: not landed",
    unsupported_request=Result.UNSUPPORTED,
    settings=Settings(
        setpoint_timeout=Setting("COM_OF_LOSS_T"),
        cruise_speed=Setting("MPC_XY_CRUISE"),
        top_speed=Setting("MPC_XY_VEL_MAX"),
        landing_speed=Setting("MPC_LAND_SPEED"),
        return_height=Setting("RTL_RETURN_ALT"),
        still_speed=Setting("LNDMC_Z_VEL_MAX"),
        take_off_height=Setting("MIS_TAKEOFF_ALT"),
    ),
    texts=Texts(
        boot=(),
        aligned=("Ready for takeoff!",),
        armed="Armed by external command",
        disarmed="Disarmed by external command",
        lifted="Takeoff detected",
        landed="Landing detected",
        landing="Landing at current position",
        mode_unavailable="Switching to mode '{mode}' is currently not available",
    ),
    arming_checks=(
        ArmingCheck(aligned, "Arming denied: Resolve system health failures first"),
        ArmingCheck(level, "Arming denied: Attitude failure (roll or pitch)"),
        ArmingCheck(lambda now: not setpoints_stopped(now), "Arming denied: No offboard control signal"),
        ArmingCheck(mode_armable, "Arming denied: Mode not suitable for takeoff"),
    ),
    failsafes=(
        Failsafe(
            "offboard lost",
            setpoints_stopped,
            0.0,
            Response.LEAVE_MODE,
            Severity.CRITICAL,
            "Failsafe activated: No offboard control signal, switching to Position",
            mode="POSCTL",
            task=Task.DESCEND,
        ),
        Failsafe("landed", landed_after_flight, 2.0, Response.DISARM, Severity.INFO, "Disarmed by landing"),
        Failsafe(
            "not taken off",
            never_flown,
            10.0,
            Response.DISARM,
            Severity.INFO,
            "Disarmed by auto preflight disarming",
        ),
    ),
    parameters=(
        Parameter("SYS_AUTOSTART", 4001, 0, 9999999, integer=True),
        Parameter("MAV_SYS_ID", 1, 1, 250, integer=True),
        Parameter("MIS_TAKEOFF_ALT", 2.5, 0.0, 80.0),
        Parameter("COM_OF_LOSS_T", 1.0, 0.0, 60.0),
        Parameter("MPC_XY_VEL_MAX", 12.0, 0.0, 20.0),
        Parameter("MPC_XY_CRUISE", 5.0, 3.0, 20.0),
        Parameter("MPC_LAND_SPEED", 0.7, 0.6, 2.0),
        Parameter("RTL_RETURN_ALT", 10.0, 0.0, 150.0),
        Parameter("LNDMC_Z_VEL_MAX", 0.25, 0.0, 1.0),
    ),
    position_control=Px4Control,
    attitude_gains=AttitudeGains(),  # MC_ROLL_P, MC_PITCH_P, MC_YAW_P, MC_YAWRATE_MAX
    imu_messages=("HIGHRES_IMU",),
    imu_filter=2,  # the chip's own, 92 Hz: HIGHRES_IMU comes before IMU_GYRO_CUTOFF
)
