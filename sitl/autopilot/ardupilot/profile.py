"""ArduPilot's profile: mode numbers, texts, results and rules of ArduCopter 4.6.

Taken from a recording of ArduCopter with its own simulator.
The landed detector takes 2 s; the recording shows 2.5 s from contact.

ArduPilot's parameters: the ones that `ardupilot.ARDUPILOT` names act in flight, the others are for
display.

Names, defaults and bounds after ArduCopter 4.6's parameter list. Defaults that differ from ArduCopter's
describe this vehicle or its recording. Units are ArduPilot's (cm, cm/s, centidegrees, s).
"""

import math
from typing import Final

from sitl.autopilot.ardupilot.control import ArdupilotControl, as_aged, read_attitude, read_motion
from sitl.autopilot.ardupilot.precision_landing import precision_landing
from sitl.autopilot.control.attitude_control import AttitudeGains, RateFilters, ReferenceLimits, ShareGains
from sitl.autopilot.flight.mission_items import MissionCommand, MissionRules
from sitl.autopilot.flight.modes import (
    ArmingCheck,
    CommandResult,
    Failsafe,
    Mode,
    ModeCheck,
    Severity,
    StickMode,
    Task,
)
from sitl.autopilot.flight.profile import (
    FLAG_CUSTOM,
    FLAG_GUIDED,
    FLAG_MANUAL,
    FLAG_STABILIZE,
    AutopilotProfile,
    Parameter,
    ParameterMap,
    ParameterRef,
    Texts,
    fence_left,
    landed_after_flight,
    level,
    mission_missing,
    not_from_flight,
)


def _b(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, default, low, high, integer=True, bits=8)


def _h(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, default, low, high, integer=True, bits=16)


def _w(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, default, low, high, integer=True)


_f = Parameter
_ANY: Final = 2_147_483_647

