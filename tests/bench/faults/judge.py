"""How a flight with a fault ended, and whether anything in it was unsafe: by the simulator's record alone.

Unsafe is a crash; touching anything but the pad faster than 0.3 m/s sideways or 0.7 m/s down; disarming in
the air; flying outside fence or ceiling by the app's setpoints; a climb that was not announced; a setpoint
outside the limits; an end without a text that says why.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from companion.config import LimitsConfig
from sitl.mavlink.app_words import AppText
from tests.bench.faults.witness import FlightRecord, Sample, SentSetpoint

Outcome = Literal["landed", "held", "pilot", "returned", "stands", "not flown", "unsafe"]
OUTCOMES: Final[tuple[Outcome, ...]] = (
    "landed",
    "held",
    "pilot",
    "returned",
    "stands",
    "not flown",
    "unsafe",
)

SIDEWAYS_M_S: Final = 0.3
DOWN_M_S: Final = 0.7
ON_SURFACE_M: Final = 0.05
# what is disarmed and stands may be run over by the pad, which nobody on board can help
AFTER_DISARMING_S: Final = 1.0
# the autopilot's own position is off by its GPS
PLACE_ERROR_M: Final = 3.0
CLIMB_M: Final = 0.7
DRIFT_M: Final = 0.2
RISING_M_S: Final = 0.1
ANNOUNCED_BEFORE_S: Final = 3.0
ANNOUNCED_AFTER_S: Final = 1.0
FLOWN_M: Final = 0.3
# single precision on the wire, and an attitude put together from rounded parts
ROUNDING: Final = 1.001
OBEYED_MODES: Final = ("OFFBOARD", "GUIDED")
HOLD_MODES: Final = ("AUTO_LOITER", "POSCTL", "LOITER")
PHASE_WORDS: Final = re.compile(
    r"(connect|arm|take off|waypoint|route|search|approach|descend|touchdown|landed|hold|abort|standby): "
)
CLIMB_WORDS: Final = re.compile(r"\b(climb\w*|ris(e|es|ing)|waiting again)\b")
FREE_PHASES: Final = ("take off", "waypoint", "route", "search")
DOWN_PHASES: Final = ("descend", "touchdown", "landed")  # their beginning announces no climb
END_PHASES: Final = ("landed", "abort", "hold")
SHOUTS_EVERY_S: Final = 60.0
_ERROR: Final = 3  # MAV_SEVERITY, and less is graver
_WARNING: Final = 4


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a flight has to keep: the gate's limits, fence and ceiling (m from home, over home)."""

    limits: LimitsConfig
    fence_m: float
    ceiling_m: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """How it ended, and each unsafe thing with its time."""

    outcome: Outcome
    unsafe: tuple[str, ...] = ()


def judge(record: FlightRecord, bounds: Bounds) -> Verdict:
    """Judge a flight that is over."""
    unsafe = (
        *_crash(record),
        *_touches(record),
        *_disarmings(record),
        *_strayed(record, bounds),
        *_climbs(record),
        *_setpoints(record, bounds.limits),
        *_silent_end(record),
    )
    return Verdict("unsafe", unsafe) if unsafe else Verdict(_ending(record))


def _ending(record: FlightRecord) -> Outcome:
    last = record.samples[-1]
    if not any(sample.feet_over_surface_m > FLOWN_M for sample in record.samples):
        return "not flown"
    if record.at_rest_on_pad and not last.armed:
        return "landed"
    if record.at_rest_on_pad:
        return "stands"  # with its motors on: nothing disarms it
    if record.pilot_took_over:
        return "pilot"
    return "held" if last.armed and last.mode in HOLD_MODES else "returned"


# ---------------------------------------------------------------- each unsafe kind


def _crash(record: FlightRecord) -> Iterator[str]:
    if record.crashed:
        yield "crash"


def _touches(record: FlightRecord) -> Iterator[str]:
    """The worst touch of the ground, once."""
    off_s = max((d.time_s for d in record.disarmings), default=math.inf)
    counted = [t for t in record.touches if t.armed or t.time_s <= off_s + AFTER_DISARMING_S]
    sideways = max(counted, key=lambda touch: touch.sideways_m_s, default=None)
    down = max(counted, key=lambda touch: touch.down_m_s, default=None)
    if sideways is not None and sideways.sideways_m_s > SIDEWAYS_M_S:
        yield f"ground {sideways.sideways_m_s:.2f} m/s sideways at {sideways.time_s:.1f} s"
    if down is not None and down.down_m_s > DOWN_M_S:
        yield f"ground {down.down_m_s:.2f} m/s down at {down.time_s:.1f} s"


def _disarmings(record: FlightRecord) -> Iterator[str]:
    for off in record.disarmings:
        if not off.touching and off.feet_over_surface_m > ON_SURFACE_M:
            yield f"disarmed {off.feet_over_surface_m:.2f} m up at {off.time_s:.1f} s"


def _obeyed(record: FlightRecord) -> Iterator[Sample]:
    """The samples in which the vehicle flies by the app's setpoints; what stands on the pad goes with it."""
    return (s for s in record.samples if s.armed and s.mode in OBEYED_MODES and not s.touching)


