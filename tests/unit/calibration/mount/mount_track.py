"""A made-up recording for `calibrate-mount`: a vehicle swayed over a pad, its IMU, its camera, the truth.

Everything follows from smooth functions of time; rates and accelerations are their differences over a tenth
of a millisecond.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from calibration.mount.model import exp, log, transposed
from calibration.mount.recording import ImuSamples, PadObservations
from companion.base.geometry import GRAVITY_M_S2, FloatArray, matrix_from_quat, quat_from_euler

H = 1e-4


@dataclass(frozen=True)
class Flaws:
    """What is wrong with the recording; standard deviations where the seed draws."""

    angles_deg: tuple[float, float, float] = (2.0, -3.0, 4.0)  # of the mount: roll, tilt, yaw
    time_offset_s: float = 0.02
    position_m: tuple[float, float, float] = (0.03, 0.0, 0.08)
    gyro_cross: float = 0.0
    accel_cross: float = 0.0
    gyro_bias_rad_s: float = 0.01
    accel_bias_m_s2: float = 0.05
    pad_tilt_deg: float = 0.5
    pixel_noise: float = 1.0  # the sightings' noise, of what they say
    flipped: float = 0.0  # share
    swing_deg: tuple[float, float, float] = (15.0, 15.0, 25.0)
    swing_m: float = 0.25


@dataclass
class MountTrack:
    """One recording; `body_from_camera` is the truth."""

    seed: int
    flaws: Flaws = field(default_factory=Flaws)
    seconds: float = 60.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        flaws = self.flaws
        roll, tilt, yaw = (math.radians(a) for a in flaws.angles_deg)
        downward = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        self.body_from_camera = matrix_from_quat(quat_from_euler(roll, tilt, yaw)) @ downward
        self._waves = [
            (self.rng.uniform(0.2, 0.9, 3), self.rng.uniform(0.0, 2.0 * math.pi, 3)) for _ in range(6)
        ]
        pad_tilt = math.radians(flaws.pad_tilt_deg) * self.rng.standard_normal(2)
        self.pad_in_world = exp(np.array([pad_tilt[0], pad_tilt[1], 0.3]))

    def _wave(self, k: int, t: FloatArray) -> FloatArray:
        speeds, phases = self._waves[k]
        return np.asarray(np.sin(2.0 * math.pi * speeds * t[:, None] + phases).mean(axis=1) * 1.4)

    def attitude(self, t: FloatArray) -> FloatArray:
        """World from body (k, 3, 3)."""
        roll, pitch, yaw = (math.radians(a) * self._wave(k, t) for k, a in enumerate(self.flaws.swing_deg))
        zero = np.zeros_like(roll)
        about = [np.stack(v, axis=1) for v in ((zero, zero, yaw), (zero, pitch, zero), (roll, zero, zero))]
        return exp(about[0]) @ exp(about[1]) @ exp(about[2])

    def position(self, t: FloatArray) -> FloatArray:
        """World position (k, 3), NED about the pad."""
        swing = np.stack([self._wave(3 + k, t) for k in range(3)], axis=1) * self.flaws.swing_m
        return np.asarray(swing + np.array([0.0, 0.0, -1.2]))

    def inertial(self, rate_hz: float = 200.0) -> ImuSamples:
        """What the IMU says."""
        flaws, rng = self.flaws, self.rng
        t = np.arange(-1.0, self.seconds + 1.0, 1.0 / rate_hz)
        attitude = self.attitude(t)
        rate = log(transposed(self.attitude(t - H)) @ self.attitude(t + H)) / (2.0 * H)
        bend = (self.position(t - H) - 2.0 * self.position(t) + self.position(t + H)) / H**2
        bend[:, 2] -= GRAVITY_M_S2
        force = (transposed(attitude) @ bend[..., None])[..., 0]
        gyro = np.eye(3) + flaws.gyro_cross * rng.standard_normal((3, 3))
        accel = np.eye(3) + flaws.accel_cross * rng.standard_normal((3, 3))
        rate = rate @ gyro.T + flaws.gyro_bias_rad_s * rng.standard_normal(3)
        force = force @ accel.T + flaws.accel_bias_m_s2 * rng.standard_normal(3)
        rate += math.radians(0.01) * math.sqrt(rate_hz / 2.0) * rng.standard_normal(rate.shape)
        force += 0.003 * math.sqrt(rate_hz / 2.0) * rng.standard_normal(force.shape)
        return ImuSamples(t, rate, force, np.full(len(t), 30.0))

    def sightings(self, rate_hz: float = 30.0) -> PadObservations:
        """What the camera says, with stamps that are off by `-time_offset_s`."""
        flaws, rng = self.flaws, self.rng
        t = np.arange(0.0, self.seconds, 1.0 / rate_hz)
        attitude, world = self.attitude(t), self.position(t)
        camera_from_world = transposed(attitude @ self.body_from_camera)
        camera = world + attitude @ np.array(flaws.position_m)
        rotation = camera_from_world @ self.pad_in_world
        place = -(camera_from_world @ camera[..., None])[..., 0]
        sd = np.array([0.002, 0.002, 0.004, 0.006, 0.006, 0.002])
        noise = sd * rng.standard_normal((len(t), 6)) * flaws.pixel_noise
        rotation = exp(noise[:, 3:]) @ rotation
        flips = rng.uniform(size=len(t)) < flaws.flipped
        sight = place / np.linalg.norm(place, axis=1, keepdims=True)
        normal = rotation[..., 2]
        # the other pose of a square tilts the other way from the line of sight
        across = np.cross(normal, sight)
        rotation = np.where(flips[:, None, None], exp(2.0 * across) @ rotation, rotation)
        return PadObservations(
            t - flaws.time_offset_s, rotation, place + noise[:, :3], np.tile(np.diag(sd**2), (len(t), 1, 1))
        )

    def rotation_error_rad(self, body_from_camera: FloatArray) -> FloatArray:
        """The error (3,) of a found rotation about the body's axes."""
        return log(body_from_camera @ self.body_from_camera.T)
