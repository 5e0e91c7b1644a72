"""Messages of the autopilot's own sensors: one function per message.

Stamped in time since boot. PX4's HIGHRES_IMU has in `fields_updated` what is new since the last
one; ArduPilot's RAW_IMU and SCALED_IMU repeat the newest field. Both send integers where MAVLink does.
"""

import math
from collections.abc import Callable
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, Vector3, euler_from_quat, geodetic_from_ned, norm, scale
from companion.link.codec import Message, mavlink
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.telemetry import milliseconds, sys_status
from sitl.sensors.autopilot_sensors import ImuReading, SimulatedAutopilotSensors
from sitl.sensors.inertial import ImuErrors
from sitl.sensors.sensors import RangeErrors
from sitl.world.world import World

_IMU_BITS: Final = 0b111_111
_FIELD_BITS: Final = 0b111_000_000
_TEMPERATURE_C: Final = 38.0
_GEOID_M: Final = 47.0
_DILUTIONS: Final = (100, 170)
# IMU, compass and rangefinder cost computing time: they run once one of these is requested
_COSTLY_MESSAGES: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
        mavlink.MAVLINK_MSG_ID_RAW_IMU,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
    }
)
_I16: Final = 32767
_U16_KNOWN: Final = 65534
_BEYOND_CM: Final = 1  # the farthest it can measure: no echo
# the standard atmosphere (ISO 2533): pressure at sea level, gradient, exponent
_SEA_LEVEL_HPA: Final = 1013.25
_PRESSURE_LAPSE_PER_M: Final = 2.25577e-5
_PRESSURE_EXPONENT: Final = 5.25588
_PULSE_US: Final = (1000, 1000)  # motors off; and from there to full


