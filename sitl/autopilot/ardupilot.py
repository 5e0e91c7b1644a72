"""ArduPilot's manners: mode numbers, texts, results and rules of ArduCopter 4.6.

Taken from a recording of ArduCopter with its own simulator.
The landed detector takes 2 s; the recording shows 2.5 s from contact.
"""

from __future__ import annotations

import math

from sitl.autopilot import ardupilot_setpoints
from sitl.autopilot.ardupilot_control import ArdupilotControl
from sitl.autopilot.attitude_control import AttitudeGains, ReferenceLimits
from sitl.autopilot.manners import (
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
)
from sitl.autopilot.modes import ArmingCheck, Failsafe, Mode, Response, Result, Severity, Task
from sitl.parameters import Parameter, Setting

_GUIDED = FLAG_CUSTOM | FLAG_GUIDED | FLAG_STABILIZE | FLAG_MANUAL
_STICKS = FLAG_CUSTOM | FLAG_STABILIZE | FLAG_MANUAL

ARDUPILOT = Manner(
    name="ardupilot",
    autopilot_id=3,
    custom_mode=lambda main, sub: main,
    flight_version=4 << 24 | 6 << 16,
    # PARAM_FLOAT, MISSION_INT, COMMAND_INT, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_*, MAVLINK2
    capabilities=2 | 4 | 8 | 64 | 128 | 256 | 8192,
    parameters_bytewise=False,
    alignment_s=5.0,
    landed_time_s=1.0,
    landed_thrust_share=0.15,
    still_speed_m_s=1.0,
    modes=(
        Mode("STABILIZE", 0, _STICKS, Task.HOLD, in_flight=False),
        Mode("GUIDED", 4, _GUIDED, Task.HOLD, takes_setpoints=True, takes_positions=True),
        Mode("LOITER", 5, _STICKS, Task.HOLD),
        Mode("RTL", 6, _GUIDED, Task.RETURN, armable=False),
        Mode("LAND", 9, _GUIDED, Task.LAND, armable=False),
        Mode("POSHOLD", 16, _STICKS, Task.HOLD),
        Mode("BRAKE", 17, _STICKS, Task.HOLD, armable=False),
    ),
    boot_mode="STABILIZE",
    after_disarm_mode="",
    take_off_mode="GUIDED",
    after_take_off_mode="GUIDED",
    hold_mode="LOITER",
    land_mode="LAND",
    return_mode="RTL",
    read_motion=ardupilot_setpoints.read_motion,
    read_attitude=ardupilot_setpoints.read_attitude,
    as_aged=ardupilot_setpoints.as_aged,
    external_needs_setpoints=False,
    takes_off_by_setpoint=False,
    take_off_needs_guided=True,
    thrust_is_climb_rate=True,
    refused_arming=Result.FAILED,
    refused_disarming=Result.FAILED,
    refused_disarming_text="",
    unsupported_request=Result.FAILED,
    settings=Settings(
        setpoint_timeout=Setting("GUID_TIMEOUT"),
        cruise_speed=Setting("WPNAV_SPEED", 0.01),
        top_speed=Setting("WPNAV_SPEED", 0.01),
        landing_speed=Setting("LAND_SPEED_HIGH", 0.01),
        return_height=Setting("RTL_ALT", 0.01),
        guided_options=Setting("GUID_OPTIONS"),
    ),
    texts=Texts(
        boot=("ArduPilot Ready", "AHRS: DCM active"),
        aligned=("EKF3 IMU0 origin set", "EKF3 IMU0 is using GPS"),
        armed="Arming motors",
        disarmed="Disarming motors",
        lifted="",
        landed="",
        landing="",
        mode_unavailable="Mode change to {mode} failed: throttle too high",
    ),
    arming_checks=(
        ArmingCheck(mode_armable, "Arm: Mode not armable"),
        ArmingCheck(aligned, "Arm: Need Position Estimate"),
        ArmingCheck(level, "Arm: Leaning"),
    ),
    failsafes=(
        Failsafe(
            "landed in LAND",
            lambda now: landed_after_flight(now) and now.task is Task.LAND,
            0.0,
            Response.DISARM,
            Severity.INFO,
            "Disarming motors",
        ),
        Failsafe(
            "on the ground", lambda now: now.landed, 10.0, Response.DISARM, Severity.INFO, "Disarming motors"
        ),
        Failsafe(
            "crashed",
            lambda now: not now.landed and now.tilt_rad > math.radians(45.0),
            2.0,
            Response.DISARM,
            Severity.CRITICAL,
            "Crash: Disarming: AngErr=45>30",
        ),
    ),
    parameters=(
        Parameter("SYSID_THISMAV", 1, 1, 255, integer=True),
        Parameter("FRAME_CLASS", 1, 0, 15, integer=True),
        Parameter("FRAME_TYPE", 0, 0, 20, integer=True),
        Parameter("GUID_TIMEOUT", 3.0, 0.1, 5.0),
        Parameter("GUID_OPTIONS", 0, 0, 255, integer=True),
        Parameter("WPNAV_SPEED", 1000.0, 20.0, 2000.0),
        Parameter("LAND_SPEED_HIGH", 70.0, 0.0, 500.0),
        Parameter("RTL_ALT", 1500.0, 30.0, 300000.0),
    ),
    position_control=ArdupilotControl,
    attitude_gains=AttitudeGains(
        tilt_p=4.5,  # ATC_ANG_RLL_P, ATC_ANG_PIT_P
        yaw_p=4.5,  # ATC_ANG_YAW_P
        damps_error=True,
        # ATC_INPUT_TC, ATC_ACCEL_R_MAX and _P_MAX 110000, ATC_ACCEL_Y_MAX 27000 cdeg/s², ATC_SLEW_YAW
        reference=ReferenceLimits(0.15, math.radians(1100.0), math.radians(270.0), math.radians(60.0)),
    ),
    imu_messages=("RAW_IMU", "SCALED_IMU"),
    imu_filter=4,  # 20 Hz: INS_GYRO_FILTER and INS_ACCEL_FILTER
)
