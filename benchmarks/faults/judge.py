"""How a flight with a fault ended, and whether anything in it was unsafe: by the simulator's record.

Of the app the judge reads two heights: that of its reference, whose climbs have to be announced, and the
vehicle's as the app believes it.

What is unsafe: docs/results/benchmarks.md, "Faults by phase".
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, get_args

from benchmarks.faults.climbs import unannounced_climbs
from benchmarks.faults.sent_limits import OBEYED_MODES, ON_SURFACE_M, broken_limits
from benchmarks.faults.witness import TruthSample, WitnessedFlight
from companion.config import LimitsConfig

Outcome = Literal["landed", "held", "pilot", "returned", "stands", "not flown", "unsafe"]
OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)

SIDEWAYS_M_S: Final = 0.3
DOWN_M_S: Final = 0.7
# what is disarmed and stands may be run over by the pad, which nobody on board can help
AFTER_DISARMING_S: Final = 1.0
# the autopilot's own position is off by its GPS
PLACE_ERROR_M: Final = 3.0
SAID_BEFORE_S: Final = 3.0
FLOWN_M: Final = 0.3
HOLD_MODES: Final = ("AUTO_LOITER", "POSCTL", "LOITER", "BRAKE")
PHASE_WORDS: Final = re.compile(
    r"(connect|arm|take off|waypoint|route|search|approach|descend|touchdown|landed|hold|abort|standby): "
)
# the phase, the event that led to it, and why
END_WORDS: Final = re.compile(r"(landed|abort|hold): [^:]+: \S")
LANDED_WORDS: Final = "landed: "
SHOUTS_EVERY_S: Final = 60.0
_ERROR: Final = 3  # MAV_SEVERITY, and less is graver
_WARNING: Final = 4


@dataclass(frozen=True, slots=True)
class SafetyBounds:
    """What a flight has to keep: the gate's limits, fence and ceiling (m from home, over home)."""

    limits: LimitsConfig
    fence_m: float
    ceiling_m: float


@dataclass(frozen=True, slots=True)
class SafetyVerdict:
    """How it ended, and each unsafe thing with its time."""

    outcome: Outcome
    unsafe: tuple[str, ...] = ()


def judge(record: WitnessedFlight, bounds: SafetyBounds) -> SafetyVerdict:
    """Judge a flight that is over."""
    unsafe = (
        *_crash(record),
        *_touches(record),
        *_contacts(record),
        *_disarmings(record),
        *_strayed(record, bounds),
        *_climbs(record),
        *broken_limits(record, bounds.limits),
        *(
            (*_silent_end(record), *_left_alone(record))
            if record.unasked_from_s is None
            else _unasked(record)
        ),
        *_false_landing(record),
        *_overruled(record),
    )
    return SafetyVerdict("unsafe", unsafe) if unsafe else SafetyVerdict(_ending(record))


def _ending(record: WitnessedFlight) -> Outcome:
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


def _crash(record: WitnessedFlight) -> Iterator[str]:
    if record.crashed:
        yield "crash"


def _touches(record: WitnessedFlight) -> Iterator[str]:
    """The worst touch of the ground, once."""
    off_s = max((d.time_s for d in record.disarmings), default=math.inf)
    counted = [t for t in record.touches if t.armed or t.time_s <= off_s + AFTER_DISARMING_S]
    sideways = max(counted, key=lambda touch: touch.sideways_m_s, default=None)
    down = max(counted, key=lambda touch: touch.down_m_s, default=None)
    if sideways is not None and sideways.sideways_m_s > SIDEWAYS_M_S:
        yield f"ground {sideways.sideways_m_s:.2f} m/s sideways at {sideways.time_s:.1f} s"
    if down is not None and down.down_m_s > DOWN_M_S:
        yield f"ground {down.down_m_s:.2f} m/s down at {down.time_s:.1f} s"


def _contacts(record: WitnessedFlight) -> Iterator[str]:
    """Every contact with the pad that was too hard, and every one with the ground that was not the last."""
    for contact in record.contacts:
        if contact.on_pad and (
            contact.horizontal_speed_m_s > SIDEWAYS_M_S or contact.vertical_speed_m_s > DOWN_M_S
        ):
            yield (
                f"pad {contact.vertical_speed_m_s:.2f} m/s down, {contact.horizontal_speed_m_s:.2f} m/s "
                f"sideways at {contact.time_s:.1f} s"
            )
    for contact in record.contacts[:-1]:
        if not contact.on_pad and not contact.before_flight and _obeyed_at(record, contact.time_s):
            yield f"touched the ground at {contact.time_s:.1f} s and flew on"


def _obeyed_at(record: WitnessedFlight, time_s: float) -> bool:
    before = [sample for sample in record.samples if sample.time_s <= time_s]
    return bool(before) and before[-1].mode in OBEYED_MODES


