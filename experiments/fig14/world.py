"""The world of Fig. 14 by seed: a moving pad, obstacles before it, and what disturbs whom.

NED, SI. The pad and the wind are the simulator's; obstacles are drawn again until the pad's way and the start
are clear of them and there is something to go round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import Vector3
from companion.config import Box, Cylinder
from companion.plan.obstacles.obstacles import Obstacle, clearance_m, line_clear
from sitl.pad.driven_paths import RandomTurnsMotion
from sitl.pad.motion import PadMotion, build_pad_motion
from sitl.pad.paths import Meeting
from sitl.vehicle.quadrotor import QuadrotorParameters
from sitl.world.wind import GustSettings, WindSettings

START_NED_M: Final[Vector3] = (0.0, 0.0, -6.0)
HOVERS_S: Final = 2.0  # before the reference begins, so that integrals and estimates settle; not scored
FLOWN_S: Final = 18.0
SURFACE_HEIGHT_M: Final = 0.3
OBSTACLES: Final = 3
PAD_CLEAR_M: Final = 2.2
START_CLEAR_M: Final = 2.0
BETWEEN_M: Final = 2.6  # two obstacles leave a gate as wide or none
TRIES: Final = 500
PAD: Final = RandomTurnsMotion(
    kind="random_turns",
    speed_m_s=1.2,
    slowest_m_s=0.6,
    max_turn_rate_deg_s=15.0,
    max_acceleration_m_s2=0.6,
    radius_m=30.0,
    meet=Meeting(point_ned_m=(14.0, 0.0), time_s=9.0, spread_m=2.0),
)
WIND: Final = WindSettings(
    mean_m_s=3.0,
    turbulence="moderate",
    gusts=GustSettings(amplitude_m_s=6.0, duration_s=2.0, interval_s=3.0),
)
MODEL_ERROR: Final = 0.2


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the measured state."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0
    angle_rad: float = 0.0
    rate_rad_s: float = 0.0


@dataclass(frozen=True)
class DisturbanceCase:
    """What a flight is disturbed by."""

    name: str
    gusts: bool = False
    model_error: bool = False
    noise: Noise = Noise()


NOISY: Final = Noise(0.02, 0.04, math.radians(0.5), 0.03)
CASES: Final = (
    DisturbanceCase("nominal"),
    DisturbanceCase("gust", gusts=True),
    DisturbanceCase("mass, inertia", model_error=True),
    DisturbanceCase("noise", noise=NOISY),
    DisturbanceCase("all", gusts=True, model_error=True, noise=NOISY),
)


@dataclass(frozen=True)
class LandingScene:
    """One seed: where the pad goes and what stands in the way."""

    seed: int
    pad: PadMotion
    obstacles: tuple[Obstacle, ...]


def draw_world(seed: int, attempt: int = 0) -> LandingScene:
    """The pad's motion and the obstacles of a seed; another attempt is another draw.

    Raises:
        RuntimeError: nothing was found that can be flown round.
    """
    rng = np.random.default_rng((seed, 14, attempt))
    for _ in range(TRIES):
        pad = build_pad_motion(PAD, SURFACE_HEIGHT_M, "along", rng)
        obstacles = _drawn_obstacles(rng)
        if _flyable(pad, obstacles):
            return LandingScene(seed, pad, obstacles)
    raise RuntimeError(f"seed {seed}: no obstacles fit between the start and the pad's way")


def _drawn_obstacles(rng: np.random.Generator) -> tuple[Obstacle, ...]:
    found = []
    for k in range(OBSTACLES):
        place = (float(rng.uniform(3.0, 10.0)), float(rng.uniform(-4.0, 4.0)))
        if k == OBSTACLES - 1:
            length, heading = float(rng.uniform(1.0, 2.5)), float(rng.uniform(-90.0, 90.0))
            box = Box(
                kind="box",
                centre_ned_m=place,
                length_m=length,
                width_m=0.6,
                heading_deg=heading,
                height_m=9.0,
            )
            found.append(Obstacle.of(box))
        else:
            radius = float(rng.uniform(0.3, 0.8))
            found.append(
                Obstacle.of(Cylinder(kind="cylinder", centre_ned_m=place, radius_m=radius, height_m=9.0))
            )
    return tuple(found)


def _flyable(pad: PadMotion, obstacles: tuple[Obstacle, ...]) -> bool:
    """Clear of the pad's way and of the start, with room between them, and in the straight way."""
    way = np.array([pad.at(t).position_ned_m for t in np.arange(0.0, FLOWN_S + 1.0, 0.25)])
    if clearance_m(way, obstacles).min() < PAD_CLEAR_M:
        return False
    if clearance_m(np.array([START_NED_M]), obstacles)[0] < START_CLEAR_M:
        return False
    for k, one in enumerate(obstacles):
        middle = np.array([[one.north_m, one.east_m, -1.0]])
        others = obstacles[:k] + obstacles[k + 1 :]
        if clearance_m(middle, others)[0] < BETWEEN_M + max(one.round_m, one.half_length_m):
            return False
    return not line_clear(START_NED_M, pad.at(PAD.meet.time_s).position_ned_m, obstacles, 0.3)


def disturbed(parameters: QuadrotorParameters, case: DisturbanceCase, seed: int) -> QuadrotorParameters:
    """The airframe that flies: mass and moments of inertia each off by up to a fifth, if the case says so."""
    rng = np.random.default_rng((seed, 20))
    mass, *inertia = (1.0 + rng.uniform(-MODEL_ERROR, MODEL_ERROR, 4)).tolist()
    if not case.model_error:
        return parameters
    x, y, z = (share * value for share, value in zip(inertia, parameters.inertia_kg_m2, strict=True))
    return parameters.model_copy(update={"mass_kg": mass * parameters.mass_kg, "inertia_kg_m2": (x, y, z)})
