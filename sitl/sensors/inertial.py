"""The MPU9250's accelerometer and gyroscope: truth to filtered analogue values.

Bias, scale, misalignment, noise, the rotors' vibration, then the filter with the data sheet's bandwidth
and delay. Pure; body axes FRD, SI units. The sensor takes the specific force where it sits (`felt_at`).

Vibration: four rotors, each at a speed of its own, shake once a turn (imbalance) and twice (blades). The
lines beat, and move with the throttle; above 100 Hz they come in folded, since the app reads at 200 Hz.
Little is left of the blades': sampled with the physics, the filter has a zero at 200 Hz. The accelerometer
rectifies: its mean shifts by a share of the vibration's square. A real flight (log171 of ArduPilot's: a 20 Hz
filter, 50 Hz) has 0.25 m/s² rms an axis from 3 to 25 Hz, as flat as lines that have moved and folded; through
that filter the vibration here is as flat, and 0.02 m/s²: a factor of 13 makes them equal.

Figures: MPU-9250 product specification PS-MPU-9250A-01 rev. 1.1 (tables 1 and 2), register map
RM-MPU-9250A-00 rev. 1.6 (filters). What a start-up or six-position calibration takes out is left out
here too: the figures are residuals, unless the sensor is uncalibrated.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Vector3, add, cross, quat_rotate
from sitl.scenario.scenario import SensorSettings
from sitl.sensors.sensors import (
    ACCEL_OFFSET_M_S2,
    ACCEL_SCALE,
    GYRO_OFFSET_RAD_S,
    GYRO_SCALE,
    NOISE_BLOCK,
    CalibrationErrors,
    Glitches,
    GpsErrors,
    MagErrors,
    RangeErrors,
    flawed_rotation,
    uncalibrated,
)
from sitl.vehicle.quadrotor import QuadrotorState

_MILLI_G: Final = 1e-3 * GRAVITY_M_S2

# DLPF_CFG -> (bandwidth Hz, delay s), register map rev. 1.6
GYRO_FILTER: Final = {1: (184.0, 0.0029), 2: (92.0, 0.0039), 3: (41.0, 0.0059), 4: (20.0, 0.0099)}
ACCEL_FILTER: Final = {1: (218.1, 0.00188), 2: (99.0, 0.00288), 3: (44.8, 0.00488), 4: (21.2, 0.00887)}


def moved_at(position_body_m: Vector3, state: QuadrotorState) -> tuple[Vector3, Vector3]:
    """Position and velocity (NED) of a point of a rigid body, as an antenna at it measures them."""
    turning = quat_rotate(state.attitude, cross(state.rate_body_rad_s, position_body_m))
    place = add(state.position_ned_m, quat_rotate(state.attitude, position_body_m))
    return place, add(state.velocity_ned_m_s, turning)


def felt_at(position_body_m: Vector3, state: QuadrotorState) -> Vector3:
    """Specific force (m/s²) at a point of a rigid body: its turning adds to what the centre of mass feels."""
    force = state.specific_force_body_m_s2
    if position_body_m == ZERO3:
        return force
    rate = state.rate_body_rad_s
    spun = cross(rate, cross(rate, position_body_m))
    return add(force, add(cross(state.angular_acceleration_body_rad_s2, position_body_m), spun))


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """MPU9250 on a small multirotor; standard deviations, drawn once a flight where not a density."""

    gyro_noise_rad_s_rthz: float = math.radians(0.01)
    gyro_bias_rad_s: float = math.radians(0.3)  # ±5 deg/s zero-rate output, after the start-up calibration
    gyro_wander_rad_s: float = math.radians(0.02)  # bias instability, Gauss-Markov
    gyro_scale: float = 0.005  # ±3 %, calibrated
    accel_noise_m_s2_rthz: float = 300e-6 * GRAVITY_M_S2
    accel_bias_m_s2: float = 7.0 * _MILLI_G  # ±60 mg, after a six-position calibration
    accel_wander_m_s2: float = 0.5 * _MILLI_G
    accel_scale: float = 0.003
    misalignment_rad: float = 0.005  # ±2 % cross-axis sensitivity, calibrated
    wander_time_s: float = 300.0
    vibration_m_s2: float = 1.5  # rms an axis at full throttle, before the filter
    vibration_rad_s: float = 0.04
    full_rotor_hz: float = 130.0  # 7800 rpm; the blades pass at twice that
    rotor_spread: float = 0.02  # of the rotors' speeds about their mean
    accel_rectification_g_g2: float = 0.005  # mean shift (g) a vibration's square (g²), drawn for each axis
    # False: the data sheet's tolerances (`CalibrationErrors`) instead of biases and scales
    calibrated: bool = True


NO_IMU_ERRORS: Final = ImuErrors(
    gyro_noise_rad_s_rthz=0.0,
    gyro_bias_rad_s=0.0,
    gyro_wander_rad_s=0.0,
    gyro_scale=0.0,
    accel_noise_m_s2_rthz=0.0,
    accel_bias_m_s2=0.0,
    accel_wander_m_s2=0.0,
    accel_scale=0.0,
    misalignment_rad=0.0,
    vibration_m_s2=0.0,
    vibration_rad_s=0.0,
    accel_rectification_g_g2=0.0,
)


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Errors of the sensors of one board."""

    imu: ImuErrors = field(default_factory=ImuErrors)
    magnetometer: MagErrors = field(default_factory=MagErrors)
    gps: GpsErrors = field(default_factory=GpsErrors)
    range: RangeErrors = field(default_factory=RangeErrors)


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
            minimum_m=settings.range_minimum_m,
        ),
    )


