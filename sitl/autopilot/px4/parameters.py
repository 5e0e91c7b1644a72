"""PX4's parameters: the ones that `px4.PX4` names act in flight, the others are for display.

Names, defaults and bounds after PX4 1.16's parameter reference, in its alphabetical order. Defaults that
differ from PX4's describe this vehicle or its recording. Units are PX4's (m, m/s, deg, s).
"""

from typing import Final

from sitl.autopilot.flight.parameters import Parameter


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
