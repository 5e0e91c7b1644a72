"""Settings of the estimators: alignment, orientation, the EKF and the pad filter."""

import math
from typing import Annotated, Literal

from pydantic import Field, field_validator

from companion.config.reading import StrictModel, Vector


class AlignmentConfig(StrictModel):
    """The first attitude and the gyroscope's bias, from standing still before arming."""

    still_s: float = Field(default=2.0, ge=0.5, le=20.0)
    """Standing still this long gives the first attitude and the gyroscope's bias; raise it for a noisy
    gyroscope"""
    timeout_s: float = Field(default=15.0, ge=1.0, le=120.0)
    """If the start was in motion, a rest within this time from the start restarts the estimate; raise it
    for a vehicle that is carried to its place"""
    still_rate_rad_s: float = Field(default=0.02, gt=0.0, le=0.2)
    """Standard deviation of the turn rate that counts as still; raise it if wind or a deck shakes the
    vehicle"""
    still_force_m_s2: float = Field(default=0.25, gt=0.0, le=2.0)
    """Deviation of the specific force that counts as still; raise it together with still_rate_rad_s"""


class OrientationConfig(StrictModel):
    """The orientation pre-filter (eqs. 14-16); error rates are of the quaternion: half of rad/s."""

    kind: Literal["complementary", "madgwick"] = Field(default="complementary")
    """The pre-filter: eqs. 14-16, or Madgwick's; change it for comparison only"""


class EkfConfig(StrictModel):
    """The 31-state EKF (Table 5): noises are standard deviations of one sample unless the name says more."""

    imu_step_s: float = Field(default=0.02, gt=0.0, le=0.04)
    """Length of a step of the filter, into which IMU samples are summed; raise it to save CPU"""
    gyro_noise_rad_s: float = Field(default=0.005, gt=0.0, le=1.0)
    """Noise of an averaged turn rate, vibration included; raise it on a vehicle with strong vibration"""
    accel_noise_m_s2: float = Field(default=0.05, gt=0.0, le=20.0)
    """Noise of a specific force sample, without vibration; raise it for a noisier IMU"""
    mag_rate_hz: float = Field(default=10.0, ge=1.0, le=100.0)
    """Highest rate at which the magnetometer is fused; lower it to save CPU"""
    mag_noise_ut: float = Field(default=5.0, gt=0.0, le=20.0)
    """Noise of a magnetometer sample; raise it near motor currents"""
    mag_wander_s: float = Field(default=1.0, ge=0.0, le=100.0)
    """Correlation time of a magnetic disturbance beyond noise and biases, such as that of a steel deck;
    raise it where disturbances last longer"""
    orientation_timeout_s: float = Field(default=3.0, gt=0.0, le=60.0)
    """If the pre-filter's attitude is refused for this time, the EKF adopts it; raise it if the EKF
    restarts its attitude without need"""
    gps_accuracy_factor: float = Field(default=0.3, gt=0.0, le=5.0)
    """Standard deviation as a multiple of the accuracy that the receiver claims; raise it for a receiver
    that claims too small an error"""
    gps_position_noise_m: float = Field(default=1.0, gt=0.0, le=50.0)
    """Smallest noise of a fix's position, which drifts slowly; lower it only for RTK"""
    gps_wander_s: float = Field(default=60.0, ge=0.0, le=1000.0)
    """Correlation time of a GPS position's error; raise it near buildings, where a wrong position lasts
    long"""
    gps_velocity_noise_m_s: float = Field(default=0.085, gt=0.0, le=5.0)
    """Smallest noise of a fix's velocity; raise it for a receiver whose velocities are worse than it
    claims"""
    remember_s: float = Field(default=0.6, ge=0.1, le=3.0)
    """Largest delay of a measurement that is still fused; raise it for a slow link"""
    shaking_bound_m_s2: float = Field(default=2.0, gt=0.0, le=50.0)
    """Vibration beyond this lowers the accelerometer's weight; raise it only if normal flight exceeds it"""
    unaided_speed_m_s: float = Field(default=1.0, gt=0.0, le=100.0)
    """Before the first fix zero velocity is fused as a measurement with this standard deviation; raise it
    for a start on a moving deck"""
    accel_bias_std_m_s2: float = Field(default=0.1, gt=0.0, le=2.0)
    """Initial uncertainty of the accelerometer's bias; raise it without an inertial calibration"""
    field_std_ut: float = Field(default=0.3, gt=0.0, le=20.0)
    """Initial uncertainty of the geomagnetic field; raise it if the field setting is a guess"""
    mag_bias_std_ut: float = Field(default=1.0, gt=0.0, le=50.0)
    """Initial uncertainty of the magnetometer's bias; raise it without a calibration"""