PARAMETERS: Final[tuple[Parameter, ...]] = (
    _h("FORMAT_VERSION", 120, 0, 255),
    _h("SYSID_THISMAV", 1, 1, 255),
    _h("SYSID_MYGCS", 255, 1, 255),
    _w("RTL_ALT", 1500, 30, 300000),
    _b("FS_GCS_ENABLE", 0, 0, 7),
    _b("WP_YAW_BEHAVIOR", 2, 0, 3),
    _h("LAND_SPEED", 50, 30, 200),
    _h("LAND_SPEED_HIGH", 0, 0, 500),
    _h("LAND_ALT_LOW", 1000, 100, 10000),
    _h("PILOT_SPEED_UP", 250, 50, 500),
    _h("PILOT_SPEED_DN", 150, 0, 500),
    _b("FS_THR_ENABLE", 1, 0, 7),
    _b("FLTMODE1", 7, 0, 28),
    _b("FLTMODE6", 0, 0, 28),
    _b("FLTMODE_CH", 5, 0, 8),
    _w("LOG_BITMASK", 176126, 0, _ANY),
    _b("DISARM_DELAY", 10, 0, 127),
    _h("ANGLE_MAX", 3000, 1000, 8000),
    _b("FS_EKF_ACTION", 1, 1, 3),
    _f("PILOT_Y_RATE", 202.5, 1.0, 360.0),
    _b("FRAME_CLASS", 1, 0, 15),
    _b("FRAME_TYPE", 0, 0, 20),
    _w("ARMING_CHECK", 1, 0, _ANY),
    _w("GUID_OPTIONS", 0, 0, 255),
    _f("GUID_TIMEOUT", 1.0, 0.1, 5.0),  # ArduPilot's default is 3, with which the app refuses control
    _w("FS_OPTIONS", 16, 0, 255),
    _b("FENCE_ENABLE", 0, 0, 1),
    _b("FENCE_ACTION", 1, 0, 5),
    _b("FENCE_TYPE", 7, 0, 15),
    _f("FENCE_ALT_MAX", 100.0, 10.0, 1000.0),
    _f("FENCE_RADIUS", 300.0, 30.0, 10000.0),
    _b("BATT_MONITOR", 4, 0, 30),
    _w("BATT_CAPACITY", 3300, 0, _ANY),
    _f("BATT_LOW_VOLT", 10.5, 0.0, 120.0),
    _b("COMPASS_USE", 1, 0, 1),
    _w("COMPASS_DEV_ID", 97539, 0, _ANY),
    _f("COMPASS_OFS_X", 5.0, -1000.0, 1000.0),
    _f("COMPASS_OFS_Y", 13.0, -1000.0, 1000.0),
    _f("COMPASS_OFS_Z", -18.0, -1000.0, 1000.0),
    _b("AHRS_ORIENTATION", 0, 0, 102),
    _f("INS_ACCOFFS_X", 0.001, -3.5, 3.5),
    _f("INS_ACCOFFS_Y", 0.001, -3.5, 3.5),
    _f("INS_ACCOFFS_Z", 0.001, -3.5, 3.5),
    _w("INS_ACC_ID", 2753028, 0, _ANY),
    _w("INS_GYR_ID", 2752772, 0, _ANY),
    _h("INS_ACCEL_FILTER", 20, 0, 256),
    _h("INS_GYRO_FILTER", 20, 0, 256),
    _f("ATC_RAT_RLL_P", 0.135, 0.01, 0.5),
    _f("ATC_RAT_PIT_P", 0.135, 0.01, 0.5),
    _f("ATC_RAT_YAW_P", 0.18, 0.1, 2.5),
    _f("ATC_ANG_RLL_P", 4.5, 3.0, 12.0),
    _f("ATC_ANG_PIT_P", 4.5, 3.0, 12.0),
    _f("ATC_ANG_YAW_P", 4.5, 3.0, 12.0),
    _f("MOT_THST_HOVER", 0.39, 0.125, 0.6875),
    _f("MOT_SPIN_ARM", 0.1, 0.0, 0.3),
    _f("MOT_SPIN_MIN", 0.15, 0.0, 0.3),
    _f("PSC_POSXY_P", 1.0, 0.5, 2.0),
    _f("PSC_VELXY_P", 2.0, 0.1, 6.0),
    _f("PSC_VELXY_I", 1.0, 0.02, 1.0),
    _f("PSC_POSZ_P", 1.0, 0.5, 4.0),
    _f("PSC_VELZ_P", 5.0, 1.0, 10.0),
    _f("WPNAV_SPEED", 1000.0, 20.0, 2000.0),
    _f("WPNAV_RADIUS", 200.0, 5.0, 1000.0),
    _f("WPNAV_SPEED_UP", 150.0, 10.0, 1000.0),
    _f("WPNAV_SPEED_DN", 150.0, 10.0, 500.0),
    _f("WPNAV_ACCEL", 250.0, 50.0, 500.0),
    _f("LOIT_SPEED", 1250.0, 20.0, 3500.0),
    _b("PLND_ENABLED", 0, 0, 1),
    _b("PLND_TYPE", 1, 0, 4),
    _b("PLND_EST_TYPE", 1, 0, 1),
    _f("PLND_ACC_P_NSE", 2.5, 0.5, 5.0),
    _f("PLND_LAG", 0.02, 0.02, 0.25),
    _f("PLND_XY_DIST_MAX", 2.5, 0.0, 10.0),
    _b("PLND_STRICT", 1, 0, 2),
    _b("PLND_RET_MAX", 4, 0, 10),
    _f("PLND_TIMEOUT", 4.0, 0.0, 20.0),
    _f("PLND_ALT_MIN", 0.75, 0.0, 5.0),
    _h("PLND_OPTIONS", 0, 0, 7),
    _f("RC_OVERRIDE_TIME", 3.0, -1.0, 120.0),
    _b("RCMAP_ROLL", 1, 1, 16),
    _b("RCMAP_PITCH", 2, 1, 16),
    _b("RCMAP_THROTTLE", 3, 1, 16),
    _b("RCMAP_YAW", 4, 1, 16),
    *(
        _h(f"RC{channel}_{end}", value, 800, 2200)
        for channel in range(1, 5)
        for end, value in (("MIN", 1000), ("TRIM", 1000 if channel == 3 else 1500), ("MAX", 2000))
    ),
    _h("SERVO1_FUNCTION", 33, -1, 300),
    _h("SERVO2_FUNCTION", 34, -1, 300),
    _h("SERVO3_FUNCTION", 35, -1, 300),
    _h("SERVO4_FUNCTION", 36, -1, 300),
    _b("RNGFND1_TYPE", 0, 0, 100),
)


_GUIDED = FLAG_CUSTOM | FLAG_GUIDED | FLAG_STABILIZE | FLAG_MANUAL
_STICKS = FLAG_CUSTOM | FLAG_STABILIZE | FLAG_MANUAL

