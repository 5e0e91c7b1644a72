"""The gate's limits in the setpoints as they left the app.

Besides the size of each, its change (jerk) between one and the next: within 50 ms of each other, and while
the autopilot has obeyed them for 2 s, since the gate begins anew with each setpoint until the app knows that
they are obeyed. Where the heading leaps, the app has turned all into a heading that the autopilot has reset.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from benchmarks.faults.witness import SentSetpoint, TruthSample, WitnessedFlight
from companion.base.geometry import GRAVITY_M_S2, norm, subtract, wrap_angle
from companion.config import LimitsConfig

OBEYED_MODES: Final = ("OFFBOARD", "GUIDED")
# single precision on the wire, and an attitude put together from rounded parts
ROUNDING: Final = 1.001
# the heading into which all is turned is filtered, and moves a little between two setpoints
TURNING_M_S2: Final = 0.05
STAMPS_S: Final = 0.001
IN_A_ROW_S: Final = 0.05
OBEYED_S: Final = 2.0
# the app takes the motors' thrust away once it stands; higher than this it does not
ON_SURFACE_M: Final = 0.05


def broken_limits(record: WitnessedFlight, limits: LimitsConfig) -> Iterator[str]:
    """The first setpoint outside the limits."""
    where = _Where(record.samples)
    for sent in record.setpoints:
        broken = broken_limit(sent, limits, in_air=where.in_air(sent.time_s))
        if broken:
            yield f"setpoint at {sent.time_s:.1f} s: {broken}"
            return
    where = _Where(record.samples)
    for last, sent in pairwise(record.setpoints):
        if where.obeyed(sent.time_s) and (broken := broken_change(last, sent, limits)):
            yield f"setpoint at {sent.time_s:.1f} s: {broken}"
            return


class _Where:
    """What the vehicle does at a time; the times never run backwards."""

    def __init__(self, samples: Sequence[TruthSample]) -> None:
        self._samples = samples
        self._next = 0
        self._since_s = math.inf

    def _at(self, time_s: float) -> TruthSample | None:
        while self._next < len(self._samples) and self._samples[self._next].time_s <= time_s:
            sample = self._samples[self._next]
            obeys = sample.mode in OBEYED_MODES
            self._since_s = min(self._since_s, sample.time_s) if obeys else math.inf
            self._next += 1
        return self._samples[self._next - 1] if self._next else None

    def in_air(self, time_s: float) -> bool:
        """Whether it flies."""
        sample = self._at(time_s)
        return sample is not None and not sample.touching and sample.feet_over_surface_m > ON_SURFACE_M

    def obeyed(self, time_s: float) -> bool:
        """Whether setpoints have been obeyed for so long that the app knows."""
        return self._at(time_s) is not None and time_s - self._since_s >= OBEYED_S


def broken_limit(sent: SentSetpoint, limits: LimitsConfig, *, in_air: bool = True) -> str:
    """The limit that a setpoint breaks; empty when none."""
    if not sent.finite:
        return "not finite"
    return next(
        (
            f"{name} {value:.2f}"
            for name, value, low, high in _bounded(sent, limits, in_air)
            if not low - (ROUNDING - 1.0) * abs(low) <= value <= high * ROUNDING
        ),
        "",
    )


def broken_change(last: SentSetpoint, sent: SentSetpoint, limits: LimitsConfig) -> str:
    """The jerk of two setpoints in a row when it is beyond its limit; empty when not."""
    step_s = sent.time_s - last.time_s
    turned = abs(wrap_angle(sent.yaw_rad - last.yaw_rad))
    most_rad = math.radians(limits.heading_rate_deg_s) * (step_s + STAMPS_S) * ROUNDING
    if not 0.0 < step_s <= IN_A_ROW_S or turned > most_rad:
        return ""
    most = limits.jerk_m_s3 * (step_s + STAMPS_S) * ROUNDING + TURNING_M_S2
    for name, now, before in (
        ("jerk", sent.acceleration_ned_m_s2, last.acceleration_ned_m_s2),
        ("jerk by tilt", sent.tilt_ned_m_s2, last.tilt_ned_m_s2),
    ):
        if now is not None and before is not None and norm(subtract(now, before)) > most:
            return f"{name} (m/s3) {norm(subtract(now, before)) / step_s:.2f}"
    return ""


def _bounded(
    sent: SentSetpoint, limits: LimitsConfig, in_air: bool
) -> Iterator[tuple[str, float, float, float]]:
    """What a setpoint holds, between what it has to lie."""
    yield "tilt (deg)", math.degrees(sent.tilt_rad), 0.0, limits.tilt_deg
    most = limits.heading_rate_deg_s
    yield "yaw rate (deg/s)", math.degrees(sent.yaw_rate_rad_s), -most, most
    if sent.thrust is not None:
        least = limits.minimum_thrust if in_air else 0.0
        yield "thrust", sent.thrust, least, limits.maximum_thrust
    if sent.velocity_ned_m_s is not None:
        north, east, down = sent.velocity_ned_m_s
        yield "velocity (m/s)", math.hypot(north, east), 0.0, limits.horizontal_speed_m_s
        yield "velocity down (m/s)", down, -limits.climb_speed_m_s, limits.descent_speed_m_s
    if sent.acceleration_ned_m_s2 is not None:
        north, east, down = sent.acceleration_ned_m_s2
        yield "acceleration (m/s2)", math.hypot(north, east), 0.0, limits.horizontal_acceleration_m_s2
        most = limits.vertical_acceleration_m_s2
        # on the pad, as the thrust, all of it may be taken away
        yield "acceleration down (m/s2)", down, -most - sent.pressed_m_s2, most if in_air else GRAVITY_M_S2
