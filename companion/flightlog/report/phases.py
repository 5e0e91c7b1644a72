"""The phases of a flight as spans of time, and their colours."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from companion.base.messages import Phase, PlanStep

# by kind: on the ground, on the way, looking, closing in, down; what goes wrong is warm
PHASE_COLOURS: Final = {
    Phase.STANDBY: "#95a5a6",
    Phase.CONNECT: "#b2babb",
    Phase.ARM: "#7f8c8d",
    Phase.TAKE_OFF: "#5d6d7e",
    Phase.WAYPOINT: "#aeb6bf",
    Phase.ROUTE: "#85929e",
    Phase.SEARCH: "#f4d03f",
    Phase.APPROACH: "#5dade2",
    Phase.DESCEND: "#58d68d",
    Phase.TOUCHDOWN: "#1e8449",
    Phase.LANDED: "#a569bd",
    Phase.HOLD: "#eb984e",
    Phase.ABORT: "#e74c3c",
}


@dataclass(frozen=True, slots=True)
class PhaseSpan:
    """One stay in a phase; times (s) of the messages it was made from."""

    phase: Phase
    start_s: float
    end_s: float

    @property
    def name(self) -> str:
        return self.phase.value.replace("_", " ")

    @property
    def colour(self) -> str:
        return PHASE_COLOURS[self.phase]


def phase_spans(plans: Sequence[PlanStep]) -> list[PhaseSpan]:
    """The stays in their order; one lasts until the next begins, the last until the last plan."""
    starts = [(Phase(phase), next(steps).time_s) for phase, steps in groupby(plans, lambda p: p.phase)]
    ends = [start_s for _, start_s in starts[1:]] + [plan.time_s for plan in plans[-1:]]
    return [PhaseSpan(phase, start_s, end_s) for (phase, start_s), end_s in zip(starts, ends, strict=True)]
