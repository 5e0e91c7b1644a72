"""The steps of the check over the pad, as data, and the words for the person."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from companion.base.geometry import Vector3

Kind = Literal["lift", "shift", "turn"]
SayKind = Literal["order", "good", "bad", "note"]


@dataclass(frozen=True, slots=True)
class RequestedMove:
    """A move that is asked for: along (or about, for a turn) `axis`, in the vehicle's own axes, FRD."""

    name: str
    kind: Kind
    axis: Vector3
    order: str


STEPS: Final = (
    RequestedMove(
        "up is up", "lift", (0.0, 0.0, -1.0), "Raise it straight up by half a metre and hold it still"
    ),
    RequestedMove(
        "right is right", "shift", (0.0, 1.0, 0.0), "Move it to its right by 20 cm and hold it still"
    ),
    RequestedMove(
        "forward is forward", "shift", (1.0, 0.0, 0.0), "Move it forward by 20 cm and hold it still"
    ),
    RequestedMove(
        "turn right", "turn", (0.0, 0.0, 1.0), "Turn its nose to the right by 45° and hold it still"
    ),
    RequestedMove("roll right", "turn", (1.0, 0.0, 0.0), "Roll it to the right by 15° and hold it still"),
    RequestedMove("nose up", "turn", (0.0, 1.0, 0.0), "Raise its nose by 15° and hold it still"),
)
START_ORDER: Final = "Hold it level and still, half a metre over the middle of the pad"
BACK_ORDER: Final = "Bring it back, level over the middle of the pad, and hold it still"


@dataclass(frozen=True, slots=True)
class Say:
    """Something for the person: an order, a good or a bad answer, or a note."""

    text: str
    kind: SayKind = "note"
