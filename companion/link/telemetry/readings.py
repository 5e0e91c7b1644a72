"""The autopilot's own sensors: MAVLink messages -> samples in SI units. Pure; stateless.

Axes: the autopilot's body axes, FRD; it has turned its boards' mounting out already. What is not finite,
saturated, empty or marked invalid gives None. Units by message:

    HIGHRES_IMU          m/s², rad/s, gauss; `fields_updated` says what is new in this message
    RAW_IMU, SCALED_IMU  milli-g, mrad/s, milligauss: as MAVLink has it for SCALED_IMU; ArduPilot's RAW_IMU
                         holds the same (GCS_Common.cpp, send_raw_imu), another autopilot's may be counts
    GPS_RAW_INT          1e-7 deg, mm over the mean sea, cm/s over ground and its course in 1e-2 deg: there
                         is no vertical speed in it
    DISTANCE_SENSOR      cm, along the sensor's axis

ArduPilot's HIGHRES_IMU has its field in thousandths of what the message says (4.6: 231687 "gauss" are
231.7 mG, in the recording as in the source): a field that is no planet's is read as that.
"""

import math
from collections.abc import Iterable
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, scale
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.link.codec import Message, mavlink

UNKNOWN_SPEED_M_S: Final = 50.0  # accuracy of what a fix does not report
_MILLI_G: Final = 1e-3 * GRAVITY_M_S2
_GAUSS_UT: Final = 100.0
_MILLIGAUSS_UT: Final = 0.1
_MICROGAUSS_UT: Final = 1e-4
_STRONGEST_GAUSS: Final = 100.0  # the earth's is 0.65 at most, a field in microgauss 200000 at least
_WEAKEST_UT: Final = 5.0  # a compass that is missing reads 0
_SATURATED: Final = 32767
_RATE_BITS, _FORCE_BITS, _FIELD_BITS = 0b111_000, 0b111, 0b111_000_000
_TEMPERATURE_BIT: Final = 1 << 12
_UNKNOWN_U8, _UNKNOWN_U16 = 0xFF, 0xFFFF
_RANGE_ERROR_M: Final = 2.5  # of a receiver that reports its dilution alone
_DEFAULT_DILUTION: Final = 4.0
_DEFAULT_SPEED_ACCURACY_M_S: Final = 0.5
_SIGNAL_INVALID: Final = 1  # 0 is "unknown": PX4's simulator and older autopilots never fill it in
_LARGEST_VARIANCE_CM2: Final = 36  # MAVLink: a standard deviation of 6 cm at most


def stamp_s(message: Message) -> float:
    """When the autopilot says it measured, s since its boot."""
    microseconds = getattr(message, "time_usec", None)
    return float(message.time_boot_ms * 1e-3 if microseconds is None else microseconds * 1e-6)


def imu_sample(message: Message, time_s: float, interval_s: float | None = None) -> ImuSample | None:
    """Gyroscope and accelerometer of HIGHRES_IMU, RAW_IMU or SCALED_IMU, measured at time_s.

    `interval_s` after the sample before, by the autopilot's clock.
    """
    if not _is_the_first(message):
        return None
    rate = (float(message.xgyro), float(message.ygyro), float(message.zgyro))
    force = (float(message.xacc), float(message.yacc), float(message.zacc))
    if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU:
        fields = message.fields_updated
        fresh = fields & _RATE_BITS == _RATE_BITS and fields & _FORCE_BITS == _FORCE_BITS
        if not fresh or not _finite(rate + force):
            return None
        has_temperature = fields & _TEMPERATURE_BIT and math.isfinite(message.temperature)
        return ImuSample(
            time_s, rate, force, float(message.temperature) if has_temperature else 0.0, interval_s
        )
    if max(map(abs, rate + force)) >= _SATURATED:
        return None
    return ImuSample(
        time_s, scale(rate, 1e-3), scale(force, _MILLI_G), message.temperature * 0.01, interval_s
    )


