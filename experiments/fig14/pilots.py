"""Who flies Fig. 14: MPC, the paper's recursion, and PID, all from the same estimated state and reference.

They get the reference in NED and give U1..U4. MPC and recursion see the plan over their horizon, as the
paper has it; PID gets its position, velocity and acceleration now. The recursion has the MPC's weights and
model and no estimate of the disturbance, as in the paper; "riccati + push" has that too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from companion.base.geometry import FloatArray
from companion.base.motion import Motion
from companion.plan.obstacles.obstacles import Obstacle, clearance_m
from experiments.fig14.world import SURFACE_HEIGHT_M, LandingScene, PlannedReference
from experiments.model.disturbance_filter import NO_DISTURBANCE, HorizonReference
from experiments.model.full_mpc import FullMpc, FullMpcConfig, FullRiccatiTracker, ObstacleBounds
from experiments.model.pid import CascadedPid, CascadeGains
from experiments.model.quadrotor import QuadrotorModel, flipped

PERIOD_S: Final = 0.02
VEHICLE_RADIUS_M: Final = 0.38  # arm and propeller: nearer than this the vehicle touches
KEPT_CLEAR_M: Final = 0.55  # what the MPC keeps from an obstacle
PLANES: Final = 2  # the nearest obstacles, as half-spaces
AHEAD_M: Final = 1e-3
NEAR_M: Final = 3.0  # an obstacle farther from the whole horizon binds nothing
FLOOR_M: Final = 0.2  # legs over the pad
FLIP: Final = np.array([1.0, -1.0, -1.0])


class Pilot(Protocol):
    """A controller of the comparison."""

    def step(self, state: FloatArray, time_s: float, disturbance: FloatArray) -> FloatArray:
        """U (4,) from the estimated state (12,) and disturbance (6,)."""


@dataclass(frozen=True)
class PilotKnowledge:
    """What a pilot may know: the model, the settings, the reference, surveyed obstacles."""

    model: QuadrotorModel
    full: FullMpcConfig
    gains: CascadeGains
    world: LandingScene
    reference: PlannedReference


class PidPilot:
    """The cascade, with velocity and acceleration of the reference fed forward."""

    def __init__(self, flight: PilotKnowledge) -> None:
        self._reference = flight.reference
        self._pid = CascadedPid(flight.gains, flight.model, math.radians(flight.full.limits.tilt_deg))

    def step(self, state: FloatArray, time_s: float, disturbance: FloatArray) -> FloatArray:
        """U (4,)."""
        now = self._reference.at(time_s)
        target = Motion(flipped(now.position_m), flipped(now.velocity_m_s), flipped(now.acceleration_m_s2))
        return self._pid.step(state, target, 0.0, PERIOD_S)


class RiccatiPilot:
    """The paper's recursion."""

    def __init__(self, flight: PilotKnowledge, *, with_disturbance: bool = False) -> None:
        self._flight = flight
        self._tracker = FullRiccatiTracker(flight.full, flight.model)
        self._with_disturbance = with_disturbance

    def step(self, state: FloatArray, time_s: float, disturbance: FloatArray) -> FloatArray:
        """U (4,)."""
        rows = rows_of(self._flight, time_s)
        return self._tracker.solve(
            state, rows, disturbance if self._with_disturbance else NO_DISTURBANCE
        ).first


class MpcPilot:
    """The constrained MPC with its estimate of the disturbance."""

    def __init__(self, flight: PilotKnowledge) -> None:
        self._flight = flight
        self._mpc = FullMpc(flight.full, flight.model, PLANES)
        self.unsolved = 0

    def step(self, state: FloatArray, time_s: float, disturbance: FloatArray) -> FloatArray:
        """U (4,)."""
        rows = rows_of(self._flight, time_s)
        found = self._mpc.solve(state, rows, surroundings(rows, self._flight.world.obstacles), disturbance)
        self.unsolved += not found.solved
        return found.first


PILOTS: Final[dict[str, Callable[[PilotKnowledge], Pilot]]] = {
    "mpc": MpcPilot,
    "riccati": RiccatiPilot,
    "riccati + push": lambda flight: RiccatiPilot(flight, with_disturbance=True),
    "pid": PidPilot,
}


def rows_of(flight: PilotKnowledge, time_s: float) -> HorizonReference:
    """The reference over the horizon in the paper's axes."""
    count, step_s = flight.full.steps + 1, flight.full.step_s
    position, velocity, acceleration = flight.reference.rows(time_s, count, step_s)
    if time_s < 0.0:
        position, velocity, acceleration = _waiting(flight.reference, time_s, count, step_s)
    return HorizonReference(position * FLIP, velocity * FLIP, acceleration * FLIP)


def _waiting(
    reference: PlannedReference, time_s: float, count: int, step_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """At rest until time 0, then off."""
    motions = [reference.at(time_s + k * step_s) for k in range(count)]
    return (
        np.array([m.position_m for m in motions]),
        np.array([m.velocity_m_s for m in motions]),
        np.array([m.acceleration_m_s2 for m in motions]),
    )


def surroundings(rows: HorizonReference, obstacles: tuple[Obstacle, ...]) -> ObstacleBounds:
    """The pad's height as a floor, and of each row's nearest obstacles the half-space on its side."""
    points = rows.position_m[1:]
    floor_m = np.full(len(points), SURFACE_HEIGHT_M + FLOOR_M)
    normals, offsets_m = np.zeros((len(points), PLANES, 3)), np.full((len(points), PLANES), -1e4)
    if not obstacles:
        return ObstacleBounds(floor_m, normals, offsets_m)
    ned = points * FLIP
    away = np.stack([clearance_m(ned, (one,)) for one in obstacles], axis=1)
    order = np.argsort(away, axis=1, kind="stable")[:, :PLANES]
    for k, one in enumerate(obstacles):
        if away[:, k].min() > NEAR_M:
            continue
        away_from = outward(ned, one) * FLIP
        offset_m = np.einsum("ki,ki->k", away_from, points) - away[:, k] + KEPT_CLEAR_M
        steps, places = np.nonzero(order == k)
        normals[steps, places], offsets_m[steps, places] = away_from[steps], offset_m[steps]
    return ObstacleBounds(floor_m, normals, offsets_m)


def outward(points_ned_m: FloatArray, obstacle: Obstacle) -> FloatArray:
    """Unit vectors (n, 3) along which the distance to an obstacle grows, by central differences."""
    aside = AHEAD_M * np.vstack([np.eye(3), -np.eye(3)])
    around = (points_ned_m[None] + aside[:, None]).reshape(-1, 3)
    ahead, behind = clearance_m(around, (obstacle,)).reshape(2, 3, -1)
    slopes = (ahead - behind).T
    unit: FloatArray = slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-9)
    return unit
