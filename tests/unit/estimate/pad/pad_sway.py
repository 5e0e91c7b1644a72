"""A vehicle that sways over a pad, and what its camera sees: for what is learnt of sightings in flight."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    add,
    quat_from_euler,
    quat_rotate,
    quat_rotate_inverse,
    scale,
    subtract,
)
from companion.estimate.motion import MotionHistory

IMU_S = 0.005
FRAME_S = 1.0 / 30.0
LATENCY_S = 0.1


@dataclass(frozen=True)
class Sway:
    """A vehicle that rolls and pitches under its own thrust over a pad that drives, seen `late_s` late."""

    late_s: float
    height_m: float = 3.0
    roll_rad: float = 0.06
    noise_m: float = 0.005
    pad_speed_m_s: float = 1.0
    pad_acceleration_m_s2: float = 0.0
    imu_m: Vector3 = (0.0, 0.0, 0.0)  # the IMU's place from where its file says, body
    swing_rad_s: float = 6.0

    def attitude(self, time_s: float) -> Quaternion:
        phase_rad = self.swing_rad_s * time_s
        roll, pitch = math.sin(phase_rad), 0.5 * math.sin(8.0 / 6.0 * phase_rad)
        return quat_from_euler(self.roll_rad * roll, self.roll_rad * pitch, 0.3)

    def acceleration(self, time_s: float) -> Vector3:
        x, y, z = quat_rotate(self.attitude(time_s), (0.0, 0.0, -GRAVITY_M_S2))
        return (x, y, z + GRAVITY_M_S2)

    def felt(self, time_s: float) -> Vector3:
        """Acceleration of the IMU, which swings about the centre of mass."""
        step_s = 1e-3
        before, here, after = (
            quat_rotate(self.attitude(time_s + k * step_s), self.imu_m) for k in (-1.0, 0.0, 1.0)
        )
        swing = subtract(add(before, after), scale(here, 2.0))
        return add(self.acceleration(time_s), scale(swing, 1.0 / step_s**2))

    def pad(self, time_s: float) -> Vector3:
        return (self.pad_speed_m_s * time_s + 0.5 * self.pad_acceleration_m_s2 * time_s**2, 0.0, 0.0)


def sightings(
    sway: Sway, motion: MotionHistory, duration_s: float, frame_s: float = FRAME_S
) -> Iterator[tuple[float, Vector3]]:
    """Stamps and the pad in body axes, as the frames come; `motion` is fed meanwhile."""
    rng = np.random.default_rng(7)
    position = np.array([0.0, 0.0, -sway.height_m])
    velocity = np.zeros(3)
    places: list[Vector3] = []
    exposed_s = 0.1
    for k in range(round(duration_s / IMU_S)):
        now_s = k * IMU_S
        motion.add(now_s, sway.attitude(now_s), sway.felt(now_s))
        places.append((float(position[0]), float(position[1]), float(position[2])))
        acceleration = np.array(sway.acceleration(now_s))
        position = position + velocity * IMU_S + 0.5 * acceleration * IMU_S**2
        velocity = velocity + acceleration * IMU_S
        if now_s >= exposed_s + LATENCY_S:
            truly = round((exposed_s + sway.late_s) / IMU_S)
            relative = subtract(sway.pad(truly * IMU_S), places[truly])
            seen = np.array(quat_rotate_inverse(sway.attitude(truly * IMU_S), relative))
            x, y, z = (seen + sway.noise_m * rng.standard_normal(3)).tolist()
            yield exposed_s, (x, y, z)
            exposed_s += frame_s