def _disarmings(record: WitnessedFlight) -> Iterator[str]:
    for off in record.disarmings:
        if not off.touching and off.feet_over_surface_m > ON_SURFACE_M:
            yield f"disarmed {off.feet_over_surface_m:.2f} m up at {off.time_s:.1f} s"


def _obeyed(record: WitnessedFlight) -> Iterator[TruthSample]:
    """The samples in which the vehicle flies by the app's setpoints; what stands on the pad goes with it."""
    return (s for s in record.samples if s.armed and s.mode in OBEYED_MODES and not s.touching)


def _strayed(record: WitnessedFlight, bounds: SafetyBounds) -> Iterator[str]:
    farthest = max(_obeyed(record), key=_away_m, default=None)
    if farthest is not None and _away_m(farthest) > bounds.fence_m + PLACE_ERROR_M:
        yield f"{_away_m(farthest):.0f} m from home at {farthest.time_s:.1f} s, outside the fence"
    highest = max(_obeyed(record), key=lambda s: -s.position_ned_m[2], default=None)
    if highest is not None and -highest.position_ned_m[2] > bounds.ceiling_m + PLACE_ERROR_M:
        yield f"{-highest.position_ned_m[2]:.0f} m up at {highest.time_s:.1f} s, over the ceiling"


def _away_m(sample: TruthSample) -> float:
    return math.hypot(sample.position_ned_m[0], sample.position_ned_m[1])


def _stands_and_shouts(record: WitnessedFlight) -> bool:
    """Whether it stands on the pad, and the app keeps saying that it cannot be disarmed, while it runs."""
    last_s = record.samples[-1].time_s if record.app_stopped_s is None else record.app_stopped_s
    shouts = (t for t in record.texts if t.severity <= _WARNING and t.time_s >= last_s - SHOUTS_EVERY_S)
    return record.at_rest_on_pad and any(shouts)


def _silent_end(record: WitnessedFlight) -> Iterator[str]:
    if record.app_ended_s is None:
        if not _stands_and_shouts(record):
            yield "no end within the time limit"
    elif record.app_failed:
        last = [t for t in record.texts if t.time_s >= record.app_ended_s - SAID_BEFORE_S]
        if not any(t.severity <= _ERROR for t in last):
            yield f"the app failed without a text: {record.app_failed}"
    elif not _says_why(record):
        yield "ended without a text that says why"


def _left_alone(record: WitnessedFlight) -> Iterator[str]:
    """An end that is none: in the air it waits for setpoints, and nothing changes that."""
    last = record.samples[-1]
    if last.armed and not last.touching and last.mode in OBEYED_MODES:
        yield f"left in the air in {last.mode}, {_away_m(last):.0f} m from home"


def _climbs(record: WitnessedFlight) -> Iterator[str]:
    """What nobody announced; a pilot's take-off in GUIDED, with no setpoint sent, is his own, and where none
    arrives the autopilot flies."""
    sent_s = -math.inf
    if record.unasked_from_s is not None:
        sent_s = min((setpoint.time_s for setpoint in record.setpoints), default=math.inf)
    flown = (sample for sample in _obeyed(record) if sample.obeys and sample.time_s >= sent_s)
    return unannounced_climbs(flown, record.texts, record.commanded)


def _unasked(record: WitnessedFlight) -> Iterator[str]:
    """What flies nobody's order."""
    asked_s = math.inf if record.unasked_from_s is None else record.unasked_from_s
    first_s = next((setpoint.time_s for setpoint in record.setpoints if setpoint.time_s > asked_s), None)
    if first_s is not None:
        yield f"a setpoint at {first_s:.1f} s that nobody asked for"


def _false_landing(record: WitnessedFlight) -> Iterator[str]:
    """A landing is on the pad."""
    landed = any(text.text.startswith(LANDED_WORDS) for text in record.texts)
    if landed and record.contacts and not record.contacts[-1].on_pad:
        yield "said that it landed, beside the pad"


def _overruled(record: WitnessedFlight) -> Iterator[str]:
    """What the pilot, or a failsafe, has chosen stays; the autopilot's own next mode is neither."""
    ours = (*OBEYED_MODES, *(mode for mode in HOLD_MODES if mode != record.pilot_mode))
    chosen = False
    for sample in record.samples:
        if not record.pilot_mode or sample.time_s <= record.fault_began_s or not sample.armed:
            continue
        if chosen and sample.mode in ours:
            yield f"{sample.mode} over the pilot's {record.pilot_mode} at {sample.time_s:.1f} s"
            return
        chosen = chosen or sample.mode == record.pilot_mode


def _says_why(record: WitnessedFlight) -> bool:
    """Whether the last phase that the app announced is an end, with its reason."""
    phases = [t.text for t in record.texts if PHASE_WORDS.match(t.text + " ")]
    return bool(phases) and END_WORDS.match(phases[-1]) is not None
