"""Pads and a vehicle over them, made up for the pad filter alone: truth, and what it would be handed.

The pads move as the simulator's do. The vehicle follows at a wobbling distance and sinks from 7 m to 0.6 m,
or stays up. Its horizon is off by a fraction of a degree that wanders, which turns sightings and lends
acceleration a share of gravity alike; its accelerometer is noisy. Sightings come at 30 Hz with noise that
grows with the distance, lasts over a few frames and has a share that never changes; some are lost; all are
45 ms late. NED, SI units.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, IDENTITY, FloatArray, vector3
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.pad_types import HeightMeasurement, PadMeasurement
from sitl.pad.motion import PadMotionSettings, build_pad_motion
from sitl.pad.paths import (
    CircleMotion,
    FigureEightMotion,
    HeaveMotion,
    LineMotion,
    RandomTurnsMotion,
    StaticMotion,
)

# the scenarios' motions, and a driver that the models do not fit
MOTIONS: Final[dict[str, PadMotionSettings]] = {
    "static": StaticMotion(kind="static"),
    "line": LineMotion(kind="line", speed_m_s=1.0),
    "circle": CircleMotion(kind="circle", speed_m_s=1.5, radius_m=5.0),
    "figure-8": FigureEightMotion(kind="figure_8", speed_m_s=2.0, half_length_m=12.0),
    "heave": HeaveMotion(kind="heave", significant_height_m=0.5, peak_period_s=5.0, drift_speed_m_s=0.2),
    "random turns": RandomTurnsMotion(kind="random_turns", speed_m_s=1.5),
}
IMU_HZ: Final = 200
FRAME_HZ: Final = 30
LATENCY_S: Final = 0.045
LOST_SHARE: Final = 0.03
TILT_STD_RAD: Final = math.radians(0.3)
HEADING_STD_RAD: Final = math.radians(1.0)
JITTER_RAD: Final = math.radians(0.05)
ACCELERATION_DENSITY_M2_S3: Final = 0.02**2
ACCELERATION_NOISE_M_S2: Final = math.sqrt(ACCELERATION_DENSITY_M2_S3 * IMU_HZ)
CALIBRATION_ERROR: Final = 0.003  # of the distance
NOISE_LASTS: Final = 0.4  # correlation of the noise of neighbouring frames
VEHICLE_VELOCITY_STD_M_S: Final = 0.1
SENSOR_BELOW_M: Final = 0.08


def lever(position: FloatArray) -> FloatArray:
    """The matrix (3, 3) that makes of a small rotation what it moves a place by: rotation x position."""
    x, y, z = position.tolist()
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


@dataclass(frozen=True)
class LateSighting:
    """A sighting, and when it arrives."""

    arrival_s: float
    time_s: float
    fix: PadMeasurement


@dataclass(frozen=True)
class PadEcho:
    """An echo, and by how much it is wrong."""

    time_s: float
    fix: HeightMeasurement
    error_m: float


@dataclass(frozen=True)
class SimulatedPadTrack:
    """One run under a seed. `sinks`: from 7 m to 0.6 m in 20 s, else at 3 m."""

    motion: str
    seed: int
    duration_s: float = 24.0
    sinks: bool = True

    # ------------------------------------------------------------ truth, rows at the IMU's times

    @cached_property
    def times_s(self) -> FloatArray:
        """The IMU's times (n,)."""
        return np.arange(int(self.duration_s * IMU_HZ) + 1) / IMU_HZ

    @cached_property
    def pad(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, 3) and heading (n,) of the pad."""
        rng = np.random.default_rng([self.seed, 1])
        motion = build_pad_motion(MOTIONS[self.motion], 0.3, "along", rng)
        truths = [motion.at(t) for t in self.times_s.tolist()]
        return (
            np.array([t.position_ned_m for t in truths]),
            np.array([t.velocity_ned_m_s for t in truths]),
            np.array([t.acceleration_ned_m_s2 for t in truths]),
            np.array([t.heading_rad for t in truths]),
        )

    @cached_property
    def relative(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pad minus vehicle: position, velocity, acceleration (n, 3)."""
        rng = np.random.default_rng([self.seed, 2])
        t = self.times_s[:, None]
        # three wobbles an axis, of 3 to 9 s
        w, phase = rng.uniform(0.7, 2.0, (3, 1, 3)), rng.uniform(0.0, math.tau, (3, 1, 3))
        size = rng.uniform(0.02, 0.12, (3, 1, 3)) * np.array([1.0, 1.0, 0.3])
        place = (size * np.sin(w * t + phase)).sum(axis=0)
        speed = (size * w * np.cos(w * t + phase)).sum(axis=0)
        change = (-size * w * w * np.sin(w * t + phase)).sum(axis=0)
        height, sink, brake = self._height()
        position, velocity, acceleration, _ = self.pad
        # sideways the vehicle follows the pad, upwards it does not
        place[:, 2] += height + position[:, 2] - position[0, 2]
        speed[:, 2] += sink + velocity[:, 2]
        change[:, 2] += brake + acceleration[:, 2]
        return place, speed, change

    def _height(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        if not self.sinks:
            return np.full_like(self.times_s, 3.0), np.zeros_like(self.times_s), np.zeros_like(self.times_s)
        low, high, over_s = 0.8, 7.0, 20.0
        s = np.clip(self.times_s / over_s, 0.0, 1.0)
        height = high - (high - low) * (10.0 - 15.0 * s + 6.0 * s * s) * s**3
        sink = -(high - low) * 30.0 * s**2 * (1.0 - s) ** 2 / over_s
        return height, sink, -(high - low) * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / over_s**2

    # ------------------------------------------------------------ sensors

    @cached_property
    def attitude_error(self) -> FloatArray:
        """Rotation vectors about NED axes (n, 3): waves of 6 to 30 s."""
        rng = np.random.default_rng([self.seed, 3])
        t = self.times_s[:, None]
        w, phase = rng.uniform(0.2, 1.0, (4, 1, 3)), rng.uniform(0.0, math.tau, (4, 1, 3))
        waves = math.sqrt(0.5) * np.sin(w * t + phase).sum(axis=0)
        return np.asarray(waves * np.array([TILT_STD_RAD, TILT_STD_RAD, HEADING_STD_RAD]))

    @property
    def attitude_covariance(self) -> FloatArray:
        """What an honest estimator would say of it (3, 3)."""
        return np.diag([TILT_STD_RAD**2, TILT_STD_RAD**2, HEADING_STD_RAD**2])

    def motion_history(self) -> MotionHistory:
        """All of the flight, as the IMU measures it."""
        rng = np.random.default_rng([self.seed, 4])
        history = MotionHistory(self.duration_s + 10.0)
        history.noise_density_m2_s3 = ACCELERATION_DENSITY_M2_S3
        vehicle = self.pad[2] - self.relative[2]
        force = vehicle - np.array([0.0, 0.0, GRAVITY_M_S2])
        measured = vehicle + np.cross(self.attitude_error, force)
        measured = measured + ACCELERATION_NOISE_M_S2 * rng.normal(size=measured.shape)
        for t, acceleration in zip(self.times_s.tolist(), measured, strict=True):
            history.add(t, IDENTITY, vector3(acceleration))
        return history

    @cached_property
    def sights(self) -> list[LateSighting]:
        """The sightings, in the order of their arrival."""
        rng = np.random.default_rng([self.seed, 5])
        calibration = CALIBRATION_ERROR * rng.normal(size=3)
        lasting, made = rng.normal(size=3), []
        for k in range(int((self.duration_s - 0.1) * FRAME_HZ)):
            fresh, jitter, turn, speed = (rng.normal(size=3) for _ in range(4))
            lasting = NOISE_LASTS * lasting + math.sqrt(1.0 - NOISE_LASTS**2) * fresh
            if rng.uniform() < LOST_SHARE:
                continue
            row = round((k / FRAME_HZ + 0.01) * IMU_HZ)
            time_s = float(self.times_s[row])
            fix = self._fix(row, lasting, jitter, calibration, float(turn[0]), speed)
            made.append(LateSighting(time_s + LATENCY_S, time_s, fix))
        return made

    def echoes(self, spike_share: float) -> list[PadEcho]:
        """Echoes at 15 Hz from 2 m down, some of them of anything."""
        rng = np.random.default_rng([self.seed, 6])
        made = []
        for row in range(0, len(self.times_s), round(IMU_HZ / 15)):
            height = float(self.relative[0][row, 2]) - SENSOR_BELOW_M
            noise, wild, spiked = rng.normal(), rng.uniform(0.05, 4.0), rng.uniform() < spike_share
            if height < 2.0:
                heard = wild if spiked else height + 0.02 * noise
                time_s = float(self.times_s[row])
                made.append(
                    PadEcho(
                        time_s, HeightMeasurement(heard, (0.0, 0.0, SENSOR_BELOW_M), 0.03), heard - height
                    )
                )
        return made

    def _fix(
        self,
        row: int,
        noise: FloatArray,
        jitter: FloatArray,
        calibration: FloatArray,
        turn: float,
        speed: FloatArray,
    ) -> PadMeasurement:
        place = self.relative[0][row]
        distance = float(np.linalg.norm(place))
        # corners of half a pixel: across the ray in proportion to the distance, along it to its square
        ray = place / distance
        along = np.outer(ray, ray)
        variance = (0.0002 * distance) ** 2 * (np.eye(3) - along) + (0.0005 * distance**2) ** 2 * along
        variance = variance + 1e-8 * np.eye(3)
        rotation = self.attitude_error[row] + JITTER_RAD * jitter
        seen = place + lever(place) @ rotation + np.linalg.cholesky(variance) @ noise + calibration * distance
        swing = JITTER_RAD**2 * (lever(place) @ lever(place).T)
        vehicle = self.pad[1][row] - self.relative[1][row] + VEHICLE_VELOCITY_STD_M_S * 0.3 * speed
        return PadMeasurement(
            position_ned_m=vector3(seen),
            covariance_ned_m2=variance + swing,
            heading_rad=float(self.pad[3][row] + self.attitude_error[row][2]) + 0.005 * turn,
            heading_std_rad=0.005,
            vehicle_velocity_ned_m_s=vector3(vehicle),
            slow_variance_m2=(CALIBRATION_ERROR * distance) ** 2,
        )
