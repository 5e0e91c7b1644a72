"""What the control stage gives: the setpoint, and how it came about."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from companion.base.geometry import ZERO3, FloatArray, Quaternion, Vector3


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What leaves for the autopilot, in our NED; the link turns it into the autopilot's heading.

    `attitude` and `thrust` (0..1 of the autopilot's scale) are set in attitude mode only. Unless
    `holds_horizontal_velocity`, the horizontal velocity is for the log alone and is not sent.
    """

    time_s: float
    velocity_ned_m_s: Vector3 = ZERO3
    acceleration_ned_m_s2: Vector3 = ZERO3
    heading_rad: float = 0.0
    heading_rate_rad_s: float = 0.0
    attitude: Quaternion | None = None
    thrust: float | None = None
    exposure_time_s: float | None = None
    holds_horizontal_velocity: bool = True


# a wind that takes more than the bounds allow is a gust, or it carries the vehicle away
LONGEST_CUT_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class ControlReport:
    """How a setpoint came about: for the log and the status line.

    Not `solved`: the last plan was flown on; `late`: the clock ended the search; `stopped`: for want of a
    plan the vehicle was commanded to stand still. `hover_thrust` is the share of full thrust that carries the
    weight, as learnt by then; while not `obeyed`, the autopilot receives setpoints without following them.
    `blind`: for want of IMU samples it flew on by its last motion or the pad's. `cut_s`: for how long in a
    row what was flown is the optimum without constraints, cut to the inputs' bounds. `cycle_late_s` is how
    much later than due the cycle began: the event loop's delay. `fault`: why it was stopped, where that is
    not for want of a plan.
    """

    time_s: float
    solved: bool
    iterations: int
    solve_s: float
    limited: tuple[str, ...] = ()
    disturbance_ned_m_s2: Vector3 = ZERO3
    predicted_position_m: FloatArray = field(
        default_factory=lambda: np.zeros((0, 3)), metadata={"columns": 3}
    )
    late: bool = False
    stopped: bool = False
    hover_thrust: float | None = None
    obeyed: bool = True
    blind: bool = False
    cycle_late_s: float = 0.0
    cut_s: float = 0.0
    fault: str = ""

    @property
    def failure(self) -> str:
        """Why no plan was flown (a stop, what the last gate made of no number, cut ones for long), or ""."""
        failed = self.stopped or "not_finite" in self.limited or self.cut_s >= LONGEST_CUT_S
        return self.fault or ("the controller finds no plan to fly" if failed else "")
