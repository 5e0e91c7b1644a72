"""Magnetometer, GPS receiver and ultrasonic: truth to measurements (`inertial` has the IMU).

Pure: each class takes the truth and a seeded generator and returns analogue values; `sitl.devices` makes
registers and bytes of them. Body axes are FRD, world axes NED, units SI (field in µT).

Figures: MPU-9250 product specification PS-MPU-9250A-01 rev. 1.1 (AK8963), NEO-6 data sheet
GPS.G6-HW-09005 (table 1), A02YYUW and JSN-SR04T data sheets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Vector3, add, geodetic_from_ned

OUT_OF_RANGE_M: Final = 99.0  # a height without an echo
NOISE_BLOCK: Final = 256  # noise is drawn in blocks: one call costs as much as a hundred numbers


def flawed_rotation(
    rotation: FloatArray, scale: float, misalignment: float, rng: np.random.Generator
) -> list[float]:
    """Rows of (I + errors) rotation: scale errors on the diagonal, cross-axis sensitivity off it."""
    flaw = np.diag(scale * rng.standard_normal(3)) + misalignment * rng.standard_normal((3, 3)) * (
        1 - np.eye(3)
    )
    return [float(value) for value in ((np.eye(3) + flaw) @ rotation).flat]


@dataclass(frozen=True, slots=True)
class MagErrors:
    """AK8963 after its ellipsoid fit: what is left of iron and currents; standard deviations in µT."""

    noise_ut: float = 0.6
    hard_iron_ut: float = 0.7
    soft_iron: float = 0.01
    current_ut: float = 1.0  # the motors' supply at full throttle, a fixed direction
    calibrated: bool = True  # else the iron of `sitl.sensors.sensors`, instead of what a fit leaves of it


class MagSensor:
    """The magnetometer, in the axes of the accelerometer (its device converts to the AK8963's own)."""

    def __init__(self, errors: MagErrors, rng: np.random.Generator, sensor_from_body: FloatArray) -> None:
        self._errors = errors
        self._rng = rng
        self._matrix = flawed_rotation(sensor_from_body, errors.soft_iron, errors.soft_iron, rng)
        self._offset = (errors.hard_iron_ut * rng.standard_normal(3)).tolist()
        self._mounting = sensor_from_body
        direction = rng.standard_normal(3)
        self._current = (errors.current_ut * direction / np.linalg.norm(direction)).tolist()
        self._noise: list[list[float]] = []
        # for faults: an additional field (body axes), and faults of the output
        self.stray_field_ut: Vector3 = ZERO3
        self.glitches = Glitches(rng.spawn(1)[0])
        if not errors.calibrated:
            iron = uncalibrated_magnetometer(rng.spawn(1)[0])
            self._matrix, self._offset = iron.rows(sensor_from_body), iron.offset.tolist()

    @property
    def calibration_errors(self) -> CalibrationErrors:
        return CalibrationErrors.of(self._matrix, self._mounting, np.array(self._offset))

    def sample(self, field_body_ut: Vector3, throttle: float) -> Vector3:
        """Field (µT) in sensor axes from the true field in body axes."""
        if not self._noise:
            self._noise = (self._errors.noise_ut * self._rng.standard_normal((NOISE_BLOCK, 3))).tolist()
        n, o, c, m = self._noise.pop(), self._offset, self._current, self._matrix
        x, y, z = add(field_body_ut, self.stray_field_ut)
        return self.glitches.out(
            (
                m[0] * x + m[1] * y + m[2] * z + o[0] + c[0] * throttle + n[0],
                m[3] * x + m[4] * y + m[5] * z + o[1] + c[1] * throttle + n[1],
                m[6] * x + m[7] * y + m[8] * z + o[2] + c[2] * throttle + n[2],
            )
        )


@dataclass(frozen=True, slots=True)
class GpsErrors:
    """NEO-6M under open sky: 2.5 m CEP, 0.1 m/s (50 %) by the data sheet; a flight sees part of it."""

    wander_horizontal_m: float = 1.0  # an axis
    wander_vertical_m: float = 1.5
    wander_time_s: float = 60.0
    noise_m: float = 0.1
    speed_noise_m_s: float = 0.085  # an axis: 0.1 m/s is the median of the horizontal error
    climb_noise_m_s: float = 0.12
    satellites: int = 9


@dataclass(frozen=True, slots=True)
class GpsReading:
    """What the receiver has worked out for one epoch; altitude above mean sea level."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    velocity_ned_m_s: Vector3
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_m_s: float
    satellites: int


class GpsSensor:
    """The receiver's navigation solution: truth plus a slow Gauss-Markov wander plus white noise."""

    def __init__(self, errors: GpsErrors, rng: np.random.Generator, home: Vector3) -> None:
        self._errors = errors
        self._rng = rng
        self._home = home
        e = errors
        self._spread = np.array((e.wander_horizontal_m, e.wander_horizontal_m, e.wander_vertical_m))
        self._wander = self._spread * rng.standard_normal(3)
        self._noise = np.array((e.noise_m,) * 3 + (e.speed_noise_m_s,) * 2 + (e.climb_noise_m_s,))
        self._last_s: float | None = None
        self._last: GpsReading | None = None
        # for faults: a position offset, faults of the output, a stuck solution
        self.jump_ned_m: Vector3 = ZERO3
        self.glitches = Glitches(rng.spawn(1)[0])
        self.stuck = False

    @property
    def wander_ned_m(self) -> Vector3:
        """How far the solution is off by its slow wander."""
        north, east, down = map(float, self._wander)
        return (north, east, down)

    def sample(self, now_s: float, position_ned_m: Vector3, velocity_ned_m_s: Vector3) -> GpsReading:
        """The solution for the antenna at `position_ned_m` from home."""
        elapsed_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        keep = math.exp(-elapsed_s / self._errors.wander_time_s)
        push = math.sqrt(1.0 - keep * keep) * self._spread
        self._wander = keep * self._wander + push * self._rng.standard_normal(3)
        noise = self._noise * self._rng.standard_normal(6)
        north, east, down = (float(p) for p in np.array(position_ned_m) + self._wander + noise[:3])
        vn, ve, vd = (float(v) for v in np.array(velocity_ned_m_s) + noise[3:])
        place = self.glitches.out(add((north, east, down), self.jump_ned_m))
        latitude, longitude, altitude = geodetic_from_ned(place, self._home)
        if not self.stuck or self._last is None:
            count = self._errors.satellites
            self._last = GpsReading(latitude, longitude, altitude, (vn, ve, vd), 2.5, 3.8, 0.3, count)
        return self._last


@dataclass(frozen=True, slots=True)
class RangeErrors:
    """A waterproof 40 kHz ultrasonic: 3 mm + 1 %, and the echoes that a real floor loses or garbles."""

    noise_m: float = 0.003
    noise_share: float = 0.01
    lost: float = 0.03  # share of pings without an echo
    spikes: float = 0.01  # share of pings with a wrong one
    half_beam_rad: float = math.radians(15.0)  # within which a flat floor still answers at full strength
    minimum_m: float = 0.03
    maximum_m: float = 4.5


class RangeSensor:
    """The ultrasonic's echo."""

    def __init__(self, errors: RangeErrors, rng: np.random.Generator) -> None:
        self._errors = errors
        self._rng = rng
        self._last_m: float | None = None
        self.clear_faults()

    def clear_faults(self) -> None:
        self.extra_spikes = 0.0
        self.extra_lost = 0.0
        self.bias_m = 0.0
        self.stuck = False
        self.stuck_m: float | None = None
        self.other_m, self.other_share = math.inf, 0.0

    def sample(self, height_m: float, tilt_rad: float = 0.0) -> float | None:
        """Distance (m) of the first echo, or None: of a sensor `height_m` over a flat floor, tilted.

        Inside its beam the sensor measures the nearest point of the floor; tilted beyond, the beam's edge.
        """
        e = self._errors
        lost, spike, noise = self._rng.random(), self._rng.random(), self._rng.standard_normal()
        distance_m = height_m / max(0.2, math.cos(max(0.0, tilt_rad - e.half_beam_rad)))
        spikes = max(e.spikes, self.extra_spikes)
        if spike < spikes:
            # the shells' edges ring, or a neighbour's rotor does: an echo from anywhere in between
            distance_m *= spike / spikes
        if spike < self.other_share:
            distance_m = min(distance_m, self.other_m)
        distance_m += (e.noise_m + e.noise_share * distance_m) * float(noise) + self.bias_m
        if self.stuck:
            return self._last_m if self.stuck_m is None else self.stuck_m
        # nearer than the blind zone it returns the blind zone's edge
        received = lost >= max(e.lost, self.extra_lost) and distance_m <= e.maximum_m
        self._last_m = max(e.minimum_m, distance_m) if received else None
        return self._last_m


# ---------------------------------------------------------------- glitches
# Pure; the sensor's own axes and units. It has its own random numbers, so that a fault changes no other
# noise.


class Glitches:
    """Between a sensor's element and its output. `stuck`: the last reading before stays."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._last: Vector3 = ZERO3
        self.clear_faults()

    def clear_faults(self) -> None:
        self.stuck = False
        self.spike_share = 0.0
        self.spike_size = 0.0

    def spike(self, share: float, size: float) -> None:
        """A share of the readings is off by up to `size` on one axis; the worse of two faults counts."""
        self.spike_share = max(self.spike_share, share)
        self.spike_size = max(self.spike_size, size)

    def out(self, value: Vector3) -> Vector3:
        if self.stuck:
            return self._last
        self._last = value
        if self.spike_share == 0.0 or float(self._rng.random()) >= self.spike_share:
            return value
        axis, off = int(self._rng.integers(3)), float(self._rng.uniform(-self.spike_size, self.spike_size))
        x, y, z = value
        return ((x + off, y, z), (x, y + off, z), (x, y, z + off))[axis]


# ---------------------------------------------------------------- calibration errors
#     measured = matrix @ true + offset        (the sensor's own axes, SI units, field in µT)
#
# Of the IMU: tolerances of the MPU-9250 product specification PS-MPU-9250A-01 rev. 1.1 (tables 1 and 2),
# taken as uniform. Of the magnetometer: the vehicle's iron about it, magnetised (hard: an offset) or not
# (soft: a symmetric matrix, since it bends the field without turning the sensor).

ACCEL_OFFSET_M_S2: Final = 0.060 * GRAVITY_M_S2
ACCEL_SCALE: Final = 0.03
GYRO_OFFSET_RAD_S: Final = math.radians(5.0)
GYRO_SCALE: Final = 0.03
CROSS_AXIS: Final = 0.02
HARD_IRON_UT: Final = (20.0, 60.0)  # its size, whatever its direction
SOFT_IRON: Final = 0.3


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """measured = matrix (3, 3) @ true + offset (3,)."""

    matrix: FloatArray
    offset: FloatArray

    @classmethod
    def of(
        cls, flawed_rows: list[float], sensor_from_body: FloatArray, offset: FloatArray
    ) -> CalibrationErrors:
        """From the nine numbers, row by row, that take the truth in body axes to the sensor's."""
        return cls(np.reshape(flawed_rows, (3, 3)) @ sensor_from_body.T, np.array(offset, dtype=float))

    def rows(self, sensor_from_body: FloatArray) -> list[float]:
        """The inverse of `of`."""
        return [float(value) for value in (self.matrix @ sensor_from_body).flat]


@dataclass(frozen=True, slots=True)
class BoardTruth:
    """The true flaws of an IMU with its magnetometer: for tests and benches, never for the app.

    `sensor_from_body` (3, 3) is how it is mounted; a gyroscope's and an accelerometer's offsets wander by
    little (`ImuErrors`) about these.
    """

    accelerometer: CalibrationErrors
    gyroscope: CalibrationErrors
    magnetometer: CalibrationErrors
    sensor_from_body: FloatArray


def uncalibrated(rng: np.random.Generator, scale: float, offset: float) -> CalibrationErrors:
    """Of a gyroscope or an accelerometer with tolerances of scale and offset (its own unit)."""
    flaw = CROSS_AXIS * rng.uniform(-1.0, 1.0, (3, 3))
    np.fill_diagonal(flaw, scale * rng.uniform(-1.0, 1.0, 3))
    return CalibrationErrors(np.eye(3) + flaw, offset * rng.uniform(-1.0, 1.0, 3))


def uncalibrated_magnetometer(rng: np.random.Generator) -> CalibrationErrors:
    """Hard and soft iron: principal gains 0.7 to 1.3 along random directions."""
    directions, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    gains = 1.0 + SOFT_IRON * rng.uniform(-1.0, 1.0, 3)
    way = rng.standard_normal(3)
    hard_iron = float(rng.uniform(*HARD_IRON_UT)) * way / np.linalg.norm(way)
    return CalibrationErrors(np.asarray(directions @ np.diag(gains) @ directions.T), hard_iron)
