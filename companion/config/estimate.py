"""Settings of the estimators: alignment, orientation, the EKF and the pad filter."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, field_validator

from companion.config.reading import StrictModel, Vector


class AlignmentConfig(StrictModel):
    """The first attitude and the gyroscope's bias, from standing still before arming."""

    still_s: float = Field(default=2.0, ge=0.5, le=20.0)
    timeout_s: float = Field(default=15.0, ge=1.0, le=120.0)  # so long a rest replaces a start in motion
    still_rate_rad_s: float = Field(default=0.02, gt=0.0, le=0.2)  # standard deviation that counts as still
    still_force_m_s2: float = Field(default=0.25, gt=0.0, le=2.0)


class OrientationConfig(StrictModel):
    """The orientation pre-filter (eqs. 14-16); error rates are of the quaternion: half of rad/s."""

    kind: Literal["complementary", "madgwick"] = "complementary"


class EkfConfig(StrictModel):
    """The 31-state EKF (Table 5): noises are standard deviations of one sample unless the name says more."""

    imu_samples_per_step: int = Field(default=2, ge=1, le=10)
    gyro_noise_rad_s: float = Field(default=0.005, gt=0.0, le=1.0)
    accel_noise_m_s2: float = Field(default=0.05, gt=0.0, le=20.0)
    mag_rate_hz: float = Field(default=25.0, ge=1.0, le=100.0)
    mag_noise_ut: float = Field(default=5.0, gt=0.0, le=20.0)
    mag_wander_s: float = Field(default=0.4, ge=0.0, le=100.0)  # for so long a field's error stays
    orientation_timeout_s: float = Field(default=3.0, gt=0.0, le=60.0)  # refused for so long: start from it
    gps_accuracy_factor: float = Field(default=0.3, gt=0.0, le=5.0)  # standard deviation of what is claimed
    gps_position_noise_m: float = Field(default=1.0, gt=0.0, le=50.0)  # floor
    gps_wander_s: float = Field(default=60.0, ge=0.0, le=1000.0)  # for so long a position's error stays
    gps_velocity_noise_m_s: float = Field(default=0.085, gt=0.0, le=5.0)  # floor; the NEO-6M: 0.1 m/s CEP
    remember_s: float = Field(default=0.6, ge=0.1, le=3.0)  # how late a measurement may come
    shaking_bound_m_s2: float = Field(default=2.0, gt=0.0, le=50.0)  # of the force from sample to sample
    unaided_speed_m_s: float = Field(default=1.0, gt=0.0, le=100.0)  # before the first fix; each reading
    accel_bias_std_m_s2: float = Field(default=0.1, gt=0.0, le=2.0)
    field_std_ut: float = Field(default=0.3, gt=0.0, le=20.0)
    mag_bias_std_ut: float = Field(default=1.0, gt=0.0, le=50.0)


WavePeriod = Annotated[float, Field(ge=1.0, le=30.0)]


class PadFilterConfig(StrictModel):
    """The relative motion of the pad; `_rthz` is a density per root of hertz."""

    # horizontally: a pad that drives straight on, one that speeds up or brakes, one that turns
    manoeuvre_jerk_m_s3_rthz: float = Field(default=1.0, gt=0.0, le=50.0)
    turn_snap_m_s4_rthz: float = Field(default=0.3, gt=0.0, le=50.0)
    sway_period_s: WavePeriod = 3.5
    sway_acceleration_std_m_s2: float = Field(default=0.2, gt=0.0, le=10.0)
    # vertically: a pad that stays level, and seas of these periods
    wave_periods_s: tuple[WavePeriod, ...] = Field(default=(7.0, 4.5, 2.8), min_length=1, max_length=6)
    wave_acceleration_std_m_s2: float = Field(default=0.5, gt=0.0, le=10.0)
    tilt_acceleration_rad_s2_rthz: float = Field(default=0.1, gt=0.0, le=20.0)
    sighting_noise_scale: float = Field(default=1.0, ge=0.1, le=20.0)
    camera_delay_std_s: float = Field(
        default=0.03, ge=0.0, le=0.05
    )  # of the stamps, learnt in flight; 0: known
    exposure_jitter_s: float = Field(default=0.001, ge=0.0, le=0.1)  # of the exposure against the IMU's clock
    first_speed_std_m_s: float = Field(default=2.0, gt=0.0, le=20.0)
    range_noise_m: float = Field(default=0.03, gt=0.0, le=1.0)
    sighting_timeout_s: float = Field(
        default=0.5, gt=0.0, le=10.0
    )  # sightings refused for so long: start again
    remember_s: float = Field(default=1.0, ge=0.1, le=5.0)
    forget_s: float = Field(default=10.0, ge=1.0, le=60.0)  # unseen for so long: no pad


class EstimateConfig(StrictModel):
    """Orientation filters, the 31-state EKF and the pad filter. Declination and dip follow from the field."""

    madgwick_gain: float = Field(default=0.041, ge=0.0, le=2.0)
    magnetic_field_ned_ut: Vector = (20.9, 0.6, 42.9)
    alignment: AlignmentConfig = AlignmentConfig()
    orientation: OrientationConfig = OrientationConfig()
    ekf: EkfConfig = EkfConfig()
    pad: PadFilterConfig = PadFilterConfig()

    @field_validator("magnetic_field_ned_ut")
    @classmethod
    def _has_a_north(cls, field: Vector) -> Vector:
        if math.hypot(field[0], field[1]) < 1.0:
            raise ValueError(f"expected a horizontal field of at least 1 µT to tell north by, found {field}")
        if not 15.0 <= math.hypot(*field) <= 100.0:
            raise ValueError(f"expected a size of 15 to 100 µT, as on Earth, found {field}")
        return field