class SensorMessages:
    """Builds the messages of one autopilot's sensors; None while there is no (new) sample."""

    def __init__(
        self, autopilot: SimulatedAutopilot, sensors: SimulatedAutopilotSensors, unix_at_start_s: float = 0.0
    ) -> None:
        """Of an autopilot and its sensors; `unix_at_start_s` is UTC (s since 1970) at time 0, 0 unknown."""
        self._autopilot = autopilot
        self._sensors = sensors
        self._unix_at_start_s = unix_at_start_s
        self._field_sent_s = self._echo_sent_s = -math.inf
        of_imu: dict[str, tuple[int, Builder]] = {
            "HIGHRES_IMU": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, self._highres_imu),
            "RAW_IMU": (mavlink.MAVLINK_MSG_ID_RAW_IMU, self._raw_imu),
            "SCALED_IMU": (mavlink.MAVLINK_MSG_ID_SCALED_IMU, self._scaled_imu),
        }
        self._builders: dict[int, Builder] = {
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: self._scaled_pressure,
            mavlink.MAVLINK_MSG_ID_VIBRATION: self._vibration,
            mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: self._servo_outputs,
            mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: self._actuator_outputs,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._distance_sensor,
            **dict(of_imu[name] for name in autopilot.profile.imu_messages),
        }

    def __contains__(self, message_id: int) -> bool:
        return message_id in self._builders

    def ask(self, message_id: int) -> None:
        """This message is requested: enable the sensors it needs."""
        if message_id in _COSTLY_MESSAGES:
            self._sensors.enable()

    def build(self, message_id: int, now_s: float) -> Message | None:
        """The message of that id, which must be one that it has."""
        return self._builders[message_id](now_s)

    # ------------------------------------------------------------ IMU and compass

    def _highres_imu(self, now_s: float) -> Message | None:
        imu, mag = self._sensors.imu, self._sensors.mag
        if imu is None or mag is None:
            return None
        bits = _IMU_BITS | (_FIELD_BITS if mag.time_s > self._field_sent_s else 0)
        self._field_sent_s = mag.time_s
        return mavlink.MAVLink_highres_imu_message(
            self._boot_us(imu.time_s), *imu.specific_force_m_s2, *imu.rate_rad_s, *scale(mag.field_ut, 0.01),
            pressure_hpa(self._altitude_m()), 0.0, self._altitude_m(), _TEMPERATURE_C, bits,
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

    # ------------------------------------------------------------ health and time

    def _sys_status(self, now_s: float) -> Message:
        sensors, unhealthy = self._sensors, 0
        if not sensors.has_fix(now_s):
            unhealthy |= mavlink.MAV_SYS_STATUS_SENSOR_GPS
        if not sensors.field_is_plausible:
            unhealthy |= mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
        return sys_status(self._autopilot, now_s, unhealthy)

    def _system_time(self, now_s: float) -> Message:
        """UTC as the receiver knows it: from the first fix on."""
        known = self._unix_at_start_s > 0.0 and self._sensors.gps is not None
        unix_us = round((self._unix_at_start_s + now_s) * 1e6) if known else 0
        return mavlink.MAVLink_system_time_message(unix_us, milliseconds(self._autopilot, now_s))

    def _vibration(self, now_s: float) -> Message:
        """VIBRATION: the rotors' vibration at the accelerometer (rms, m/s²)."""
        level = ImuErrors().vibration_m_s2 * self._sensors.throttle
        return mavlink.MAVLink_vibration_message(self._boot_us(now_s), level, level, level, 0, 0, 0)

    # ------------------------------------------------------------ air and motors

    def _scaled_pressure(self, now_s: float) -> Message:
        return mavlink.MAVLink_scaled_pressure_message(
            milliseconds(self._autopilot, now_s),
            pressure_hpa(self._altitude_m()),
            0.0,
            round(100.0 * _TEMPERATURE_C),
        )

    def _altitude_m(self) -> float:
        return self._autopilot.geodetic(self._autopilot.estimate.position_ned_m)[2]

    def _servo_outputs(self, now_s: float) -> Message:
        off_us, span_us = _PULSE_US
        pulses = [off_us + round(span_us * motor) for motor in self._sensors.motors]
        return mavlink.MAVLink_servo_output_raw_message(
            self._boot_us(now_s) & 0xFFFFFFFF, 0, *pulses, *(0,) * (8 - len(pulses))
        )

    def _actuator_outputs(self, now_s: float) -> Message:
        motors = self._sensors.motors
        outputs = [*motors, *(0.0,) * (32 - len(motors))]
        return mavlink.MAVLink_actuator_output_status_message(
            self._boot_us(now_s), (1 << len(motors)) - 1, outputs
        )

    # ------------------------------------------------------------ GPS and rangefinder

    def _gps_raw(self, now_s: float) -> Message:
        """Of a receiver with a fix; before the autopilot's alignment it has none."""
        fix = self._sensors.gps
        if fix is None or not self._autopilot.aligned or not self._sensors.has_fix(now_s):
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
        if echo is None or echo.time_s <= self._echo_sent_s:
            return None
        self._echo_sent_s = echo.time_s
        bounds = self._sensors.range_bounds
        return distance_sensor(self._boot_us(echo.time_s) // 1000, echo.distance_m, bounds)

    def _boot_us(self, time_s: float) -> int:
        booted_s = self._autopilot.booted_s
        return 0 if booted_s is None else max(0, round((time_s - booted_s) * 1e6))


def pressure_hpa(altitude_m: float) -> float:
    """Pressure (hPa) of the standard atmosphere at an altitude (m AMSL)."""
    return float(_SEA_LEVEL_HPA * (1.0 - _PRESSURE_LAPSE_PER_M * altitude_m) ** _PRESSURE_EXPONENT)


def distance_sensor(boot_ms: int, distance_m: float | None, bounds: RangeErrors) -> Message:
    """DISTANCE_SENSOR of an ultrasonic that looks down; without an echo it is beyond the farthest."""
    nearest_cm, farthest_cm = round(100.0 * bounds.minimum_m), round(100.0 * bounds.maximum_m)
    distance_cm = farthest_cm + _BEYOND_CM if distance_m is None else round(100.0 * distance_m)
    return mavlink.MAVLink_distance_sensor_message(
        boot_ms, nearest_cm, farthest_cm, distance_cm,
        mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 0, mavlink.MAV_SENSOR_ROTATION_PITCH_270, 0,
    )  # fmt: skip


def _in_thousandths(imu: ImuReading, field_ut: Vector3) -> tuple[int, ...]:
    """Milli-g, mrad/s and milligauss, cut off towards zero as C does it."""
    values = (
        *scale(imu.specific_force_m_s2, 1e3 / GRAVITY_M_S2),
        *scale(imu.rate_rad_s, 1e3),
        *scale(field_ut, 10.0),
    )
    return tuple(max(-_I16, min(_I16, int(value))) for value in values)


Builder = Callable[[float], Message | None]

SIM_STATE: Final = mavlink.MAVLINK_MSG_ID_SIM_STATE
HIL_STATE: Final = mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION


class TruthMessages:
    """The truth as real simulators send it, for an external world: SIM_STATE by ArduPilot's SITL, else
    HIL_STATE_QUATERNION. It is sent on request alone, by a simulator that was started to serve it; the app
    never requests it. Integers as the real ones send them."""

    def __init__(self, autopilot: SimulatedAutopilot, world: World, home: Vector3) -> None:
        """`home` is the world's origin: latitude (deg), longitude (deg), altitude (m)."""
        self._autopilot, self._world, self._home = autopilot, world, home
        is_px4 = autopilot.profile.autopilot_id == mavlink.MAV_AUTOPILOT_PX4
        self._message_id = HIL_STATE if is_px4 else SIM_STATE

    def __contains__(self, message_id: int) -> bool:
        return bool(message_id == self._message_id)

    def build(self, message_id: int, now_s: float) -> Message:
        return self._hil_state(now_s) if message_id == HIL_STATE else self._sim_state()

    def _sim_state(self) -> Message:
        state = self._world.state
        latitude, longitude, altitude = geodetic_from_ned(state.position_ned_m, self._home)
        # the float fields hold 1e-7 deg as well, as ArduPilot fills them in (SITL.cpp, sim_state_send)
        return mavlink.MAVLink_sim_state_message(
            *state.attitude, *euler_from_quat(state.attitude), *state.specific_force_body_m_s2,
            *state.rate_body_rad_s, latitude * 1e7, longitude * 1e7, altitude, 0.0, 0.0,
            *state.velocity_ned_m_s, int(latitude * 1e7), int(longitude * 1e7),
        )  # fmt: skip

    def _hil_state(self, now_s: float) -> Message:
        state = self._world.state
        latitude, longitude, altitude = geodetic_from_ned(state.position_ned_m, self._home)
        vx, vy, vz = (_bounded(100.0 * speed) for speed in state.velocity_ned_m_s)
        ax, ay, az = (_bounded(1e3 * force / GRAVITY_M_S2) for force in state.specific_force_body_m_s2)
        return mavlink.MAVLink_hil_state_quaternion_message(
            1000 * milliseconds(self._autopilot, now_s), list(state.attitude), *state.rate_body_rad_s,
            int(latitude * 1e7), int(longitude * 1e7), int(altitude * 1e3), vx, vy, vz, 0, 0, ax, ay, az,
        )  # fmt: skip


def _bounded(value: float) -> int:
    """Cut off as the C cast does, within 16 bits."""
    return max(-_I16, min(_I16, int(value)))
