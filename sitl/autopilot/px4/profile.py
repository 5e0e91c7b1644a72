"""PX4's profile: mode numbers, texts, results and rules of PX4 1.16.

Taken from a recording of PX4 with its own simulator. The landed detector waits until the thrust is under
MPC_THR_MIN + LNDMC_LOW_T_THR (hover - MPC_THR_MIN), which takes the climb's integral 6 s at a descent of
0.3 m/s, and then LNDMC_TRIG_TIME.

PX4's parameters: the ones that `px4.PX4` names act in flight, the others are for display.

Names, defaults and bounds after PX4 1.16's parameter reference, in its alphabetical order. Defaults that
differ from PX4's describe this vehicle or its recording. Units are PX4's (m, m/s, deg, s).
"""

import math
from typing import Final

from sitl.autopilot.control.attitude_control import AttitudeGains, RateFilters, ShareGains
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
    FLAG_AUTO,
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
    setpoints_stopped,
)
from sitl.autopilot.px4.control import Px4Control, as_aged, read_attitude, read_motion
from sitl.autopilot.px4.precision_landing import Px4PrecisionLanding


def _i(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, default, low, high, integer=True)


_f = Parameter
_ANY: Final = 2_147_483_647

PARAMETERS: Final[tuple[Parameter, ...]] = (
    _i("BAT1_SOURCE", 0, -1, 2),
    _f("BAT_CRIT_THR", 0.07, 0.05, 0.5),
    _f("BAT_LOW_THR", 0.15, 0.12, 0.5),
    _i("CAL_ACC0_ID", 1310988, 0, _ANY),
    _i("CAL_GYRO0_ID", 1310988, 0, _ANY),
    _i("CAL_MAG0_ID", 197388, 0, _ANY),
    _i("CAL_MAG0_ROT", 0, -1, 100),
    _i("CA_AIRFRAME", 0, 0, 17),
    _i("CA_ROTOR_COUNT", 4, 0, 12),
    _f("COM_DISARM_LAND", 2.0, -1.0, 20.0),
    _f("COM_FAIL_ACT_T", 5.0, 0.0, 25.0),
    _i("COM_FLTMODE1", -1, -1, 16),
    _i("COM_OBL_RC_ACT", 5, 0, 7),  # PX4's default is 0, of which the app warns
    _f("COM_OF_LOSS_T", 1.0, 0.0, 60.0),
    _i("COM_RCL_EXCEPT", 0, 0, 31),
    _i("COM_RC_IN_MODE", 3, 0, 4),
    _f("COM_RC_LOSS_T", 0.5, 0.0, 35.0),
    _i("COM_RC_OVERRIDE", 1, 0, 3),
    _i("EKF2_MULTI_IMU", 0, 0, 4),
    _i("GF_ACTION", 0, 0, 5),
    _f("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0),
    _f("IMU_GYRO_CUTOFF", 40.0, 0.0, 1000.0),
    _f("LNDMC_Z_VEL_MAX", 0.25, 0.0, 1.0),
    _i("MAV_COMP_ID", 1, 1, 250),
    _i("MAV_PROTO_VER", 0, 0, 2),
    _i("MAV_SYS_ID", 1, 1, 250),
    _i("MAV_TYPE", 2, 0, 22),
    _f("MC_PITCH_P", 6.5, 0.0, 12.0),
    _f("MC_ROLLRATE_P", 0.15, 0.01, 0.5),
    _f("MC_ROLL_P", 6.5, 0.0, 12.0),
    _f("MC_YAWRATE_MAX", 200.0, 0.0, 1800.0),
    _f("MC_YAW_P", 2.8, 0.0, 5.0),
    _f("MIS_TAKEOFF_ALT", 2.5, 0.0, 80.0),
    _f("MPC_LAND_ALT3", 1.0, 0.0, 122.0),
    _f("MPC_LAND_CRWL", 0.3, 0.1, 2.0),
    _f("MPC_LAND_SPEED", 0.7, 0.6, 2.0),
    _f("MPC_MAN_TILT_MAX", 35.0, 1.0, 70.0),
    _f("MPC_MAN_Y_MAX", 150.0, 0.0, 400.0),
    _f("MPC_THR_HOVER", 0.5, 0.1, 0.8),
    _f("MPC_THR_MAX", 1.0, 0.0, 1.0),
    _f("MPC_THR_MIN", 0.12, 0.05, 0.5),
    _f("MPC_TILTMAX_AIR", 45.0, 20.0, 89.0),
    _f("MPC_TKO_SPEED", 1.5, 1.0, 5.0),
    _f("MPC_VEL_MANUAL", 10.0, 3.0, 20.0),
    _f("MPC_XY_CRUISE", 5.0, 3.0, 20.0),
    _f("MPC_XY_P", 0.95, 0.0, 2.0),
    _f("MPC_XY_VEL_MAX", 12.0, 0.0, 20.0),
    _f("MPC_XY_VEL_P_ACC", 1.8, 1.2, 5.0),
    _f("MPC_Z_P", 1.0, 0.1, 1.5),
    _f("MPC_Z_VEL_MAX_DN", 1.5, 0.5, 4.0),
    _f("MPC_Z_VEL_MAX_UP", 3.0, 0.5, 8.0),
    _f("MPC_Z_V_AUTO_DN", 1.5, 0.5, 4.0),
    _f("MPC_Z_V_AUTO_UP", 3.0, 0.5, 8.0),
    _f("NAV_ACC_RAD", 2.0, 0.05, 200.0),
    _i("NAV_DLL_ACT", 0, 0, 6),
    _f("NAV_MC_ALT_RAD", 0.8, 0.05, 200.0),
    _i("NAV_RCL_ACT", 2, 1, 6),
    _f("PLD_BTOUT", 5.0, 0.0, 50.0),
    _f("PLD_FAPPR_ALT", 0.1, 0.0, 10.0),
    _f("PLD_HACC_RAD", 0.2, 0.0, 10.0),
    _i("PLD_MAX_SRCH", 3, 0, 100),
    _f("PLD_SRCH_ALT", 10.0, 0.0, 100.0),
    _f("PLD_SRCH_TOUT", 10.0, 0.0, 100.0),
    _i("RC_CHAN_CNT", 0, 0, 18),
    _i("RC_MAP_PITCH", 2, 0, 18),
    _i("RC_MAP_ROLL", 1, 0, 18),
    _i("RC_MAP_THROTTLE", 3, 0, 18),
    _i("RC_MAP_YAW", 4, 0, 18),
    _i("RTL_PLD_MD", 0, 0, 2),
    _f("RTL_RETURN_ALT", 10.0, 0.0, 150.0),
    _i("SDLOG_MODE", 0, -1, 4),
    _i("SENS_BOARD_ROT", 0, -1, 40),
    _i("SYS_AUTOCONFIG", 0, 0, 2),
    _i("SYS_AUTOSTART", 4001, 0, 9999999),
    _i("SYS_HAS_MAG", 1, 0, 4),
    _i("SYS_HITL", 0, -1, 2),
)


_AUTO = FLAG_CUSTOM | FLAG_AUTO | FLAG_GUIDED | FLAG_STABILIZE
_STICKS = FLAG_CUSTOM | FLAG_STABILIZE | FLAG_MANUAL


def _number(main: int, sub: int = 0) -> int:
    """custom_mode of a main and a sub mode."""
    return main << 16 | sub << 24


def _offboard_lost(
    values: tuple[int, ...], title: str, *, mode: str = "", task: Task | None = None
) -> Failsafe:
    """What follows when setpoints stop, where COM_OBL_RC_ACT has one of the values."""
    return Failsafe(
        lambda now: setpoints_stopped(now) and now.setpoints_lost_action in values,
        0.0,
        Severity.CRITICAL,
        f"Failsafe activated: No offboard control signal, switching to {title}",
        mode=mode,
        task=task,
    )


PX4 = AutopilotProfile(
    name="px4",
    autopilot_id=12,
    custom_mode=_number,
    flight_version=1 << 24 | 16 << 16 | 1 << 8 | 255,
    # MISSION_INT, COMMAND_INT, PARAM_ENCODE_BYTEWISE, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_*, MAVLINK2
    capabilities=4 | 8 | 16 | 64 | 128 | 256 | 8192,
    parameters_bytewise=True,
    alignment_s=3.0,
    home_s=3.0,
    prearm_in_health_only=True,
    landed_time_s=1.0,
    landed_thrust_share=0.47,
    still_speed_m_s=0.25,
    modes=(
        Mode(
            "MANUAL",
            _number(1),
            FLAG_CUSTOM | FLAG_MANUAL,
            Task.HOLD,
            in_flight=False,
            sticks=StickMode.ANGLE_AND_THRUST,
            title="Manual",
        ),
        Mode("ALTCTL", _number(2), _STICKS, Task.HOLD, sticks=StickMode.ANGLE_AND_CLIMB, title="Altitude"),
        Mode("POSCTL", _number(3), _STICKS, Task.HOLD, sticks=StickMode.VELOCITY, title="Position"),
        Mode("AUTO_TAKEOFF", _number(4, 2), _AUTO, Task.TAKE_OFF, title="Takeoff"),
        Mode("AUTO_LOITER", _number(4, 3), _AUTO, Task.HOLD, title="Hold"),
        Mode("AUTO_MISSION", _number(4, 4), _AUTO, Task.MISSION, title="Mission"),
        Mode("AUTO_RTL", _number(4, 5), _AUTO, Task.RETURN, armable=False, title="Return"),
        Mode("AUTO_LAND", _number(4, 6), _AUTO, Task.LAND, armable=False, title="Land"),
        Mode(
            "AUTO_PRECLAND",
            _number(4, 9),
            _AUTO,
            Task.PRECISION_LAND,
            armable=False,
            title="Precision Landing",
        ),
        Mode("ACRO", _number(5), FLAG_CUSTOM | FLAG_MANUAL, Task.HOLD, title="Acro", available=False),
        Mode(
            "OFFBOARD",
            _number(6),
            FLAG_CUSTOM | FLAG_STABILIZE,
            Task.SETPOINT,
            takes_setpoints=True,
            title="Offboard",
        ),
        Mode(
            "STABILIZED",
            _number(7),
            _STICKS,
            Task.HOLD,
            in_flight=False,
            sticks=StickMode.ANGLE_AND_THRUST,
            title="Stabilized",
        ),
    ),
    boot_mode="AUTO_LOITER",
    after_disarm_mode="AUTO_LOITER",
    take_off_mode="AUTO_TAKEOFF",
    after_take_off_mode="AUTO_LOITER",
    hold_mode="AUTO_LOITER",
    land_mode="AUTO_LAND",
    return_mode="AUTO_RTL",
    read_motion=read_motion,
    read_attitude=read_attitude,
    as_aged=as_aged,
    external_needs_setpoints=True,
    takes_off_by_setpoint=True,
    refused=CommandResult.TEMPORARILY_REJECTED,
    refused_selection=CommandResult.DENIED,
    refused_disarming_text="Disarming denied: not landed",
    unsupported_request=CommandResult.UNSUPPORTED,
    parameter_map=ParameterMap(
        setpoint_timeout=ParameterRef("COM_OF_LOSS_T"),
        setpoints_lost_action=ParameterRef("COM_OBL_RC_ACT"),
        cruise_speed=ParameterRef("MPC_XY_CRUISE"),
        top_speed=ParameterRef("MPC_XY_VEL_MAX"),
        climb_speed=ParameterRef("MPC_Z_V_AUTO_UP"),
        descent_speed=ParameterRef("MPC_Z_V_AUTO_DN"),
        take_off_speed=ParameterRef("MPC_TKO_SPEED"),
        landing_speed=ParameterRef("MPC_LAND_SPEED"),
        final_landing_speed=ParameterRef("MPC_LAND_CRWL"),
        final_landing_height=ParameterRef("MPC_LAND_ALT3"),
        return_height=ParameterRef("RTL_RETURN_ALT"),
        acceptance_radius=ParameterRef("NAV_ACC_RAD"),
        rc_timeout=ParameterRef("COM_RC_LOSS_T"),
        stick_speed=ParameterRef("MPC_VEL_MANUAL"),
        stick_climb=ParameterRef("MPC_Z_VEL_MAX_UP"),
        stick_descent=ParameterRef("MPC_Z_VEL_MAX_DN"),
        stick_tilt=ParameterRef("MPC_MAN_TILT_MAX", math.pi / 180.0),
        stick_yaw_rate=ParameterRef("MPC_MAN_Y_MAX", math.pi / 180.0),
        rc_loss_exceptions=ParameterRef("COM_RCL_EXCEPT"),
        still_speed=ParameterRef("LNDMC_Z_VEL_MAX"),
        fence_action=ParameterRef("GF_ACTION"),
        take_off_height=ParameterRef("MIS_TAKEOFF_ALT"),
    ),
    texts=Texts(
        boot=(),
        aligned=("Ready for takeoff!",),
        armed="Armed by external command",
        disarmed="Disarmed by external command",
        lifted="Takeoff detected",
        landed="Landing detected",
        landing="Landing at current position",
        terminated="Flight termination active",
        no_mission="Mission start denied! No valid mission",
    ),
    mode_checks=tuple(
        ModeCheck(fails, "Switching to mode '{mode}' is currently not available")
        for fails in (
            lambda mode, _now: not mode.available,
            mission_missing,
            not_from_flight,
            lambda mode, now: (
                mode.task is Task.SETPOINT and now.setpoint_age_s >= min(0.5, now.setpoint_timeout_s)
            ),
        )
    ),
    arming_checks=(
        ArmingCheck(lambda now: now.aligned, "Arming denied: Resolve system health failures first"),
        ArmingCheck(level, "Arming denied: Attitude failure (roll or pitch)"),
        ArmingCheck(lambda now: not setpoints_stopped(now), "Arming denied: No offboard control signal"),
        ArmingCheck(lambda now: now.armable, "Arming denied: Mode not suitable for takeoff"),
    ),
    failsafes=(
        # nobody is at the sticks that Position, Altitude and Stabilized are for
        _offboard_lost((0, 1, 2), "Position", mode="POSCTL", task=Task.DESCEND),
        _offboard_lost((3,), "Return", mode="AUTO_RTL"),
        _offboard_lost((4,), "Land", mode="AUTO_LAND"),
        _offboard_lost((5,), "Hold", mode="AUTO_LOITER"),
        _offboard_lost((6, 7), "Disarm"),
        Failsafe(
            lambda now: now.rc_lost,
            5.0,  # COM_FAIL_ACT_T
            Severity.CRITICAL,
            "Failsafe activated: Manual control lost, switching to Return",
            mode="AUTO_RTL",
            over=lambda now: now.rc_available,
        ),
        fence_left("Failsafe activated: Geofence violated, switching to Hold", (2,), "AUTO_LOITER"),
        fence_left("Failsafe activated: Geofence violated, switching to Return", (3,), "AUTO_RTL"),
        fence_left("Failsafe activated: Geofence violated, switching to Land", (5,), "AUTO_LAND"),
        Failsafe(landed_after_flight, 2.0, Severity.INFO, "Disarmed by landing"),
        Failsafe(
            lambda now: now.landed and not now.has_flown,
            10.0,
            Severity.INFO,
            "Disarmed by auto preflight disarming",
        ),
    ),
    parameters=PARAMETERS,
    mission=MissionRules(
        flown=frozenset(MissionCommand)
        - {
            MissionCommand.LOITER_TURNS,
            MissionCommand.SPLINE_WAYPOINT,
            MissionCommand.CONDITION_DELAY,
            MissionCommand.CONDITION_YAW,
        },
        # servo, ROI, mounts, camera, gimbal: PX4 takes them whether or not there is one
        without_effect=frozenset(
            {183, 187, 195, 197, 201, 204, 205, 206, 214, 530, 531, 532, 1000, 1001, 2000, 2001}
        )
        | frozenset({2500, 2501}),
        max_items=2000,
        retry_s=0.25,
        timeout_s=5.0,
        asks_for_integers=True,
        takes_off_before_mission=True,
        fences_unite=True,
        uses_yaw_parameter=True,
        timeout_text="Operation timeout",
        unknown_current_text="WPM: WP CURR CMD: Not in list",
        finished_text="Mission finished, loitering",
    ),
    precision_landing=Px4PrecisionLanding,
    precision_landing_tasks=frozenset({Task.PRECISION_LAND}),
    position_control=Px4Control,
    attitude_gains=AttitudeGains(
        # MC_ROLLRATE_P, _I, _D, MC_RR_INT_LIM, MC_YAWRATE_P, _I, _D, MC_YR_INT_LIM; the pseudo-inverse of a
        # "+" is normalised so that a whole 1 is 0.71 of each motor about roll and pitch, all of it about yaw
        shares=ShareGains((0.15, 0.2), (0.2, 0.1), (0.003, 0.0), (0.3, 0.3), math.sqrt(2.0), 4.0),
        # IMU_GYRO_CUTOFF, IMU_DGYRO_CUTOFF, MC_YAW_TQ_CUTOFF
        filters=RateFilters(40.0, 30.0, yaw_torque_hz=2.0),
    ),  # MC_ROLL_P, MC_PITCH_P, MC_YAW_P, MC_YAWRATE_MAX
    outer_period_s=0.01,
    imu_messages=("HIGHRES_IMU",),
    imu_filter=2,  # the chip's own, 92 Hz: HIGHRES_IMU comes before IMU_GYRO_CUTOFF
)