class ImuLowPass:
    """Two-pole Butterworth on three axes, followed by the pure delay that is missing to the data sheet's."""

    def __init__(self, bandwidth_hz: float, delay_s: float, dt_s: float) -> None:
        # the bilinear transform maps up to half the rate: a wider filter passes all that dt can show
        k = math.tan(math.pi * min(bandwidth_hz * dt_s, 0.45))
        norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
        self._b = k * k * norm
        self._a1 = 2.0 * (k * k - 1.0) * norm
        self._a2 = (1.0 - math.sqrt(2.0) * k + k * k) * norm
        # group delay of this discrete filter at zero frequency, in steps
        own = 1.0 - (self._a1 + 2.0 * self._a2) / (1.0 + self._a1 + self._a2)
        self._share = max(0.0, min(1.0, delay_s / dt_s - own))
        self._s1 = [0.0, 0.0, 0.0]
        self._s2 = [0.0, 0.0, 0.0]
        self._last = [0.0, 0.0, 0.0]

    def settle(self, value: Vector3) -> None:
        """Set the steady state for a constant value."""
        for axis, x in enumerate(value):
            self._s2[axis] = x * (self._b - self._a2)
            self._s1[axis] = x * (2.0 * self._b - self._a1) + self._s2[axis]
            self._last[axis] = x

    def step(self, x: float, y: float, z: float) -> Vector3:
        """One sample in, one out (transposed direct form II)."""
        b, a1, a2, share = self._b, self._a1, self._a2, self._share
        s1, s2, last = self._s1, self._s2, self._last
        fx, fy, fz = b * x + s1[0], b * y + s1[1], b * z + s1[2]
        b2 = 2.0 * b
        s1[0], s1[1], s1[2] = b2 * x - a1 * fx + s2[0], b2 * y - a1 * fy + s2[1], b2 * z - a1 * fz + s2[2]
        s2[0], s2[1], s2[2] = b * x - a2 * fx, b * y - a2 * fy, b * z - a2 * fz
        out = (fx + share * (last[0] - fx), fy + share * (last[1] - fy), fz + share * (last[2] - fz))
        last[0], last[1], last[2] = fx, fy, fz
        return out


