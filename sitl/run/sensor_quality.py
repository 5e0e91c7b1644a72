"""How good a scenario's sensors are: the data sheets' figures times its factors."""

from __future__ import annotations

from dataclasses import replace

from sitl.devices.rack import SensorErrors
from sitl.scenario.scenario import SensorSettings
from sitl.sensors.inertial import ImuErrors
from sitl.sensors.sensors import GpsErrors, MagErrors, RangeErrors


def sensor_errors(settings: SensorSettings) -> SensorErrors:
    """The data sheets' figures times the scenario's factors."""
    imu, mag, gps, echo = ImuErrors(), MagErrors(), GpsErrors(), RangeErrors()
    k, g = settings.imu_noise_factor, settings.gps_noise_factor
    return SensorErrors(
        imu=replace(
            imu,
            gyro_noise_rad_s_rthz=imu.gyro_noise_rad_s_rthz * k,
            accel_noise_m_s2_rthz=imu.accel_noise_m_s2_rthz * k,
            vibration_m_s2=imu.vibration_m_s2 * k,
            vibration_rad_s=imu.vibration_rad_s * k,
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
