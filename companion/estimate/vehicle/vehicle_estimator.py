"""The vehicle's half of the estimate stage: IMU, magnetometer and GPS in, attitude and motion out.

Every IMU sample immediately updates the attitude and gives an acceleration (`motion`, for the pad filter
and for predictions to now). The mean of every few samples goes to the EKF, together with the magnetometer
and the orientation pre-filter's quaternion at their own rates. A fix is fused at its own time. NED and FRD,
SI units, µT.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.base.geometry import (
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    add,
    norm,
    quat_multiply,
    quat_rotate_inverse,
    scale,
    vector3,
)
from companion.base.magnetic_field import field_here
from companion.base.messages import (
    IMU_PREDICTED_S,
    IMU_TIMEOUT_S,
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    SourceComparison,
    VehicleState,
)
from companion.config import EstimateConfig
from companion.estimate.ahrs.alignment import Block, InitialAlignment, StaticAligner, StillnessDetector
from companion.estimate.ahrs.orientation import (
    Orientation,
    heading_noise_rad,
    new_orientation,
    tilt_noise_rad,
)
from companion.estimate.gating import Gate, Timeline
from companion.estimate.motion import MotionHistory, VehiclePlace
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.autopilot_attitudes import AutopilotAttitudes, OwnAttitude
from companion.estimate.vehicle.ekf import GPS_TIMEOUT_S, VehicleEkf
from companion.estimate.vehicle.ekf_inputs import AttitudeStep, EkfInput, ImuStep, gps_step
from companion.estimate.vehicle.ekf_start import start_state
from companion.estimate.vehicle.ekf_state import EkfSnapshot
from companion.estimate.vehicle.field_mean import FieldMean
from companion.estimate.vehicle.imu_noise import ImuNoise
from companion.estimate.vehicle.inertial_motion import InertialMotion
from companion.estimate.vehicle.innovation_watch import TroubleReport
from companion.estimate.vehicle.lever_arm import LeverArm
from companion.estimate.vehicle.strapdown import Strapdown

ALIGNED_STD_RAD: Final = math.radians(20.0)  # an attitude known less well is none to fly by
ORIENTATION_RATE_HZ: Final = 10.0  # the pre-filter's error lasts: more often would say nothing new
LOST_S = 2.0  # and after so long it starts again: where it has turned meanwhile is unknown
FUTURE_S = 0.1  # whose stamp is further ahead has a wrong time
MAG_TIMEOUT_S = 0.5  # a heading is trusted for as long after the last good field
SETTLING_S = 30.0  # of the orientation pre-filter after a start in motion


class VehicleEstimator:
    """Alignment, then orientation pre-filter and EKF. `motion` is what the pad filter reads."""

    def __init__(
        self, config: EstimateConfig, antenna_body_m: Vector3, motion: MotionHistory, imu_body_m: Vector3
    ) -> None:
        """`antenna_body_m` and `imu_body_m` are from the centre of mass, FRD."""
        self._config = config
        self._antenna_body_m = antenna_body_m
        self.motion = motion
        self._expected_ut = ZERO3  # the field that it was aligned by
        self.origin: Vector3 | None = None
        self._field_ned_ut = config.magnetic_field_ned_ut  # the Earth's; None: not known yet
        self.newest_s = self._leap_s = -math.inf
        self._fields = FieldMean(config.ekf)
        self._fields_untrusted = 0  # of the wrong size or dip
        self.corrections: tuple[str, ...] = ()  # of the attitude, in words, not yet reported
        self._inertial, self._trouble = InertialMotion(motion), TroubleReport()
        self._lever = LeverArm(imu_body_m)
        self._resting = self._still_block = False
        self._mag_s = self._field_step_s = self._orientation_step_s = -math.inf
        self._mag_trusted_s = self._settled_s = -math.inf
        self.start_over()

    def start_over(self) -> None:
        """Forget all but the time of the newest sample; the alignment begins again."""
        config = self._config
        self._detector = StillnessDetector(config.alignment)
        self._aligner: StaticAligner | None = StaticAligner(config.alignment)
        self._found: InitialAlignment | None = None  # the last
        self._orientation: Orientation | None = None
        self._ekf: VehicleEkf | None = None
        self._timeline: Timeline[EkfSnapshot, EkfInput] | None = None
        self._last_raw: tuple[Vector3, Vector3] | None = None
        self._last_mean_rate: Vector3 | None = None
        self._noise = ImuNoise(config.ekf)
        self._begin_steps()

    def _begin_steps(self) -> None:
        """Without any sample or report that an EKF has not taken in."""
        self._strapdown = Strapdown()
        self._span_s: float | None = None  # of the samples in it, by their own clock
        self._fields.start_over()
        self._attitudes = AutopilotAttitudes(self.motion, self.newest_s)

    # ------------------------------------------------------------ inputs

    def add_imu(self, sample: ImuSample) -> bool:
        """Take one sample; False when it is not newer than the last, or far ahead of it and alone there.

        A single wrong stamp, once believed, would have all that follow refused.
        """
        elapsed_s = sample.time_s - self.newest_s
        if elapsed_s < -LOST_S and self._ekf is None and self.motion.newest_s is None:
            self.start_over()  # the very first stamp was the wrong one
            elapsed_s = math.inf
        if elapsed_s <= 0.0:
            return False
        leap_s, self._leap_s = self._leap_s, -math.inf
        if LOST_S < elapsed_s < math.inf and not 0.0 < sample.time_s - leap_s <= LOST_S:
            self._leap_s = sample.time_s  # believed once the next one continues from it, without a leap
            return False
        # a time that was turned from another clock into ours jitters, and may jump when that has stood still
        dt_s = elapsed_s if sample.interval_s is None else sample.interval_s
        self.newest_s = sample.time_s
        if max(dt_s, elapsed_s) > LOST_S and self._ekf is not None:
            self.start_over()
        block = None
        if self._resting or self._aligner is not None:  # in flight nothing asks whether it stands still
            block = self._detector.add(sample.time_s, sample.rate_body_rad_s, sample.specific_force_body_m_s2)
        if self._ekf is not None:
            if block is not None:
                self._still_block = block.still
                self._resting &= block.still
            self._span_s = None if sample.interval_s is None else (self._span_s or 0.0) + dt_s
            self._move(sample, dt_s)
            self._collect(sample, dt_s)
        if block is not None and self._aligner is not None:
            self._try_to_align(sample.time_s, block)
        return True

    def add_mag(self, sample: MagSample) -> bool:
        """Take one sample; False when it is not newer than the last."""
        if sample.time_s <= self._mag_s:
            return False
        dt_s = min(sample.time_s - self._mag_s, MAG_TIMEOUT_S)
        self._mag_s = sample.time_s
        if self._aligner is not None:
            self._aligner.add_field(sample.field_body_ut)
        if self._orientation is None:
            return True
        rate = self._inertial.rate_body_rad_s
        field = self._fields.on_time(sample.field_body_ut, rate)
        self._orientation.update_mag(field, dt_s)
        if self._orientation.mag_trusted:
            self._mag_trusted_s = sample.time_s
            self._fields.add(self._attitude_near(sample.time_s), field, rate)
        else:
            self._fields_untrusted += 1
        return True

    def add_gps(self, fix: GpsFix) -> bool:
        """Take one fix; False before the alignment, or when it is older than anything remembered.

        The first tells where on Earth this is, and with that the field: an alignment to magnetic north was
        only for want of it, and is made anew.
        """
        place = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        if self._field_ned_ut is None:
            self._field_ned_ut = field_here(place)
            if self._found is not None and self._resting:
                self._start(self.newest_s, self._found)  # what stands still still reads the same
            elif self._ekf is not None:
                self.start_over()
        if self._timeline is None:
            return False
        origin = self.origin or place
        step = gps_step(fix, origin, self._config.ekf, self._noise.now.usual_force_error_m_s2)
        if not self._timeline.add(fix.time_s, step):
            return False
        self.origin = origin
        return True

    def add_autopilot_attitude(self, sample: AutopilotAttitude) -> bool:
        """Take the autopilot's attitude: see `autopilot_attitudes` for what it does to ours."""
        self._lever.in_air = sample.in_air
        if self._timeline is None:
            return False
        for report, ours in self._attitudes.due(sample):
            self._hear(report, ours)
        return True

    def _hear(self, report: AutopilotAttitude, ours: Quaternion) -> None:
        """Take what a report shows of our attitude at its time."""
        ekf, orientation, inertial = self._ekf, self._orientation, self._inertial
        assert self._timeline is not None
        assert ekf is not None
        assert orientation is not None
        # one at rest that was refused may be of its own alignment: the next is asked
        compared = ekf.gates.get("second_attitude", Gate()).accepted > 0
        bias, turning_rad_s = inertial.gyro_bias_rad_s, norm(inertial.rate_body_rad_s)
        own = OwnAttitude(ours, ekf.rotation_covariance(), bias, turning_rad_s, self._resting, compared)
        found = self._attitudes.shown_by(report, own)
        if found is None:
            return
        step, time_s, before = found.step, min(found.time_s, self.newest_s), ekf.x
        if not self._timeline.add(time_s, step):
            self._timeline.add(self.newest_s, step)
        if ekf.x is before:
            return  # it has been refused
        if isinstance(step, AttitudeStep):
            self.motion.turn(found.since_s, found.time_s, step.turn)
            inertial.attitude = quat_multiply(step.turn, inertial.attitude)  # as the history
            self.corrections += (found.words,)
        self._read_ekf()
        orientation.attitude = inertial.attitude  # it has turned as wrongly

    def attitude_comparisons(self) -> tuple[SourceComparison, ...]:
        """Of our attitude with the autopilot's, and of both clocks."""
        return self._attitudes.check.comparisons(self.rotation_covariance(), self.newest_s)

    # ------------------------------------------------------------ outputs

    @property
    def gates(self) -> dict[str, Gate]:
        """How each kind of measurement has fared in its test; a field has one before the EKF's."""
        return {} if self._ekf is None else {**self._ekf.gates, "field": Gate(refused=self._fields_untrusted)}

    def rotation_covariance(self) -> FloatArray | None:
        """Covariance (3, 3) of the attitude about NED axes (rad²); None before the alignment."""
        return None if self._ekf is None else self._ekf.rotation_covariance()

    def covariance(self) -> FloatArray | None:
        """Covariance (9, 9) of `VehicleEkf.motion_covariance`; None before the alignment."""
        return None if self._ekf is None else self._ekf.motion_covariance()

    def velocity(self, time_s: float) -> Vector3:
        """Velocity NED (m/s) at a time near the newest sample's; zero before the alignment."""
        if self._ekf is None:
            return ZERO3
        return add(vector3(self._ekf.x[model.VELOCITY]), self.motion.moved(self._ekf.time_s, time_s)[1])

    @property
    def velocity_std_m_s(self) -> Vector3:
        """Of that velocity, axis by axis; zero before the alignment."""
        return ZERO3 if self._ekf is None else vector3(np.sqrt(self._ekf.P.diagonal()[model.VELOCITY]))

    def place(self, time_s: float) -> VehiclePlace | None:
        """Where on Earth it was at a time near the newest sample's; None without GPS lately."""
        ekf, origin = self._ekf, self.origin
        if ekf is None or origin is None or time_s - ekf.gps_time_s >= GPS_TIMEOUT_S:
            return None
        x, std = ekf.x, np.sqrt(ekf.P.diagonal())
        velocity, moved = vector3(x[model.VELOCITY]), self.motion.moved(ekf.time_s, time_s)[0]
        position = add(vector3(x[model.POSITION]), scale(velocity, time_s - ekf.time_s))
        return VehiclePlace(
            add(position, moved), vector3(std[model.POSITION]), vector3(std[model.VELOCITY]), origin
        )

    def state(self, now_s: float, link_late_s: float = 0.0) -> VehicleState | None:
        """The vehicle at now_s; None before the alignment, when the IMU is silent or ahead of the clock.

        By `link_late_s` its newest sample is old although it is not silent.
        """
        ekf, imu_age_s = self._ekf, now_s - self.newest_s
        if ekf is None or not -FUTURE_S <= imu_age_s <= IMU_TIMEOUT_S + link_late_s:
            return None
        imu_age_s -= link_late_s
        place, speed, unseen = self.motion.moved(ekf.time_s, now_s)
        velocity = vector3(ekf.x[model.VELOCITY])
        position = add(vector3(ekf.x[model.POSITION]), scale(velocity, now_s - ekf.time_s))
        variance, inertial = ekf.P.diagonal().tolist(), self._inertial
        place_m2, speed_m2_s2 = (0.0, 0.0) if unseen is None else unseen.diagonal().tolist()
        attitude_std_rad = 2.0 * math.sqrt(sum(variance[model.QUATERNION]))
        return VehicleState(
            time_s=now_s,
            attitude=self._attitude_near(max(now_s, self.newest_s)),
            # an older sample's rate says nothing any more
            rate_body_rad_s=inertial.rate_body_rad_s if imu_age_s <= IMU_PREDICTED_S else ZERO3,
            position_ned_m=add(position, place),
            velocity_ned_m_s=add(velocity, speed),
            acceleration_ned_m_s2=inertial.acceleration_ned_m_s2,
            gyro_bias_rad_s=inertial.gyro_bias_rad_s,
            accel_bias_m_s2=inertial.accel_bias_m_s2,
            attitude_std_rad=attitude_std_rad,
            velocity_std_m_s=math.sqrt(sum(variance[model.VELOCITY]) + 3.0 * speed_m2_s2),
            position_std_m=math.sqrt(sum(variance[model.POSITION]) + 3.0 * place_m2),
            aligned=attitude_std_rad < ALIGNED_STD_RAD,
            has_gps=now_s - ekf.gps_time_s < GPS_TIMEOUT_S,
            origin=self.origin,
            imu_age_s=max(imu_age_s, 0.0),
            side_force_ned_m_s2=inertial.side_force_ned_m_s2,
            acceleration_density_m2_s3=ekf.force_density_m2_s3,
        )

    # ------------------------------------------------------------ alignment

    def _try_to_align(self, time_s: float, block: Block) -> None:
        """Start as soon as there is something to start from, and once more at a rest soon after."""
        assert self._aligner is not None
        found = self._aligner.add_block(time_s, block)
        if self._ekf is not None and self._aligner.expired(time_s):
            self._aligner = None
        if found is None or (self._ekf is not None and not found.still):
            return
        if self._start(time_s, found) and found.still:
            self._aligner = None

    def _start(self, time_s: float, found: InitialAlignment) -> bool:
        """Begin afresh from an alignment; False when it shows that a sensor is dead."""
        start = start_state(time_s, found, self._config.ekf, self._field_ned_ut)
        if start is None:
            return False
        self._found = found
        self._begin_steps()
        self._expected_ut = start.field_ned_ut
        self._orientation = new_orientation(self._config, start.field_ned_ut, start.attitude)
        self._ekf = VehicleEkf(self._config.ekf, self._antenna_body_m, start)
        self._timeline = Timeline(self._ekf, self._config.ekf.remember_s, self._ekf.carried)
        self._inertial.gyro_bias_rad_s, self._inertial.attitude = start.gyro_bias_rad_s, start.attitude
        self._resting = found.still
        self._mag_trusted_s = time_s
        self._settled_s = time_s if found.still else time_s + SETTLING_S
        return True

    @property
    def aligned(self) -> bool:
        """Whether there is an attitude, from an alignment that still holds."""
        return self._ekf is not None

    # ------------------------------------------------------------ IMU

    def _move(self, sample: ImuSample, dt_s: float) -> None:
        """Bring everything that goes at the IMU's rate to the sample's time."""
        assert self._orientation is not None
        p, q, r = rate = sample.rate_body_rad_s
        x, y, z = force = sample.specific_force_body_m_s2
        ((a, b, c), (u, v, w)), self._last_raw = self._last_raw or (rate, force), (rate, force)
        # between two samples both are linear
        mean_rate = ((a + p) * 0.5, (b + q) * 0.5, (c + r) * 0.5)
        x, y, z = mean_force = ((u + x) * 0.5, (v + y) * 0.5, (w + z) * 0.5)
        self._noise.add(rate, force, dt_s)
        motion, lever = self.motion, self._lever
        lever.add(mean_rate, mean_force, dt_s, motion.noise_density_m2_s3, motion.turn_density_rad2_s)
        motion.imu_covariance_m2 = lever.covariance_m2
        last_mean, self._last_mean_rate = self._last_mean_rate or mean_rate, mean_rate
        u, v, w = of_turning = lever.felt_m_s2(last_mean, mean_rate, dt_s)
        mean_force = (x - u, y - v, z - w)
        self._strapdown.add(dt_s, mean_rate, mean_force)
        self._inertial.add(sample, of_turning, dt_s, mean_rate, mean_force, self._orientation)

    def _collect(self, sample: ImuSample, dt_s: float) -> None:
        """Give the EKF a step when the samples have lasted for one, to the nearest sample."""
        if self._strapdown.span_s + 0.5 * dt_s < self._config.ekf.imu_step_s:
            return
        assert self._timeline is not None
        assert self._ekf is not None
        time_s, mean, noise = sample.time_s, self._strapdown.take(), self._noise.now
        self.motion.turn_density_rad2_s = noise.rate_density_rad2_s
        step = ImuStep(
            mean.rate_body_rad_s,
            mean.specific_force_body_m_s2,
            mean.samples,
            self._field_at(time_s),
            *self._orientation_at(time_s),
            noise=noise,
            still=self._resting and self._still_block,
            at_rest=self._resting and self._still_block and not self._ekf.has_position,
            span_s=self._span_s,
        )
        self._span_s, self._still_block = None, False
        self._timeline.add(time_s, step)
        self._read_ekf()

    def _read_ekf(self) -> None:
        assert self._ekf is not None
        watch, fixes = self._ekf.watch, self._ekf.fix_watch
        self.corrections += self._trouble.news(watch.doubted_s, fixes.suspected_s, watch.restarted_s)
        self._inertial.gyro_bias_rad_s = vector3(self._ekf.x[model.GYRO_BIAS])
        self._inertial.accel_bias_m_s2 = vector3(self._ekf.x[model.ACCEL_BIAS])
        self.motion.noise_density_m2_s3 = self._ekf.force_density_m2_s3
        self._inertial.follow(self._ekf.attitude, self.newest_s - self._ekf.time_s, self._ekf.yaw_error.share)

    def _is_due(self, elapsed_s: float, rate_hz: float) -> bool:
        """Whether what comes at a rate is due at this step rather than at the next."""
        return elapsed_s >= 1.0 / rate_hz - 0.5 * self._config.ekf.imu_step_s

    def _field_at(self, time_s: float) -> Vector3 | None:
        """The field since the last time, averaged in NED and seen by the body now; None out of turn."""
        if not (
            self._fields.count and self._is_due(time_s - self._field_step_s, self._config.ekf.mag_rate_hz)
        ):
            return None
        span_s, self._field_step_s = time_s - self._field_step_s, time_s
        return quat_rotate_inverse(self._inertial.attitude, self._fields.take(span_s))

    def _attitude_near(self, time_s: float) -> Quaternion:
        """Attitude at a time near the newest sample's; further on its rotation is unknown."""
        return self._inertial.turned(self._inertial.attitude, min(time_s - self.newest_s, IMU_PREDICTED_S))

    def _orientation_at(self, time_s: float) -> tuple[Quaternion | None, float, float]:
        """The pre-filter's attitude, and the noise (rad) of its tilt and heading; no attitude out of turn."""
        assert self._orientation is not None
        if not self._is_due(time_s - self._orientation_step_s, ORIENTATION_RATE_HZ):
            return None, 0.0, 0.0
        self._orientation_step_s = time_s
        settled, trusted = time_s >= self._settled_s, time_s - self._mag_trusted_s < MAG_TIMEOUT_S
        return (
            self._inertial.turned(self._orientation.attitude, time_s - self.newest_s),
            tilt_noise_rad(self._orientation, self._inertial.disturbance_m_s2, settled),
            heading_noise_rad(self._expected_ut, trusted, settled),
        )
