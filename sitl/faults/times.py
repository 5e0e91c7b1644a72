"""When a fault begins and how long it lasts.

It begins at a time, when the app announces a phase, at a height over the pad, or after the app's first
sighting of the pad. The simulator hears the phase and the sighting from outside, by the app's STATUSTEXT.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from companion.config import StrictModel

FlownPhase = Literal[
    "arm", "take off", "waypoint", "route", "search", "approach", "descend", "touchdown", "hold", "abort"
]
Since = Annotated[float, Field(ge=0.0, le=900.0)]
Low = Annotated[float, Field(ge=0.0, le=50.0)]


class FaultTimes(StrictModel):
    """When a fault is there: one of the four beginnings, and a duration."""

    start_s: Since | None = Field(
        default=None, description="It begins this long after the start of the simulation"
    )
    phase: FlownPhase | None = Field(
        default=None, description="It begins when the app first announces this phase"
    )
    below_m: Low | None = Field(
        default=None,
        description="It begins when the feet, over the pad, first come this low in flight; 0: they touch",
    )
    after_sighting_s: Since | None = Field(
        default=None, description="It begins this long after the first sighting"
    )
    delay_s: float = Field(default=0.0, ge=0.0, le=900.0, description="Further delay after that")
    duration_s: float = Field(
        default=900.0, gt=0.0, le=900.0, description="Duration; by default to the end of the flight"
    )

    @model_validator(mode="after")
    def _begins_once(self) -> FaultTimes:
        ways = (self.start_s, self.phase, self.below_m, self.after_sighting_s)
        if sum(way is not None for way in ways) != 1:
            raise ValueError("expected one of start_s, phase, below_m and after_sighting_s")
        return self

    @property
    def lasts_s(self) -> float:
        """How long it is there."""
        return self.duration_s
