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
    VehicleState,
)


@dataclass(frozen=True, slots=True)
class ComputerLoad:
    """Whether our computer keeps up: why it is too slow to fly by; how long control stood still lately."""

    problem: str | None = None
    held_up_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PlanInputs:
    """The newest of everything the planner goes by; `results` holds each answer once, `order` comes once.

    `silent_s`: since anything was last heard of the autopilot, seen by an app that runs.
    `camera_turned_rad`: against the vehicle's file, as far as the pad's motion shows it.
    `leg_problem`: the leg height is not what was measured standing.
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
    camera_turned_rad: float | None = None
    leg_problem: str | None = None
    computer: ComputerLoad = ComputerLoad()
    control_failed: bool = False
    silent_s: float = 0.0
