"""The planner's inputs of a cycle."""

from __future__ import annotations

from dataclasses import dataclass

from companion.base.messages import (
    ActionResult,
    AutopilotState,
    Order,
    PadBeacon,
    PadState,
    RangeSample,
    SourceComparison,
    VehicleState,
)


@dataclass(frozen=True, slots=True)
class PlanInputs:
    """The newest of everything the planner goes by; `results` holds each answer once, `order` comes once.

    `silent_s`: since anything was last heard of the autopilot, seen by an app that runs.
    `comparisons`: what was measured by two sources.
    `control_failed`: the last setpoint was a stop for want of a plan, or would have been no number.
    """

    vehicle: VehicleState | None
    pad: PadState | None
    autopilot: AutopilotState
    beacon: PadBeacon | None = None
    range: RangeSample | None = None
    results: tuple[ActionResult, ...] = ()
    stop_requested: bool = False
    order: Order | None = None
    camera_problem: str | None = None
    comparisons: tuple[SourceComparison, ...] = ()
    control_failed: bool = False
    silent_s: float = 0.0
