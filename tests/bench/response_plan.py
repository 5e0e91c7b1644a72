"""What an autopilot is sent to learn how it answers: doublets, steps and sines of each kind of setpoint.

A `Group` is one kind of setpoint along one axis; its runs follow each other, each from a stop. The signal is
the lean (rad), the acceleration (m/s2), the velocity (m/s) or the heading (rad) that is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from companion.messages import Manner

Kind = Literal["roll", "pitch", "acceleration", "both", "velocity", "climb", "yaw"]
Signal = Callable[[float], float]

FREQUENCIES_HZ: Final = (0.3, 0.5, 0.8, 1.2)
SETTLE_S: Final = 4.0
# before a sine's answer is measured: its transient
LEAD_S: Final = 2.5
MEASURED_CYCLES: Final = 5


@dataclass(frozen=True)
class Run:
    """One signal over `duration_s`, with its rate and its integral; a sine has a frequency, a doublet none."""

    duration_s: float
    signal: Signal
    rate: Signal
    integral: Signal
    frequency_hz: float | None = None


@dataclass(frozen=True)
class Group:
    """The runs of one kind of setpoint.

    Both: velocity and acceleration together, the one being the integral of the other.
    """

    name: str
    kind: Kind
    runs: tuple[Run, ...]


def sine(frequency_hz: float, size: float) -> Run:
    """A cosine, whose integral swings about zero."""
    w = 2.0 * math.pi * frequency_hz
    lead_s = math.ceil(LEAD_S * frequency_hz) / frequency_hz
    return Run(
        lead_s + MEASURED_CYCLES / frequency_hz,
        lambda t: size * math.cos(w * t),
        lambda t: -size * w * math.sin(w * t),
        lambda t: size / w * math.sin(w * t),
        frequency_hz,
    )


def doublet(size: float, hold_s: float, rest_s: float) -> Run:
    """Up, down for as long, and none."""

    def integral(t: float) -> float:
        return size * max(0.0, hold_s - abs(t - hold_s))

    return Run(
        2.0 * hold_s + rest_s,
        lambda t: size if t < hold_s else -size if t < 2.0 * hold_s else 0.0,
        lambda _t: 0.0,
        integral,
    )


def step(size: float, hold_s: float) -> Run:
    """There and back."""
    return Run(
        2.0 * hold_s,
        lambda t: size if t < hold_s else 0.0,
        lambda _t: 0.0,
        lambda t: size * min(t, hold_s),
    )


def sines(size: float) -> tuple[Run, ...]:
    """One at each frequency."""
    return tuple(sine(frequency, size) for frequency in FREQUENCIES_HZ)


def groups(manner: Manner) -> tuple[Group, ...]:
    """All that one autopilot is flown by: what the app may send it, and velocities alone."""
    lean, swing, turn = math.radians(8.0), math.radians(6.0), math.radians(30.0)
    leaning = (doublet(lean, 1.0, 1.0), *sines(swing))
    pushed = (doublet(0.6, 1.5, 1.5), *sines(0.6))
    # 8 degrees, which is 7 m/s3 at 0.8 Hz: beyond ArduPilot's PSC_JERK_XY of 5
    shoved = (doublet(1.4, 1.5, 1.5), *sines(1.4))
    moved = (step(1.0, 4.0), *sines(0.3))
    climbing = (step(-0.5, 3.0), step(0.5, 3.0), *sines(0.3))
    turning = (step(turn, 4.0), *sines(math.radians(5.0)))
    by_acceleration = (Group("acceleration 0.6 m/s2", "acceleration", pushed),) if manner == "px4" else ()
    return (
        Group("attitude, roll", "roll", leaning),
        Group("attitude, pitch", "pitch", leaning),
        *by_acceleration,
        Group("velocity + acceleration 0.6 m/s2", "both", pushed),
        Group("velocity + acceleration 1.4 m/s2", "both", shoved),
        Group("velocity", "velocity", moved),
        Group("climb", "climb", climbing),
        Group("yaw", "yaw", turning),
    )
