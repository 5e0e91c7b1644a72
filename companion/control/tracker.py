"""The interface of all trackers, which follow a reference, and the choice among them.

`control.controller` chooses: `mpc` (OSQP, with constraints), `riccati` (the paper's recursion on the same
model and weights, without constraints) or `pid`. All get the same start, target and period, and their
answers pass the same limits gate. Frame: as the MPC's, NED axes that do not accelerate; SI units.
"""

from collections.abc import Callable
from typing import Protocol

from companion.base.geometry import Vector3
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.baselines.pid_tracker import PidTracker
from companion.control.baselines.riccati_tracker import RiccatiTracker
from companion.control.mpc.mpc import Mpc
from companion.control.tracking import Target, TrackingSolution


class Tracker(Protocol):
    """The next accelerations to command, from where the vehicle is and should be."""

    def solve(
        self, start: Motion, target: Target, disturbance_m_s2: Vector3, last_input_m_s2: Vector3
    ) -> TrackingSolution:
        """Inputs over the horizon from `start`, of which the first is flown."""

    def reset(self) -> None:
        """Forget everything learnt or kept: the next call begins a flight."""


def make_tracker(
    config: ControlConfig, lags_s: Vector3, stopwatch: Callable[[], float] | None = None
) -> Tracker:
    """The tracker that the settings choose, for a vehicle with these lags (s, see `flight_model.lags`).

    `stopwatch` gives seconds: the MPC's search ends at `control.solve_limit_s` by it.
    """
    if config.controller == "mpc":
        return Mpc(config, lags_s, stopwatch)
    if config.controller == "riccati":
        return RiccatiTracker(config, lags_s)
    return PidTracker(config, lags_s)