WavePeriod = Annotated[float, Field(ge=1.0, le=30.0)]


class PadFilterConfig(StrictModel):
    """The relative motion of the pad; `_rthz` is a density per root of hertz."""

    # horizontally: a pad that drives straight on, one that speeds up or brakes, one that turns
    manoeuvre_jerk_m_s3_rthz: float = Field(default=1.0, gt=0.0, le=50.0)
    """Process noise of the acceleration of a pad that speeds up or brakes; raise it for a pad that does so
    abruptly"""
    turn_snap_m_s4_rthz: float = Field(default=0.3, gt=0.0, le=50.0)
    """Process noise of the jerk of a turning pad, in addition to the turn itself; lower it for less motion
    of the vehicle over the pad, raise it for a pad whose curves begin abruptly"""
    sway_period_s: WavePeriod = Field(default=3.5)
    """Period of the pad's horizontal motion in waves; set it to your deck's"""
    sway_acceleration_std_m_s2: float = Field(default=0.2, gt=0.0, le=10.0)
    """Horizontal acceleration in waves; raise it for higher waves"""
    # vertically: a pad that stays level, and seas of these periods
    wave_periods_s: tuple[WavePeriod, ...] = Field(default=(7.0, 4.5, 2.8), min_length=1, max_length=6)
    """Periods of the waves that may move the pad, one model for each; change them for a known deck"""
    wave_acceleration_std_m_s2: float = Field(default=0.5, gt=0.0, le=10.0)
    """Vertical acceleration in waves; raise it for higher waves"""
    tilt_acceleration_rad_s2_rthz: float = Field(default=0.1, gt=0.0, le=20.0)
    """Process noise of the pad's roll and pitch rates; raise it for a deck that rolls faster"""
    sighting_noise_scale: float = Field(default=1.0, ge=0.1, le=20.0)
    """Factor on the position noise that a sighting states; raise it above 1 for a camera whose noise is
    understated"""
    camera_delay_std_s: float = Field(default=0.03, ge=0.0, le=0.05)
    """Uncertainty of the camera stamps' delay, which is learnt in flight; 0: the delay is known; lower it
    once `calibrate-mount` has measured the delay"""
    exposure_jitter_s: float = Field(default=0.003, ge=0.0, le=0.1)
    """Jitter of the exposure time against the IMU's clock; lower it for a camera that stamps in hardware,
    raise it for one whose arrivals scatter by more"""
    first_speed_std_m_s: float = Field(default=2.0, gt=0.0, le=20.0)
    """Uncertainty of the pad's speed at the first sighting; raise it for faster pads"""
    range_noise_m: float = Field(default=0.03, gt=0.0, le=1.0)
    """Noise of an echo; raise it for a rough or soft pad surface"""
    sighting_timeout_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """If sightings are refused for this time, the filter starts again from the next one; lower it for a pad
    that moves abruptly"""
    beacon: Literal["search", "track"] = Field(default="search")
    """Use of the pad's beacon: with `search` it only leads the search; with `track` it also starts the pad's
    estimate, and carries it while the pad is unseen. Set it for a beacon that is requested or that streams
    once a second"""
    remember_s: float = Field(default=1.0, ge=0.1, le=5.0)
    """Largest delay of a sighting that is still fused; raise it for a slow camera"""
    forget_s: float = Field(default=10.0, ge=1.0, le=60.0)
    """The pad's estimate is dropped when the pad has been unseen for this time; lower it for a pad that turns
    often"""


class EstimateConfig(StrictModel):
    """Orientation filters, the 31-state EKF and the pad filter. Declination and dip follow from the field."""

    madgwick_gain: float = Field(default=0.041, ge=0.0, le=2.0)
    """Gain β, when `orientation.kind` is madgwick; raise it for a gyroscope that drifts, lower it where
    vibration tilts the attitude"""
    magnetic_field_ned_ut: Vector | None = None
    """The Earth's field at the flying site (north, east, down); declination and dip follow from it. Left out,
    it is the World Magnetic Model's at the first GPS fix; set it where the model does not hold"""
    alignment: AlignmentConfig = AlignmentConfig()
    orientation: OrientationConfig = OrientationConfig()
    ekf: EkfConfig = EkfConfig()
    pad: PadFilterConfig = PadFilterConfig()

    @field_validator("magnetic_field_ned_ut")
    @classmethod
    def _has_a_north(cls, field: Vector | None) -> Vector | None:
        if field is None:
            return None
        if math.hypot(field[0], field[1]) < 1.0:
            raise ValueError(f"expected a horizontal field of at least 1 µT for a heading, found {field}")
        if not 15.0 <= math.hypot(*field) <= 100.0:
            raise ValueError(f"expected a size of 15 to 100 µT, as on Earth, found {field}")
        return field