ARDUPILOT = AutopilotProfile(
    name="ardupilot",
    autopilot_id=3,
    custom_mode=lambda main, sub: main,
    flight_version=4 << 24 | 6 << 16,
    # PARAM_FLOAT, MISSION_INT, COMMAND_INT, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_*, MAVLINK2
    capabilities=2 | 4 | 8 | 64 | 128 | 256 | 8192,
    alignment_s=5.0,
    home_s=3.0,
    landed_time_s=1.0,
    landed_thrust_share=0.15,
    still_speed_m_s=1.0,
    modes=(
        Mode("STABILIZE", 0, _STICKS, Task.HOLD, in_flight=False, sticks=StickMode.ANGLE_AND_THRUST),
        Mode("ALT_HOLD", 2, _STICKS, Task.HOLD, sticks=StickMode.ANGLE_AND_CLIMB),
        Mode("AUTO", 3, _GUIDED, Task.MISSION, armable=False),
        Mode("GUIDED", 4, _GUIDED, Task.HOLD, takes_setpoints=True),
        Mode("LOITER", 5, _STICKS, Task.HOLD, sticks=StickMode.VELOCITY),
        Mode("RTL", 6, _GUIDED, Task.RETURN, armable=False),
        Mode("LAND", 9, _GUIDED, Task.LAND, armable=False),
        Mode("POSHOLD", 16, _STICKS, Task.HOLD, sticks=StickMode.VELOCITY),
        Mode("BRAKE", 17, _STICKS, Task.HOLD, armable=False),
        Mode("GUIDED_NOGPS", 20, _GUIDED, Task.HOLD, takes_setpoints=True, by_attitude=True),
        Mode("SMART_RTL", 21, _GUIDED, Task.RETURN, armable=False, available=False),
    ),
    boot_mode="STABILIZE",
    take_off_mode="GUIDED",
    after_take_off_mode="GUIDED",
    hold_mode="LOITER",
    land_mode="LAND",
    return_mode="RTL",
    read_motion=read_motion,
    read_attitude=read_attitude,
    as_aged=as_aged,
    take_off_needs_guided=True,
    thrust_is_climb_rate=True,
    thrust_is_upward=True,
    pitch_channel_reversed=True,
    turns_by_command=True,
    refused=CommandResult.FAILED,
    refused_selection=CommandResult.FAILED,
    unsupported_request=CommandResult.FAILED,
    parameter_map=ParameterMap(
        setpoint_timeout=ParameterRef("GUID_TIMEOUT"),
        cruise_speed=ParameterRef("WPNAV_SPEED", 0.01),
        top_speed=ParameterRef("WPNAV_SPEED", 0.01),
        climb_speed=ParameterRef("WPNAV_SPEED_UP", 0.01),
        descent_speed=ParameterRef("WPNAV_SPEED_DN", 0.01),
        take_off_speed=ParameterRef("WPNAV_SPEED_UP", 0.01),
        landing_speed=ParameterRef("LAND_SPEED_HIGH", 0.01),
        final_landing_speed=ParameterRef("LAND_SPEED", 0.01),
        final_landing_height=ParameterRef("LAND_ALT_LOW", 0.01),
        return_height=ParameterRef("RTL_ALT", 0.01),
        acceptance_radius=ParameterRef("WPNAV_RADIUS", 0.01),
        rc_timeout=ParameterRef("RC_OVERRIDE_TIME"),
        stick_speed=ParameterRef("LOIT_SPEED", 0.01),
        stick_climb=ParameterRef("PILOT_SPEED_UP", 0.01),
        stick_descent=ParameterRef("PILOT_SPEED_DN", 0.01),
        stick_tilt=ParameterRef("ANGLE_MAX", math.pi / 18000.0),
        stick_yaw_rate=ParameterRef("PILOT_Y_RATE", math.pi / 180.0),
        rc_loss_enabled=ParameterRef("FS_THR_ENABLE"),
        gcs_system_id=ParameterRef("SYSID_MYGCS"),
        guided_options=ParameterRef("GUID_OPTIONS"),
        hover_thrust=ParameterRef("MOT_THST_HOVER"),
        fence_action=ParameterRef("FENCE_ACTION"),
        fence_enabled=ParameterRef("FENCE_ENABLE"),
        fence_types=ParameterRef("FENCE_TYPE"),
        fence_ceiling=ParameterRef("FENCE_ALT_MAX"),
        fence_radius=ParameterRef("FENCE_RADIUS"),
    ),
    texts=Texts(
        boot=("ArduPilot Ready", "AHRS: DCM active"),
        aligned=("EKF3 IMU0 origin set", "EKF3 IMU0 is using GPS"),
        armed="Arming motors",
        disarmed="Disarming motors",
        no_such_mode="No such mode {number}",
    ),
    mode_checks=(
        ModeCheck(lambda mode, _now: not mode.available, "Mode change to {mode} failed: init failed"),
        ModeCheck(mission_missing, "Mode change to {mode} failed: init failed"),
        ModeCheck(
            lambda mode, now: (
                mode.task is Task.MISSION and now.armed and now.landed and not now.mission_climbs
            ),
            "Auto: Missing Takeoff Cmd",
        ),
        ModeCheck(not_from_flight, "Mode change to {mode} failed: throttle too high"),
    ),
    arming_checks=(
        ArmingCheck(lambda now: now.armable, "Arm: Mode not armable"),
        ArmingCheck(lambda now: now.aligned, "Arm: Need Position Estimate"),
        ArmingCheck(level, "Arm: Leaning"),
        ArmingCheck(lambda now: not now.throttle_up, "Arm: Throttle too high"),
    ),
    failsafes=(
        Failsafe(
            lambda now: landed_after_flight(now) and now.task in (Task.LAND, Task.PRECISION_LAND),
            0.05,  # the mission registers the landing first
            Severity.INFO,
            "Disarming motors",
        ),
        Failsafe(
            lambda now: now.rc_lost and not now.landed,
            0.5,
            Severity.WARNING,
            "Radio Failsafe - RTL",
            mode="RTL",
            over=lambda now: now.rc_available,
        ),
        fence_left("Fence breached", (1, 3, 5), "RTL"),
        fence_left("Fence breached", (2,), "LAND"),
        fence_left("Fence breached", (4,), "BRAKE"),
        Failsafe(lambda now: now.landed, 10.0, Severity.INFO, "Disarming motors"),
        Failsafe(
            lambda now: not now.landed and now.tilt_rad > math.radians(45.0),
            2.0,
            Severity.CRITICAL,
            "Crash: Disarming: AngErr=45>30",
        ),
    ),
    parameters=PARAMETERS,
    mission=MissionRules(
        flown=frozenset(MissionCommand),
        # change of altitude, servo, relay, ROI, mounts, camera, gimbal: taken whether or not there is one
        without_effect=frozenset({113, 181, 182, 183, 184, 195, 197, 201, 202, 203, 205, 206, 211, 222, 223})
        | frozenset({1000, 2000, 2500, 2501}),
        max_items=724,
        retry_s=1.0,
        timeout_s=8.0,
        home_first=True,
        writes_in_place=True,
        restarts=True,
        partial_lists=True,
        guided_items=True,
        waits_for_start=True,
        rewinds_on_disarm=True,
        received_text="Flight plan received",
        timeout_text="Mission upload timeout",
        item_text="Mission: {number}",
        reached_text="Reached command #{number}",
    ),
    precision_landing=precision_landing,
    precision_landing_tasks=frozenset({Task.LAND, Task.PRECISION_LAND}),
    position_control=ArdupilotControl,
    attitude_gains=AttitudeGains(
        tilt_p=4.5,  # ATC_ANG_RLL_P, ATC_ANG_PIT_P
        yaw_p=4.5,  # ATC_ANG_YAW_P
        # ATC_RAT_RLL_P, _I, _D, _IMAX, ATC_RAT_YAW_P, _I, _D, _IMAX; a whole 1 is half of each motor's range
        shares=ShareGains((0.135, 0.18), (0.135, 0.018), (0.0036, 0.0), (0.5, 0.5), 1.0, 2.0),
        # INS_GYRO_FILTER, ATC_RAT_RLL_FLTD, ATC_RAT_RLL_FLTT, ATC_RAT_YAW_FLTE
        filters=RateFilters(20.0, 20.0, target_hz=20.0, yaw_error_hz=2.5, damps_error=True),
        # ATC_INPUT_TC, ATC_ACCEL_R_MAX and _P_MAX 110000, ATC_ACCEL_Y_MAX 27000 cdeg/s², ATC_SLEW_YAW
        reference=ReferenceLimits(0.15, math.radians(1100.0), math.radians(270.0), math.radians(60.0)),
    ),
    throttle_hz=2.0,  # POSCONTROL_THROTTLE_CUTOFF_FREQ_HZ
    outer_period_s=0.0025,  # SCHED_LOOP_RATE
    imu_messages=("RAW_IMU", "SCALED_IMU"),
    imu_filter=4,  # 20 Hz: INS_GYRO_FILTER and INS_ACCEL_FILTER
)
