"""Orders to a companion that stands by: who asks for what, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class OrderKind(StrEnum):
    """What may be asked for."""

    LAND = "land"  # take over where the vehicle flies, find the pad, land, disarm
    FLY = "fly"  # the whole flight: arm, take off, waypoint, land
    STOP = "stop"  # return control to the autopilot, which holds its position


class OrderOutcome(StrEnum):
    """The words of MAVLink's MAV_RESULT."""

    IN_PROGRESS = "in_progress"
    ACCEPTED = "accepted"  # carried out
    TEMPORARILY_REJECTED = "temporarily_rejected"  # not now
    DENIED = "denied"  # not with these settings
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class Order:
    """One order; `source` says in words where it came from."""

    time_s: float
    kind: OrderKind
    source: str


@dataclass(frozen=True, slots=True)
class OrderReply:
    """What became of an order: first refused or in progress, later how it ended."""

    time_s: float
    kind: OrderKind
    source: str
    outcome: OrderOutcome
    text: str = ""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why an order is not carried out; `lasting`: the settings forbid it, not the moment."""

    text: str
    lasting: bool = False
