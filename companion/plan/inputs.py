"""The inputs of the planner in one cycle."""

from dataclasses import dataclass, field, replace
from typing import Final

from companion.base.messages import (
    ActionResult,
    AutopilotState,
    CarriedPad,
    LinkHealth,
    Order,
    PadBeacon,
    PadState,
    RangeSample,
    SourceComparison,
    VehicleState,
)

LONGEST_CYCLE_S: Final = 0.1  # a cycle that lasts longer counts as one of this


@dataclass(frozen=True, slots=True)
class ComputerLoad:
    """Whether our computer keeps up: why it is too slow to fly by; how long control stood still lately.

    `late_s`: how long it stood still before this cycle. `woke`: this cycle is the first after the machine was
    suspended.
    """

    problem: str | None = None
    held_up_s: float = 0.0
    late_s: float = 0.0
    woke: bool = False


@dataclass(frozen=True, slots=True)
class PlanInputs:
    """The newest of everything the planner goes by; `results` holds each answer once, `order` comes once.

    `carried`: the pad's estimate while it goes on without the camera. `comparisons`: what was measured by
    two sources. `control_failure`: why the last setpoint was a stop. `thrust_doubt`: what stands against
    control by thrust, `setup_problem` against control at all, of the autopilot's parameters. `shortage`: what
    the wind has taken all of in this mission, thrust or tilt.
    """

    vehicle: VehicleState | None
    pad: PadState | None
    autopilot: AutopilotState
    carried: CarriedPad | None = None
    beacon: PadBeacon | None = None
    range: RangeSample | None = None
    results: tuple[ActionResult, ...] = ()
    stop_requested: bool = False
    order: Order | None = None
    camera_problem: str | None = None
    comparisons: tuple[SourceComparison, ...] = ()
    computer: ComputerLoad = ComputerLoad()
    control_failure: str = ""
    shortage: str = ""
    thrust_doubt: str = ""
    setup_problem: str = ""
    link: LinkHealth = field(default_factory=LinkHealth)

    @property
    def unheard(self) -> bool:
        """Whether the autopilot may have flown by itself: the link is silent, or the app sent it nothing."""
        return self.link.silent or replace(self.link, silent_s=self.computer.late_s).silent
