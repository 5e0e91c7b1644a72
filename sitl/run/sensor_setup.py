"""The sensors of a scenario: their errors, those of the companion computer and those of the autopilot."""

from dataclasses import replace

import numpy as np

from companion.base.geometry import Vector3
from companion.config import GpsConfig
from sitl.devices.ports import DevicePort
from sitl.devices.rack import SensorErrors, SensorRack, Wiring
from sitl.scenario.as_built import AS_BELIEVED, BuiltVehicle
from sitl.scenario.scenario import SensorSettings
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.sensors.inertial import ImuErrors
from sitl.sensors.sensors import GpsErrors, MagErrors, RangeErrors

# home (latitude deg, longitude deg, altitude m), and the magnetic field there (NED, µT)
EarthPlace = tuple[Vector3, Vector3]


def sensor_rack(
    settings: SensorSettings,
    seed: int,
    dt_s: float,
    place: EarthPlace,
    gps_port: DevicePort,
    range_port: DevicePort,
    built: BuiltVehicle = AS_BELIEVED,
) -> SensorRack:
    """The sensors that the app reads."""
    home, field_ned_ut = place
    return SensorRack(
        seed,
        dt_s,
        home=home,
        field_ned_ut=field_ned_ut,
        gps_port=gps_port,
        range_port=range_port,
        gps_config=GpsConfig(latency_s=settings.gps_delay_s),
        errors=sensor_errors(settings, built.vibration),
        imu_position_body_m=built.imu_offset_body_m,
        wiring=Wiring(settings.imu_interface, settings.gps_wake_baud, settings.ultrasonic),
    )


def autopilot_sensors(
    settings: SensorSettings,
    rng: np.random.Generator,
    dt_s: float,
    place: EarthPlace,
    imu_filter: int,
    built: BuiltVehicle = AS_BELIEVED,
) -> SimulatedAutopilotSensors:
    """The autopilot's own sensors; `imu_filter` is their IMU's low-pass, as DLPF_CFG."""
    home, field_ned_ut = place
    errors = sensor_errors(settings, built.vibration)
    return SimulatedAutopilotSensors(
        rng,
        dt_s,
        home=home,
        field_ned_ut=field_ned_ut,
        imu_filter=imu_filter,
        imu_position_body_m=built.autopilot_imu_offset_body_m,
        gps_latency_s=settings.gps_delay_s,
        imu_errors=errors.imu,
        mag_errors=errors.magnetometer,
        gps_errors=errors.gps,
        range_errors=errors.range,
    )


def sensor_errors(settings: SensorSettings, vibration: float = 1.0) -> SensorErrors:
    """The data sheets' figures times the scenario's factors, and the rotors' vibration times another."""
    imu, mag, gps, echo = ImuErrors(), MagErrors(), GpsErrors(), RangeErrors()
    k, g = settings.imu_noise_factor, settings.gps_noise_factor
    shaking = k * settings.vibration_factor * vibration
    return SensorErrors(
        imu=replace(
            imu,
            gyro_noise_rad_s_rthz=imu.gyro_noise_rad_s_rthz * k,
            accel_noise_m_s2_rthz=imu.accel_noise_m_s2_rthz * k,
            vibration_m_s2=imu.vibration_m_s2 * shaking,
            vibration_rad_s=imu.vibration_rad_s * shaking,
            calibrated=settings.calibrated,
        ),
        magnetometer=replace(
            mag, noise_ut=mag.noise_ut * settings.mag_noise_factor, calibrated=settings.calibrated
        ),
        gps=replace(
            gps,
            wander_horizontal_m=gps.wander_horizontal_m * g,
            wander_vertical_m=gps.wander_vertical_m * g,
            noise_m=gps.noise_m * g,
            speed_noise_m_s=gps.speed_noise_m_s * g,
            climb_noise_m_s=gps.climb_noise_m_s * g,
        ),
        range=replace(
            echo,
            noise_m=echo.noise_m * settings.range_noise_factor,
            noise_share=echo.noise_share * settings.range_noise_factor,
        ),
    )