def _strayed(record: FlightRecord, bounds: Bounds) -> Iterator[str]:
    farthest = max(_obeyed(record), key=_away_m, default=None)
    if farthest is not None and _away_m(farthest) > bounds.fence_m + PLACE_ERROR_M:
        yield f"{_away_m(farthest):.0f} m from home at {farthest.time_s:.1f} s, outside the fence"
    highest = max(_obeyed(record), key=lambda s: -s.position_ned_m[2], default=None)
    if highest is not None and -highest.position_ned_m[2] > bounds.ceiling_m + PLACE_ERROR_M:
        yield f"{-highest.position_ned_m[2]:.0f} m up at {highest.time_s:.1f} s, over the ceiling"


def _away_m(sample: Sample) -> float:
    return math.hypot(sample.position_ned_m[0], sample.position_ned_m[1])


def _climbs(record: FlightRecord) -> Iterator[str]:
    """Rises by more than `CLIMB_M`, flown by the app's setpoints, that nothing announced; the first alone.

    One begins where it leaves the lowest place by more than `DRIFT_M`: a slow drift is no beginning. One that
    was announced may go on until it pauses.
    """
    lowest_down_m, begun_s, going_on = -math.inf, 0.0, False
    for sample in _obeyed(record):
        down_m = sample.position_ned_m[2]
        going_on = going_on and sample.velocity_ned_m_s[2] < -RISING_M_S
        lowest_down_m = down_m if going_on else max(lowest_down_m, down_m)
        rise_m = lowest_down_m - down_m
        if rise_m <= DRIFT_M:
            begun_s = sample.time_s
        if rise_m < CLIMB_M:
            continue
        if not _announced(record.texts, begun_s):
            yield f"climbed from {begun_s:.1f} s, unannounced"
            return
        lowest_down_m, going_on = down_m, True


def _announced(texts: list[AppText], from_s: float) -> bool:
    if _phase_at(texts, from_s) in FREE_PHASES:
        return True
    near = [t for t in texts if from_s - ANNOUNCED_BEFORE_S <= t.time_s <= from_s + ANNOUNCED_AFTER_S]
    phases = [found[1] for t in near if (found := PHASE_WORDS.match(t.text))]
    return any(phase not in DOWN_PHASES for phase in phases) or any(CLIMB_WORDS.search(t.text) for t in near)


def _phase_at(texts: list[AppText], time_s: float) -> str:
    """The phase that the app announced last."""
    said = [found[1] for t in texts if t.time_s <= time_s and (found := PHASE_WORDS.match(t.text))]
    return said[-1] if said else "connect"


def _setpoints(record: FlightRecord, limits: LimitsConfig) -> Iterator[str]:
    for sent in record.setpoints:
        broken = broken_limit(sent, limits)
        if broken:
            yield f"setpoint at {sent.time_s:.1f} s: {broken}"
            return


def broken_limit(sent: SentSetpoint, limits: LimitsConfig) -> str:
    """The limit that a setpoint breaks; empty when none."""
    if not sent.finite:
        return "not finite"
    return next(
        (
            f"{name} {value:.2f}"
            for name, value, low, high in _bounded(sent, limits)
            if not low * ROUNDING <= value <= high * ROUNDING
        ),
        "",
    )


def _bounded(sent: SentSetpoint, limits: LimitsConfig) -> Iterator[tuple[str, float, float, float]]:
    """What a setpoint holds, between what it has to lie."""
    yield "tilt (deg)", math.degrees(sent.tilt_rad), 0.0, limits.tilt_deg
    most = limits.heading_rate_deg_s
    yield "yaw rate (deg/s)", math.degrees(sent.yaw_rate_rad_s), -most, most
    if sent.thrust is not None:
        yield "thrust", sent.thrust, 0.0, limits.maximum_thrust
    if sent.velocity_ned_m_s is not None:
        north, east, down = sent.velocity_ned_m_s
        yield "velocity (m/s)", math.hypot(north, east), 0.0, limits.horizontal_speed_m_s
        yield "velocity down (m/s)", down, -limits.climb_speed_m_s, limits.descent_speed_m_s
    if sent.acceleration_ned_m_s2 is not None:
        north, east, down = sent.acceleration_ned_m_s2
        yield "acceleration (m/s2)", math.hypot(north, east), 0.0, limits.horizontal_acceleration_m_s2
        most = limits.vertical_acceleration_m_s2
        yield "acceleration down (m/s2)", down, -most, most


def _stands_and_shouts(record: FlightRecord) -> bool:
    """Whether it stands on the pad, and the app keeps saying that it cannot be disarmed."""
    last_s = record.samples[-1].time_s
    shouts = (t for t in record.texts if t.severity <= _WARNING and t.time_s >= last_s - SHOUTS_EVERY_S)
    return record.at_rest_on_pad and any(shouts)


def _silent_end(record: FlightRecord) -> Iterator[str]:
    if record.app_ended_s is None:
        if not _stands_and_shouts(record):
            yield "no end within the time limit"
    elif record.app_failed:
        last = [t for t in record.texts if t.time_s >= record.app_ended_s - ANNOUNCED_BEFORE_S]
        if not any(t.severity <= _ERROR for t in last):
            yield f"the app failed without a text: {record.app_failed}"
    elif _phase_at(record.texts, math.inf) not in END_PHASES:
        yield "ended without a text that says why"
