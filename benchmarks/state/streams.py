"""Recorded sensor streams: fly once with rendering, run the estimators over it again in seconds.

    python -m benchmarks state --scenarios figure_8 --seeds 10 --streams streams

flies in virtual time and leaves SCENARIO_SEED.pickle with what went into the estimator, in the order in which
it came, and the truth. `rerun` drives a new estimator, with other settings if wanted, over a stream, and
gives its errors against the truth with the filters' own covariances; with the settings that flew, it repeats
what flew to the bit.

Times are the virtual loop's (s), which the world counts by, too.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cv2

from benchmarks.state.samples import EstimatorAnswer, Samples, ask, samples_of
from companion.base.messages import (
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadSighting,
    PadState,
    PlanStep,
    RangeSample,
    Truth,
    VehicleState,
)
from companion.config import CONFIG_FOLDER, CompanionConfig, VehicleConfig, find_file, load_model
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.pad import load_pad
from companion.sim.runner import fly
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial

INPUTS: Final[dict[str, type[Any]]] = {
    "imu": ImuSample,
    "autopilot_attitude": AutopilotAttitude,
    "mag": MagSample,
    "gps": GpsFix,
    "range": RangeSample,
    "sighting": PadSighting,
}
# the vehicle's state is asked for in every control cycle: kept in its place among the inputs, as a question
KEPT: Final[dict[str, type[Any]]] = {**INPUTS, "vehicle": VehicleState, "pad": PadState}
SAMPLES_S: Final = 0.1  # at least, from one sample to the next
AIRBORNE_M: Final = 0.5  # higher than that over its start the vehicle has taken off


@dataclass(frozen=True, slots=True)
class StreamEvent:
    """One message: an estimator's input or, by the topics "vehicle" and "pad", what it answered."""

    topic: str
    arrival_s: float
    message: Any


@dataclass(frozen=True)
class Stream:
    """One flight: its events in order of arrival, the truth, and how it went."""

    scenario: str
    seed: int
    events: tuple[StreamEvent, ...]
    truth: tuple[Truth, ...]
    phases: tuple[tuple[float, str], ...]  # when each began
    outcome: str
    failures: tuple[str, ...] = ()
    touchdown: dict[str, float] | None = None

    @cached_property
    def airborne_s(self) -> tuple[float, float]:
        """From take-off (the last contact before the climb) to touchdown (the first after it)."""
        ground_m = self.truth[0].vehicle_position_ned_m[2]
        high = [t.vehicle_position_ned_m[2] < ground_m - AIRBORNE_M for t in self.truth]
        if not any(high):
            return (self.truth[-1].time_s, self.truth[-1].time_s)
        climb = high.index(True)
        before = [t.time_s for t in self.truth[:climb] if t.in_contact]
        after = [t.time_s for t in self.truth[climb:] if t.in_contact]
        start_s, end_s = self.truth[0].time_s, self.truth[-1].time_s
        return (before[-1] if before else start_s, after[0] if after else end_s)


# ---------------------------------------------------------------- flying


class _StreamLog(FlightLog):
    """A flight log that also keeps what a stream needs, in one order."""

    def __init__(self) -> None:
        super().__init__(None, start_unix_s=0.0)
        self.events: list[StreamEvent] = []

    def write(self, topic: str, message: Any, time_s: float) -> None:
        super().write(topic, message, time_s)
        if topic in KEPT:
            self.events.append(StreamEvent(topic, time_s, message))


def fly_stream(trial: Trial) -> Stream:
    """Fly a trial in virtual time and keep its stream."""
    cv2.setNumThreads(1)
    log = _StreamLog()
    report = fly(settings_of(trial), trial, log, lambda _status: None, fast=True).report
    return Stream(
        scenario=trial.scenario.name,
        seed=trial.seed,
        events=tuple(log.events),
        truth=report.truth,
        phases=_phases(log.kept["plan"]),
        outcome=report.outcome.value,
        failures=report.failures,
        touchdown=report.touchdown,
    )


def settings_of(trial: Trial) -> CompanionConfig:
    """The app's settings for a trial, as shipped."""
    return sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)


def _phases(plans: Sequence[PlanStep]) -> tuple[tuple[float, str], ...]:
    begun: list[tuple[float, str]] = []
    for plan in plans:
        if not begun or begun[-1][1] != plan.phase.value:
            begun.append((plan.time_s, plan.phase.value))
    return tuple(begun)


# ---------------------------------------------------------------- files


def stream_path(folder: Path, scenario: str, seed: int) -> Path:
    """Where a stream is kept."""
    return folder / f"{scenario}_{seed}.pickle"


def save(stream: Stream, path: Path) -> None:
    """Write a stream as plain values, which a later version's messages can be made of."""
    plain = {item.name: getattr(stream, item.name) for item in fields(stream)}
    plain["events"] = [(e.topic, e.arrival_s, _values(e.message)) for e in stream.events]
    plain["truth"] = [_values(record) for record in stream.truth]
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_bytes(pickle.dumps(plain, protocol=pickle.HIGHEST_PROTOCOL))
    unfinished.replace(path)


def load(path: Path) -> Stream:
    """Read what `save` wrote (a pickle: only of files of one's own)."""
    plain = pickle.loads(path.read_bytes())
    plain["events"] = tuple(
        StreamEvent(t, arrival_s, KEPT[t](**values)) for t, arrival_s, values in plain["events"]
    )
    plain["truth"] = tuple(Truth(**values) for values in plain["truth"])
    return Stream(**plain)


def _values(message: Any) -> dict[str, Any]:
    return {item.name: getattr(message, item.name) for item in fields(message)}


# ---------------------------------------------------------------- running again


def new_estimator(config: CompanionConfig) -> StateEstimator:
    """The estimator as the app makes it."""
    pad = load_pad(config.pad)
    vehicle = load_model(VehicleConfig, find_file("vehicles", config.vehicle))
    antenna = config.sense.gps.antenna_position_body_m
    return StateEstimator(config.estimate, vehicle, antenna, 0.5 * min(pad.width_m, pad.length_m))


def rerun(stream: Stream, config: CompanionConfig | None = None) -> Samples:
    """Run a new estimator over the stream and compare it with the truth.

    `config`: settings of the app; None: those shipped, under the stream's scenario. The samples fall on the
    control cycles that flew.
    """
    estimator = new_estimator(config or settings_of(Trial.load(stream.scenario, stream.seed)))
    answers: list[EstimatorAnswer] = []
    next_s = 0.0
    for event in stream.events:
        if event.topic in INPUTS:
            feed(estimator, event)
        elif event.topic == "vehicle" and event.arrival_s >= next_s - 1e-6:
            next_s = max(next_s + SAMPLES_S, event.arrival_s)
            answer = ask(estimator, event.arrival_s)
            answers += [] if answer is None else [answer]
    return samples_of(answers, stream.truth, stream.airborne_s)


def feed(estimator: StateEstimator, event: StreamEvent) -> None:
    """Give the estimator one input."""
    take: dict[str, Callable[[Any], bool]] = {
        "imu": estimator.add_imu,
        "autopilot_attitude": estimator.add_autopilot_attitude,
        "mag": estimator.add_mag,
        "gps": estimator.add_gps,
        "range": estimator.add_range,
        "sighting": estimator.add_sighting,
    }
    take[event.topic](event.message)
