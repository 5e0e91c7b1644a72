"""One flight of Fig. 14: a pilot on the simulator's plant, and what came of it.

The plant is the simulator's airframe (motors that lag, drag, rotor gyroscopics, Runge-Kutta steps), not the
controllers' model. NED, SI; the reference begins at time 0.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.clock import wall_clock_s
from companion.base.geometry import ZERO3, FloatArray
from companion.plan.obstacles.obstacles import clearance_m
from experiments.fig14.pilots import FLOOR_M, PERIOD_S, PILOTS, VEHICLE_RADIUS_M, PilotKnowledge
from experiments.fig14.world import (
    FLOWN_S,
    HOVERS_S,
    START_NED_M,
    SURFACE_HEIGHT_M,
    WIND,
    DisturbanceCase,
    Noise,
    disturbed,
)
from experiments.model.disturbance_filter import DisturbanceFilter
from experiments.model.full_mpc import FullLimits
from experiments.model.quadrotor import ANGLES, POSITION, RATES, STATES, VELOCITY, ThrustMixer, state_from_ned
from sitl.vehicle.quadrotor import Quadrotor, QuadrotorParameters, QuadrotorState
from sitl.world.wind import Wind

SUBSTEPS: Final = 4
LEAD: Final = 0.3  # the mixer's, for every pilot
LOST_M: Final = 20.0  # farther from the reference a flight is over


@dataclass(frozen=True)
class FlownTrack:
    """What was flown, a row a period from time 0: times (n,), states (n, 12) in the paper's axes, errors
    (n, 3) from the reference in NED, rotors' thrust shares (n, 4), and each step's computing time (n,)."""

    times_s: FloatArray
    states: FloatArray
    errors_m: FloatArray
    shares: FloatArray
    step_s: FloatArray
    closest_m: float
    touched: bool
    lost: bool

    @property
    def rmse_m(self) -> float:
        """Root mean square of the distance from the reference."""
        return float(np.sqrt(np.mean(np.sum(self.errors_m**2, axis=1))))

    def used(self, limits: FullLimits) -> dict[str, float]:
        """The share of each bound that was used at worst; of the height, over 1 is the share of the legs'
        length by which they were below the pad."""
        x = self.states
        height_m = float(x[:, POSITION[2]].min()) - SURFACE_HEIGHT_M
        found = {
            "tilt": np.abs(x[:, ANGLES[:2]]).max() / np.radians(limits.tilt_deg),
            "speed": np.abs(x[:, VELOCITY[:2]]).max() / limits.horizontal_speed_m_s,
            "climb": np.abs(x[:, VELOCITY[2]]).max() / limits.vertical_speed_m_s,
            "rate": np.abs(x[:, RATES[:2]]).max() / limits.rate_rad_s,
            "yaw rate": np.abs(x[:, RATES[2]]).max() / limits.yaw_rate_rad_s,
            "height": 1.0 + (FLOOR_M - height_m) / FLOOR_M,
            "thrust": self.shares.max() / limits.most_thrust_share,
        }
        return {name: float(share) for name, share in found.items()}

    def violation(self, limits: FullLimits) -> float:
        """The worst share by which a bound was exceeded."""
        return max(0.0, max(self.used(limits).values()) - 1.0)


def fly(
    pilot_name: str,
    flight: PilotKnowledge,
    parameters: QuadrotorParameters,
    case: DisturbanceCase,
    flown_s: float = FLOWN_S,
) -> FlownTrack:
    """Fly a case; the same seed has the same wind, errors and noise for every pilot."""
    seed = flight.world.seed
    pilot = PILOTS[pilot_name](flight)
    mixer = ThrustMixer(flight.model, PERIOD_S, LEAD)
    observer = DisturbanceFilter(flight.full.push, flight.model, PERIOD_S)
    air = Wind(WIND, np.random.default_rng((seed, 30))) if case.gusts else None
    noise = np.random.default_rng((seed, 40))
    plant = Quadrotor(disturbed(parameters, case, seed))
    hover = parameters.hover_share()
    vehicle = QuadrotorState(START_NED_M, thrust_share=(hover, hover, hover, hover))
    rows: list[tuple[float, FloatArray, FloatArray, tuple[float, ...], float]] = []
    lost = False
    for k in range(round((HOVERS_S + flown_s) / PERIOD_S)):
        time_s = k * PERIOD_S - HOVERS_S
        state = state_from_ned(
            vehicle.position_ned_m, vehicle.velocity_ned_m_s, vehicle.attitude, vehicle.rate_body_rad_s
        )
        error = np.subtract(vehicle.position_ned_m, flight.reference.at(time_s).position_m)
        lost = bool(np.linalg.norm(error) > LOST_M)
        if lost:
            break
        estimated = observer.step(_measured(state, case.noise, noise), mixer.flown)
        began_s = wall_clock_s()
        inputs = pilot.step(estimated, time_s, observer.disturbance)
        spent_s = wall_clock_s() - began_s
        if time_s >= -1e-9:
            rows.append((time_s, state, error, vehicle.thrust_share, spent_s))
        commands = mixer.step(inputs)
        for i in range(SUBSTEPS):
            at_s = HOVERS_S + time_s + i * PERIOD_S / SUBSTEPS
            wind = ZERO3 if air is None else air.at(at_s, -vehicle.position_ned_m[2])
            vehicle = plant.step(vehicle, commands, PERIOD_S / SUBSTEPS, wind_ned_m_s=wind)
    return _track(rows, flight, lost)


def _track(
    rows: list[tuple[float, FloatArray, FloatArray, tuple[float, ...], float]],
    flight: PilotKnowledge,
    lost: bool,
) -> FlownTrack:
    times, states, errors, shares, spent = (np.array(column) for column in zip(*rows, strict=True))
    ned = states[:, POSITION] * [1.0, -1.0, -1.0]
    closest_m = float(clearance_m(ned, flight.world.obstacles).min())
    return FlownTrack(times, states, errors, shares, spent, closest_m, closest_m <= VEHICLE_RADIUS_M, lost)


def _measured(state: FloatArray, noise: Noise, rng: np.random.Generator) -> FloatArray:
    """The state with Gaussian noise; it is drawn in any case, so that cases differ in nothing else."""
    drawn = rng.standard_normal(STATES)
    std = np.empty(STATES)
    std[POSITION], std[VELOCITY] = noise.position_m, noise.velocity_m_s
    std[ANGLES], std[RATES] = noise.angle_rad, noise.rate_rad_s
    measured: FloatArray = state + std * drawn
    return measured
