"""Messages that tell what the autopilot's own sensors measure: one function a message.

Stamped in the time since its boot. PX4's HIGHRES_IMU carries in `fields_updated` what is new since the last
one; ArduPilot's RAW_IMU and SCALED_IMU repeat the newest field. Both send as integers what MAVLink says.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from companion.geometry import GRAVITY_M_S2, Vector3, norm, scale
from sitl.autopilot import Autopilot
from sitl.onboard import Inertial, OnboardSensors
from sitl.sensors import RangeErrors

Message = Any  # pymavlink's classes are generated without types

_IMU_BITS: Final = 0b111_111
_FIELD_BITS: Final = 0b111_000_000
_TEMPERATURE_C: Final = 38.0
_GEOID_M: Final = 47.0
_DILUTIONS: Final = (100, 170)
_I16: Final = 32767
_U16_KNOWN: Final = 65534
_BEYOND_CM: Final = 1  # the farthest it can measure: no echo


class SensorMessages:
    """Builds the messages of one autopilot's sensors; None while there is nothing (new) to tell."""

    def __init__(self, autopilot: Autopilot, sensors: OnboardSensors) -> None:
        self._autopilot = autopilot
        self._sensors = sensors
        self._field_told_s = self._fix_told_s = self._echo_told_s = -math.inf
        of_imu: dict[str, tuple[int, Builder]] = {
            "HIGHRES_IMU": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, self._highres_imu),
            "RAW_IMU": (mavlink.MAVLINK_MSG_ID_RAW_IMU, self._raw_imu),
            "SCALED_IMU": (mavlink.MAVLINK_MSG_ID_SCALED_IMU, self._scaled_imu),
        }
        self._builders: dict[int, Builder] = {
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._distance_sensor,
            **dict(of_imu[name] for name in autopilot.manner.imu_messages),
        }

    def __contains__(self, message_id: int) -> bool:
        """Whether this autopilot has such a message."""
        return message_id in self._builders

    def ask(self, message_id: int) -> None:
        """Somebody wants this message: the sensors that cost something begin to work."""
        if message_id in self._builders and message_id != mavlink.MAVLINK_MSG_ID_GPS_RAW_INT:
            self._sensors.wake()

    def build(self, message_id: int, now_s: float) -> Message | None:
        """The message of that id, which must be one that it has."""
        return self._builders[message_id](now_s)

    # ------------------------------------------------------------ IMU and compass

    def _highres_imu(self, now_s: float) -> Message | None:
        imu, mag = self._sensors.imu, self._sensors.mag
        if imu is None or mag is None:
            return None
        bits = _IMU_BITS | (_FIELD_BITS if mag.time_s > self._field_told_s else 0)
        self._field_told_s = mag.time_s
        return mavlink.MAVLink_highres_imu_message(
            self._boot_us(imu.time_s), *imu.specific_force_m_s2, *imu.rate_rad_s, *scale(mag.field_ut, 0.01),
            965.0, 0.0, 400.0, _TEMPERATURE_C, bits,
        )  # fmt: skip

    def _raw_imu(self, now_s: float) -> Message | None:
        imu, mag = self._sensors.imu, self._sensors.mag
        if imu is None or mag is None:
            return None
        return mavlink.MAVLink_raw_imu_message(
            self._boot_us(imu.time_s), *_in_thousandths(imu, mag.field_ut), 0, round(100.0 * _TEMPERATURE_C)
        )

    def _scaled_imu(self, now_s: float) -> Message | None:
        imu, mag = self._sensors.imu, self._sensors.mag
        if imu is None or mag is None:
            return None
        return mavlink.MAVLink_scaled_imu_message(
            self._boot_us(imu.time_s) // 1000,
            *_in_thousandths(imu, mag.field_ut),
            round(100.0 * _TEMPERATURE_C),
        )

    # ------------------------------------------------------------ GPS and rangefinder

    def _gps_raw(self, now_s: float) -> Message:
        """Of a receiver with a fix; before the autopilot's alignment it has none."""
        fix = self._sensors.gps
        if fix is None or not self._autopilot.aligned:
            return mavlink.MAVLink_gps_raw_int_message(
                0, mavlink.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, 9999, 9999, 0, 0, 0
            )
        r = fix.reading
        north, east, _ = r.velocity_ned_m_s
        course = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000
        speed = min(round(100.0 * norm((north, east, 0.0))), _U16_KNOWN)
        return mavlink.MAVLink_gps_raw_int_message(
            self._boot_us(fix.time_s), mavlink.GPS_FIX_TYPE_3D_FIX,
            round(r.latitude_deg * 1e7), round(r.longitude_deg * 1e7), round(r.altitude_m * 1e3),
            *_DILUTIONS, speed, course, r.satellites, round((r.altitude_m + _GEOID_M) * 1e3),
            round(r.horizontal_accuracy_m * 1e3), round(r.vertical_accuracy_m * 1e3),
            round(r.speed_accuracy_m_s * 1e3),
        )  # fmt: skip

    def _distance_sensor(self, now_s: float) -> Message | None:
        echo = self._sensors.range
        if echo is None or echo.time_s <= self._echo_told_s:
            return None
        self._echo_told_s = echo.time_s
        bounds = RangeErrors()
        nearest_cm, farthest_cm = round(100.0 * bounds.minimum_m), round(100.0 * bounds.maximum_m)
        told_m, beyond_cm = echo.distance_m, farthest_cm + _BEYOND_CM
        distance_cm = beyond_cm if told_m is None else round(100.0 * told_m)
        return mavlink.MAVLink_distance_sensor_message(
            self._boot_us(echo.time_s) // 1000, nearest_cm, farthest_cm, distance_cm,
            mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 0, mavlink.MAV_SENSOR_ROTATION_PITCH_270, 0,
        )  # fmt: skip

    def _boot_us(self, time_s: float) -> int:
        booted_s = self._autopilot.booted_s
        return 0 if booted_s is None else max(0, round((time_s - booted_s) * 1e6))


def _in_thousandths(imu: Inertial, field_ut: Vector3) -> tuple[int, ...]:
    """Milli-g, mrad/s and milligauss, cut off towards zero as C does it."""
    values = (
        *scale(imu.specific_force_m_s2, 1e3 / GRAVITY_M_S2),
        *scale(imu.rate_rad_s, 1e3),
        *scale(field_ut, 10.0),
    )
    return tuple(max(-_I16, min(_I16, int(value))) for value in values)


Builder = Callable[[float], Message | None]
