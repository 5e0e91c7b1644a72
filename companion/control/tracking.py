"""The input and output of a tracker: the target over the horizon, and the inputs that follow it.

Frame: NED axes, at rest or in straight unaccelerated motion. SI units.
"""

from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from companion.base.geometry import FloatArray, Vector3


@dataclass(frozen=True)
class Cone:
    """Where a descent may be: at most `radius_m` + `slope` * height aside of the axis, upright.

    `apex_m` (N+1, 3) are the points on the axis from which the height counts, at 0, dt, .. N dt.
    """

    slope: float
    radius_m: float
    apex_m: FloatArray


@dataclass(frozen=True)
class Target:
    """What to track: rows 0..N hold at 0, dt, .. N dt from the start.

    `floor_down_m` (N+1,) is the greatest allowed position along down, or None. The first row is near the
    vehicle (see `target.within_reach`): the costs are quadratic, the bounds on speed, height and cone soft.
    `horizontal_bound_m_s2` (N,) bounds the horizontal input over each step further, as far as the jerk
    allows, or is None. `hover_thrust` is the share of full thrust that carries the weight, as known by now;
    None: as it was at the start.
    """

    position_m: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray
    floor_down_m: FloatArray | None = None
    cone: Cone | None = None
    hover_thrust: float | None = None
    horizontal_bound_m_s2: FloatArray | None = None


class SolveOutcome(Enum):
    """What a tracker's answer is."""

    SOLVED = auto()
    CUT = auto()  # the optimum without constraints, cut to the inputs' bounds
    KEPT = auto()  # the last answer, moved on


@dataclass(frozen=True)
class TrackingSolution:
    """Inputs (N, 3) in m/s2 and the predicted states (N, 9), and what they are.

    `late`: the stopwatch ended the search. `short_of`: what there is too little of for the place ("thrust",
    "tilt"), where the first input is at its bound sideways.
    """

    inputs_m_s2: FloatArray
    states: FloatArray
    outcome: SolveOutcome = SolveOutcome.SOLVED
    iterations: int = 0
    late: bool = False
    short_of: str = ""

    @property
    def solved(self) -> bool:
        """Whether it is the optimum, or near enough."""
        return self.outcome is SolveOutcome.SOLVED


def needed_inputs(target: Target, disturbance_m_s2: Vector3, lags_s: Vector3, step_s: float) -> FloatArray:
    """Inputs (N, 3) under which the model flies the target's acceleration against the disturbance."""
    a = target.acceleration_m_s2
    slope = (a[1:] - a[:-1]) / step_s
    needed: FloatArray = 0.5 * (a[:-1] + a[1:]) + np.array(lags_s) * slope - np.array(disturbance_m_s2)
    return needed