def mag_sample(message: Message, time_s: float) -> MagSample | None:
    """Magnetometer of HIGHRES_IMU (if its bits are set), RAW_IMU or SCALED_IMU, measured at time_s."""
    field = (float(message.xmag), float(message.ymag), float(message.zmag))
    if not _is_the_first(message) or not _finite(field):
        return None
    largest, unit_ut = max(map(abs, field)), _MILLIGAUSS_UT
    if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU:
        if message.fields_updated & _FIELD_BITS != _FIELD_BITS:
            return None
        unit_ut = _GAUSS_UT if largest < _STRONGEST_GAUSS else _MICROGAUSS_UT
    elif largest >= _SATURATED:
        return None
    if largest * unit_ut < _WEAKEST_UT:
        return None
    return MagSample(time_s, scale(field, unit_ut))


def gps_fix(message: Message, time_s: float) -> GpsFix | None:
    """GPS_RAW_INT of a fix in three dimensions, valid at time_s."""
    if message.fix_type < mavlink.GPS_FIX_TYPE_3D_FIX or (message.lat == 0 and message.lon == 0):
        return None
    velocity, speed_accuracy = _velocity(message)
    return GpsFix(
        time_s=time_s,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.alt * 1e-3,
        velocity_ned_m_s=velocity,
        horizontal_accuracy_m=_accuracy_m(message.h_acc, message.eph),
        vertical_accuracy_m=_accuracy_m(message.v_acc, message.epv),
        speed_accuracy_m_s=speed_accuracy,
        satellites=0 if message.satellites_visible == _UNKNOWN_U8 else message.satellites_visible,
        vertical_speed_accuracy_m_s=UNKNOWN_SPEED_M_S,
    )


def range_sample(message: Message, time_s: float, minimum_m: float, maximum_m: float) -> RangeSample | None:
    """DISTANCE_SENSOR that looks down, within the sensor's own bounds and those given (m)."""
    distance_cm, distance_m = message.current_distance, message.current_distance * 0.01
    refused = (
        not looks_down(message),
        message.signal_quality == _SIGNAL_INVALID,
        _LARGEST_VARIANCE_CM2 < message.covariance < _UNKNOWN_U8,
        not max(message.min_distance, 1) <= distance_cm <= message.max_distance,
        not minimum_m <= distance_m <= maximum_m,
    )
    return None if any(refused) else RangeSample(time_s, distance_m)


def looks_down(message: Message) -> bool:
    """Whether a DISTANCE_SENSOR points at the ground."""
    return bool(message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270)


def _is_the_first(message: Message) -> bool:
    """Whether it is of the autopilot's first IMU; SCALED_IMU does (its `id` is pymavlink's, no field)."""
    return bool(message.get_msgId() == mavlink.MAVLINK_MSG_ID_SCALED_IMU or message.id == 0)


def _velocity(message: Message) -> tuple[Vector3, float]:
    """Velocity over ground (NED, down as 0) and its accuracy; without a course it may point anywhere."""
    if message.vel == _UNKNOWN_U16:
        return ZERO3, UNKNOWN_SPEED_M_S
    speed, given = message.vel * 0.01, message.vel_acc * 1e-3
    accuracy = given if given > 0.0 else _DEFAULT_SPEED_ACCURACY_M_S
    if message.cog == _UNKNOWN_U16:
        return ZERO3, accuracy if speed <= accuracy else UNKNOWN_SPEED_M_S
    course = math.radians(message.cog * 0.01)
    return (speed * math.cos(course), speed * math.sin(course), 0.0), accuracy


def _accuracy_m(reported_mm: int, dilution_e2: int) -> float:
    """What the receiver says, else what its dilution of precision makes of a usual range error."""
    if reported_mm > 0:
        return reported_mm * 1e-3
    dilution = _DEFAULT_DILUTION if dilution_e2 in (0, _UNKNOWN_U16) else dilution_e2 * 0.01
    return _RANGE_ERROR_M * dilution


def _finite(values: Iterable[float]) -> bool:
    return all(map(math.isfinite, values))