class _NoiseBlocks:
    """White noise plus bias plus a slowly wandering bias on three axes, drawn a block at a time."""

    def __init__(
        self, rng: np.random.Generator, white: float, bias: float, wander: float, wander_steps: float
    ) -> None:
        self._rng = rng
        self._white = white
        self._wander = wander
        self.bias: FloatArray = bias * rng.standard_normal(3)
        self._drift: FloatArray = wander * rng.standard_normal(3)
        self._keep = math.exp(-NOISE_BLOCK / wander_steps)
        self._values: list[list[float]] = []

    def next(self) -> list[float]:
        if not self._values:
            self._draw()
        return self._values.pop()

    def skip(self, at_most: int) -> int:
        """As if `next` had been called so many times, or until the block ends; returns how many times."""
        if not self._values:
            self._draw()
        passed = min(at_most, len(self._values))
        del self._values[-passed:]
        return passed

    def _draw(self) -> None:
        push = math.sqrt(1.0 - self._keep * self._keep) * self._wander
        self._drift = self._keep * self._drift + push * self._rng.standard_normal(3)
        noise = self._white * self._rng.standard_normal((NOISE_BLOCK, 3))
        self._values = (noise + self.bias + self._drift).tolist()


class ImuSensor:
    """Gyroscope and accelerometer, up to the output of the digital low-pass filter.

    Step it at a fixed dt (the physics'). The output is in the axes of the sensor: `sensor_from_body` (3, 3)
    turns FRD into them.
    """

    def __init__(
        self,
        errors: ImuErrors,
        rng: np.random.Generator,
        dt_s: float,
        sensor_from_body: FloatArray,
        dlpf: int = 2,
    ) -> None:
        self._errors = errors
        self._dt_s = dt_s
        nyquist_rthz = math.sqrt(0.5 / dt_s)
        steps = errors.wander_time_s / dt_s
        self._accel_noise = _NoiseBlocks(
            rng,
            errors.accel_noise_m_s2_rthz * nyquist_rthz,
            errors.accel_bias_m_s2,
            errors.accel_wander_m_s2,
            steps,
        )
        self._gyro_noise = _NoiseBlocks(
            rng,
            errors.gyro_noise_rad_s_rthz * nyquist_rthz,
            errors.gyro_bias_rad_s,
            errors.gyro_wander_rad_s,
            steps,
        )
        self._accel_matrix = flawed_rotation(
            sensor_from_body, errors.accel_scale, errors.misalignment_rad, rng
        )
        self._gyro_matrix = flawed_rotation(sensor_from_body, errors.gyro_scale, errors.misalignment_rad, rng)
        self._mounting = sensor_from_body
        self._turned_rad = float(rng.uniform(0.0, math.tau))
        self._settled = False
        # for faults: a rate and a force (body axes) that are not there, where the element saturates, stronger
        # vibration, and what becomes of readings on their way out
        self.rate_offset_rad_s: Vector3 = ZERO3
        self.force_offset_m_s2: Vector3 = ZERO3
        self.gyro_glitches, self.accel_glitches = (Glitches(own) for own in rng.spawn(2))
        if not errors.calibrated:
            self._apply_factory_errors(rng.spawn(1)[0])
        self.accel_limit_m_s2 = math.inf
        self.vibration_factor = 1.0
        self._draw_rotors(rng.spawn(1)[0])
        self.set_filter(dlpf)

    def _draw_rotors(self, rng: np.random.Generator) -> None:
        spread, rectified = self._errors.rotor_spread, self._errors.accel_rectification_g_g2 / GRAVITY_M_S2
        speeds = 1.0 + spread * rng.standard_normal(4)
        phases = rng.uniform(0.0, math.tau, 4)
        self._rotors_at = tuple(zip(speeds.tolist(), phases.tolist(), strict=True))
        self._rectified = (rectified * rng.standard_normal(3)).tolist()

    def _apply_factory_errors(self, rng: np.random.Generator) -> None:
        accel = uncalibrated(rng, ACCEL_SCALE, ACCEL_OFFSET_M_S2)
        gyro = uncalibrated(rng, GYRO_SCALE, GYRO_OFFSET_RAD_S)
        self._accel_matrix, self._accel_noise.bias = accel.rows(self._mounting), accel.offset
        self._gyro_matrix, self._gyro_noise.bias = gyro.rows(self._mounting), gyro.offset

    @property
    def accel_calibration_errors(self) -> CalibrationErrors:
        """True calibration errors of the accelerometer, in sensor axes, m/s²."""
        return CalibrationErrors.of(self._accel_matrix, self._mounting, self._accel_noise.bias)

    @property
    def gyro_calibration_errors(self) -> CalibrationErrors:
        """The same of the gyroscope, rad/s."""
        return CalibrationErrors.of(self._gyro_matrix, self._mounting, self._gyro_noise.bias)

    def set_filter(self, dlpf: int) -> None:
        """Choose the low-pass filter by its register value DLPF_CFG (one not in the table: 92 Hz)."""
        self._accel_filter = ImuLowPass(*ACCEL_FILTER.get(dlpf, ACCEL_FILTER[2]), self._dt_s)
        self._gyro_filter = ImuLowPass(*GYRO_FILTER.get(dlpf, GYRO_FILTER[2]), self._dt_s)
        self._settled = False

    def skip(self, throttles: Sequence[float]) -> None:
        """Skip steps whose output is not read: random numbers and rotor phases advance as if sampled.

        The filters keep their state, which decays within a tenth of a second of samples.
        """
        left = len(throttles)
        while left:
            # block by block: the two draw in turn from one generator
            passed = self._accel_noise.skip(left)
            self._gyro_noise.skip(passed)
            left -= passed
        for throttle in throttles:
            if throttle > 0.0 and self._errors.vibration_m_s2:
                self._turn(throttle)

    def sample(
        self, specific_force_body: Vector3, rate_body: Vector3, throttle: float
    ) -> tuple[Vector3, Vector3]:
        """Specific force (m/s²) and rate (rad/s) in sensor axes after one step, from the truth in body axes.

        `throttle` is the mean motor command, 0 (rotors stand) to 1.
        """
        a, g = self._accel_noise.next(), self._gyro_noise.next()
        fx, fy, fz = specific_force_body
        p, q, r = rate_body
        dp, dq, dr = self.rate_offset_rad_s
        p, q, r = p + dp, q + dq, r + dr
        dx, dy, dz = self.force_offset_m_s2
        fx, fy, fz = fx + dx, fy + dy, fz + dz
        m = self._accel_matrix
        ax = m[0] * fx + m[1] * fy + m[2] * fz + a[0]
        ay = m[3] * fx + m[4] * fy + m[5] * fz + a[1]
        az = m[6] * fx + m[7] * fy + m[8] * fz + a[2]
        m = self._gyro_matrix
        gx = m[0] * p + m[1] * q + m[2] * r + g[0]
        gy = m[3] * p + m[4] * q + m[5] * r + g[1]
        gz = m[6] * p + m[7] * q + m[8] * r + g[2]
        if not self._settled:
            self._accel_filter.settle((ax, ay, az))
            self._gyro_filter.settle((gx, gy, gz))
            self._settled = True
        if throttle > 0.0 and self._errors.vibration_m_s2:
            once, quarter, twice = self._rotors(throttle)
            # sqrt(2) makes an rms of an amplitude; the blades' share is half the imbalance's
            k = math.sqrt(2.0) * throttle * self.vibration_factor
            va, vg = self._errors.vibration_m_s2 * k, self._errors.vibration_rad_s * k
            vx, vy, vz = va * once, va * quarter, va * (0.5 * once + 0.75 * twice)
            rx, ry, rz = self._rectified
            ax, ay, az = ax + vx + rx * vx * vx, ay + vy + ry * vy * vy, az + vz + rz * vz * vz
            gx, gy, gz = gx + vg * quarter, gy + vg * once, gz + 0.5 * vg * twice
        limit = self.accel_limit_m_s2
        if limit < math.inf:
            ax, ay, az = (max(-limit, min(limit, a)) for a in (ax, ay, az))
        force, rate = self._accel_filter.step(ax, ay, az), self._gyro_filter.step(gx, gy, gz)
        return self.accel_glitches.out(force), self.gyro_glitches.out(rate)

    def _rotors(self, throttle: float) -> Vector3:
        """Sine and cosine of the rotors' turns, and sine of twice those: half of the sum over the four."""
        self._turn(throttle)
        once = quarter = twice = 0.0
        for speed, phase in self._rotors_at:
            s, c = math.sin(angle := speed * self._turned_rad + phase), math.cos(angle)
            once, quarter, twice = once + s, quarter + c, twice + s * c
        return 0.5 * once, 0.5 * quarter, twice

    def _turn(self, throttle: float) -> None:
        """Thrust grows with speed squared."""
        self._turned_rad += math.tau * self._errors.full_rotor_hz * math.sqrt(throttle) * self._dt_s
