"""A world for hand motion: the vehicle is carried over the pad, its rotors stand still.

The same truth as `sitl.world.world` for sensors, camera and autopilot, from a path instead of from forces.
Position, velocity, attitude and rate are those of the path; specific force and angular acceleration are the
means over a step, as those of a flight are: Δv/Δt less gravity in body axes half-way, and Δω/Δt.
NED, FRD, SI.
"""

import math
from typing import Final

import numpy as np

from companion.base.geometry import Vector3, add, quat_from_euler, rotate_yaw
from sitl.scenario.scenario import Scenario
from sitl.vehicle.hand_motion import HandMotion
from sitl.vehicle.hand_paths import CarriedMotion, PoseAndRate, added, carrying
from sitl.vehicle.quadrotor import QuadrotorState, packed
from sitl.vehicle.rotors import RotorValues
from sitl.world.world import Effects, World

HAND_STREAM: Final = 14  # of the random draws; the world has its own
# the state at time 0 is that after a step
FIRST_STEP_S: Final = 0.0025


class HandHeldWorld(World):
    """A scenario's world under one seed, with the vehicle carried by hand from time 0 on.

    The person stays where the pad is at that time, with a random heading. Motor commands have no effect.
    With `waits`, finite motions stay at their start until `begin`.
    """

    def __init__(self, scenario: Scenario, seed: int, motion: HandMotion, *, waits: bool = False) -> None:
        """Build it.

        Raises:
            ConfigError: the scenario names an airframe or a pad that cannot be read.
        """
        super().__init__(scenario, seed)
        rng = np.random.default_rng((seed, HAND_STREAM))
        self._carrying: CarriedMotion = carrying(motion, self.landed_reference_height_m, rng)
        self._begun_s = math.inf if waits and math.isfinite(self._carrying.round_s) else 0.0
        self._origin_ned_m = self.pad_state.position_ned_m
        self._heading_rad = float(rng.uniform(-math.pi, math.pi))
        self.place(self._felt(self._carried(-FIRST_STEP_S), 0.0, FIRST_STEP_S))

    def begin(self) -> None:
        """Start a waiting motion, or restart one that has ended."""
        if self._begun_s == math.inf or self.time_s > self._begun_s + self._carrying.round_s:
            self._begun_s = self.time_s

    def step(self, motor_commands: RotorValues, dt_s: float) -> None:
        """Carry everything on by dt (s)."""
        self._wind_blows(Effects(()), dt_s)
        self._advance(self._felt(self._state, self.time_s + dt_s, dt_s), dt_s)

    def _felt(self, before: QuadrotorState, time_s: float, dt_s: float) -> QuadrotorState:
        """The state at a time, with the mean accelerations since the one dt before."""
        now = self._carried(time_s)
        moving = now.velocity_ned_m_s + now.attitude + now.rate_body_rad_s
        return packed(before, now.position_ned_m, moving, now.thrust_share, dt_s)

    def _carried(self, time_s: float) -> QuadrotorState:
        """The state of the path at a time."""
        (forward, right, down, roll, pitch, yaw), rate = self._held(time_s)
        offset = rotate_yaw((forward, right, down), self._heading_rad)
        return QuadrotorState(
            position_ned_m=add(self._origin_ned_m, offset),
            velocity_ned_m_s=rotate_yaw(rate[:3], self._heading_rad),
            attitude=quat_from_euler(roll, pitch, self._heading_rad + yaw),
            rate_body_rad_s=body_rate(roll, pitch, rate[3:]),
        )

    def _held(self, time_s: float) -> PoseAndRate:
        """Pose and rates relative to the middle of the pad; tremor included also while waiting."""
        moves = self._carrying.moves(time_s - self._begun_s)
        return added(moves, self._carrying.shake(time_s))


def body_rate(roll_rad: float, pitch_rad: float, euler_rate_rad_s: Vector3) -> Vector3:
    """The body's rate (FRD) from the rates of roll, pitch and yaw; right at every pitch."""
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    roll, pitch, yaw = euler_rate_rad_s
    return (roll - sp * yaw, cr * pitch + sr * cp * yaw, cr * cp * yaw - sr * pitch)
