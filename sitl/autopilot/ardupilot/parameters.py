"""ArduPilot's parameters: the ones that `ardupilot.ARDUPILOT` names act in flight, the others are for
display.

Names, defaults and bounds after ArduCopter 4.6's parameter list. Defaults that differ from ArduCopter's
describe this vehicle or its recording. Units are ArduPilot's (cm, cm/s, centidegrees, s).
"""

from typing import Final

from sitl.autopilot.flight.parameters import Parameter


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
