"""The replay itself: a log's samples through fresh estimators, in the order in which they arrived.

Pure: no I/O and no clock. The estimators are built and fed as the app does it (companion/app/app.py and
companion/app/sensing.py), so that a flight of ours under its own settings repeats to the bit.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from companion.base.messages import (
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadState,
    RangeSample,
    VehicleState,
)
from companion.estimate.estimator import StateEstimator
from companion.estimate.pad.observation_kinds import BY_MESSAGE
from companion.flightlog.replay.flight_record import Ask, RecordedEvent, ReplaySetup, Sample

# a log that does not say when its app asked is asked at this rate
ASK_RATE_HZ: Final = 30.0
# nothing is asked within a gap that is longer than this
LONGEST_GAP_S: Final = 1.0
REFUSED_PERIOD_S: Final = 0.2


@dataclass(slots=True)
class Replayed:
    """What the estimators said this time.

    `states` are in the order asked for, a vehicle before a pad; `refused` is the counts of
    `StateEstimator.refused` over time; `samples` counts what went in by kind.
    """

    states: list[VehicleState | PadState] = field(default_factory=list)
    refused: list[tuple[float, dict[str, int]]] = field(default_factory=list)
    samples: Counter[str] = field(default_factory=Counter)

    @property
    def vehicles(self) -> list[VehicleState]:
        return [state for state in self.states if isinstance(state, VehicleState)]

    @property
    def pads(self) -> list[PadState]:
        return [state for state in self.states if isinstance(state, PadState)]


def new_estimator(rig: ReplaySetup) -> StateEstimator:
    """The estimators as the app makes them."""
    antenna = rig.config.sense.gps.antenna_position_body_m
    half_width_m = 0.5 * min(rig.pad.width_m, rig.pad.length_m)
    return StateEstimator(rig.config.estimate, rig.vehicle, antenna, half_width_m)


def replay(
    events: Sequence[RecordedEvent], rig: ReplaySetup, on_progress: Callable[[float], None] | None = None
) -> Replayed:
    """Run a log's events through new estimators.

    Args:
        events: in order of arrival.
        rig: what the estimators are made from.
        on_progress: called now and then with the share (0..1) that is done.
    """
    estimator, result = new_estimator(rig), Replayed()
    takers = _takers(estimator)
    refused_s, asked_s, every = -math.inf, -math.inf, max(len(events) // 100, 1)
    has_asks = any(isinstance(event.item, Ask) for event in events)
    for k, (_, item) in enumerate(events if has_asks else asked_regularly(events)):
        if not isinstance(item, Ask):
            kind, take = takers[type(item)]
            take(item)
            result.samples[kind] += 1
        else:
            asked_s = item.time_s
            _ask(estimator, asked_s, result)
            if item.time_s - refused_s >= REFUSED_PERIOD_S:
                refused_s = item.time_s
                result.refused.append((refused_s, estimator.refused))
        if on_progress is not None and k % every == 0:
            on_progress(min(k / len(events), 1.0))
    result.refused.append((asked_s, estimator.refused))
    return result


def _ask(estimator: StateEstimator, time_s: float, result: Replayed) -> None:
    """As the control cycle does: no pad without a vehicle."""
    vehicle, pad = estimator.vehicle(time_s), estimator.pad(time_s)
    if vehicle is not None:
        result.states.append(vehicle)
        if pad is not None:
            result.states.append(pad)


def _takers(estimator: StateEstimator) -> dict[type[Sample], tuple[str, Callable[[Any], object]]]:
    """By the type of a sample what its kind is called, and who takes it."""
    return {
        ImuSample: ("imu", estimator.add_imu),
        MagSample: ("mag", estimator.add_mag),
        GpsFix: ("gps", estimator.add_gps),
        RangeSample: ("range", estimator.add_range),
        AutopilotAttitude: ("autopilot attitude", estimator.add_autopilot_attitude),
        **{message: (kind.name, estimator.observe) for message, kind in BY_MESSAGE.items()},
    }


def asked_regularly(events: Sequence[RecordedEvent], rate_hz: float = ASK_RATE_HZ) -> Iterator[RecordedEvent]:
    """The events, with the states asked for at a fixed rate in between."""
    first_s = events[0].arrival_s if events else 0.0
    asked = 0
    for event in events:
        due_s = first_s + asked / rate_hz
        if event.arrival_s - due_s > LONGEST_GAP_S:
            asked = math.ceil((event.arrival_s - first_s) * rate_hz)
        while (due_s := first_s + asked / rate_hz) < event.arrival_s:
            asked += 1
            yield RecordedEvent(due_s, Ask(due_s))
        yield event
