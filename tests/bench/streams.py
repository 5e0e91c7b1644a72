"""Recorded sensor streams: fly once with rendering, run the estimators over it again in seconds.

    python -m tests.bench.streams --scenarios figure_8 --seeds 10 --folder streams

flies in virtual time, in process, and leaves SCENARIO_SEED.pickle with what went into the estimator, in the
order in which it came, and the truth. `rerun` drives a new Estimator, with other settings if wanted, over
a stream, as it flew or edited (a fault put in offline), and gives its errors against the truth with the
filters' own covariances; unedited and with the settings that flew, it repeats what flew to the bit.

Errors are truth minus estimate; the attitude's is the rotation vector (rad, NED axes) of R_true R_estᵀ.
Times are the virtual loop's (s), which the world counts by, too.
"""

from __future__ import annotations

import argparse
import pickle
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from companion.config import CONFIG_FOLDER, CompanionConfig, VehicleConfig, find_file, load_model
from companion.desk import Trial, desk_settings, fly
from companion.estimate.estimator import Estimator
from companion.geometry import FloatArray, ned_from_geodetic, quat_conjugate, quat_multiply
from companion.geometry import rotation_vector_from_quat as rotation_vector
from companion.messages import (
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
from companion.pad import load_pad
from companion.record import FlightLog
from companion.result import TruthTrack
from sitl.simulation import HOME

INPUTS: Final[dict[str, type[Any]]] = {
    "imu": ImuSample,
    "mag": MagSample,
    "gps": GpsFix,
    "range": RangeSample,
    "sighting": PadSighting,
}
# the vehicle's state is asked for in every control cycle: kept in its place among the inputs, as a question
KEPT: Final[dict[str, type[Any]]] = {**INPUTS, "vehicle": VehicleState, "pad": PadState}
AIRBORNE_M: Final = 0.5  # higher than that over its start the vehicle has taken off
SEEN_GAP_S: Final = 0.5  # unseen for so long, the pad is out of view


@dataclass(frozen=True, slots=True)
class Event:
    """One message: an estimator's input or, by the topics "vehicle" and "pad", what it answered."""

    topic: str
    arrival_s: float
    message: Any


@dataclass(frozen=True)
class Stream:
    """One flight: its events in order of arrival, the truth, and how it went."""

    scenario: str
    seed: int
    events: tuple[Event, ...]
    truth: tuple[Truth, ...]
    phases: tuple[tuple[float, str], ...]  # when each began
    outcome: str
    failures: tuple[str, ...] = ()
    touchdown: dict[str, float] | None = None
    notices: tuple[tuple[float, str], ...] = ()

    @cached_property
    def track(self) -> TruthTrack:
        """The truth, to be interpolated."""
        return TruthTrack(self.truth)

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

    def edited(self, edit: Callable[[Event], Event | None]) -> Stream:
        """A copy whose inputs have gone through `edit` (None: lost), in their new order of arrival."""
        events = [
            changed
            for event in self.events
            if (changed := edit(event) if event.topic in INPUTS else event) is not None
        ]
        return replace(self, events=tuple(sorted(events, key=lambda event: event.arrival_s)))


@dataclass(frozen=True)
class Samples:
    """Errors (truth minus estimate) and covariances at n times; see the fields for shapes.

    Where there is no estimate, errors are NaN: positions before the first fix, all of the pad's without one.
    """

    time_s: FloatArray  # (n,)
    rotation_rad: FloatArray  # (n, 3) about NED axes
    velocity_m_s: FloatArray  # (n, 3)
    position_m: FloatArray  # (n, 3) by way of latitude and longitude
    covariance: FloatArray  # (n, 9, 9) rotation, velocity, position
    pad_position_m: FloatArray  # (n, 3) relative
    pad_velocity_m_s: FloatArray  # (n, 3) relative
    pad_ned_velocity_m_s: FloatArray  # (n, 3) of the pad over ground
    pad_heading_rad: FloatArray  # (n,)
    pad_covariance: FloatArray  # (n, 9, 9) relative position, relative velocity, acceleration
    seen_for_s: FloatArray  # (n,) how long the pad has been in view without a gap; NaN: not in view
    airborne: Any = field(repr=False)  # (n,) bool: from take-off to touchdown

    @property
    def attitude_deg(self) -> FloatArray:
        """(n,) angle between true and estimated attitude."""
        angle: FloatArray = np.degrees(np.linalg.norm(self.rotation_rad, axis=1))
        return angle

    @property
    def inclination_deg(self) -> FloatArray:
        """(n,) its share about horizontal axes."""
        angle: FloatArray = np.degrees(np.linalg.norm(self.rotation_rad[:, :2], axis=1))
        return angle

    @property
    def heading_deg(self) -> FloatArray:
        """(n,) its share about the vertical, signed."""
        heading: FloatArray = np.degrees(self.rotation_rad[:, 2])
        return heading

    def where(self, mask: Any) -> Samples:
        """The samples that a boolean mask (n,) chooses."""
        return Samples(**{item.name: getattr(self, item.name)[mask] for item in fields(self)})


def rms(rows: FloatArray) -> float:
    """Root mean square of values (n,), or of the lengths of rows (n, 3); NaN without any."""
    lengths = rows if rows.ndim == 1 else np.linalg.norm(rows, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    return float(np.sqrt(np.mean(lengths**2))) if len(lengths) else float("nan")


# ---------------------------------------------------------------- flying


class _StreamLog(FlightLog):
    """A flight log that also keeps what a stream needs, in one order."""

    def __init__(self) -> None:
        super().__init__(None, start_unix_s=0.0)
        self.events: list[Event] = []

    def write(self, topic: str, message: Any, time_s: float) -> None:
        super().write(topic, message, time_s)
        if topic in KEPT:
            self.events.append(Event(topic, time_s, message))


def fly_stream(trial: Trial, config: CompanionConfig | None = None) -> Stream:
    """Fly a trial in virtual time and keep its stream."""
    cv2.setNumThreads(1)
    log = _StreamLog()
    settings = config or settings_of(trial)
    report = fly(settings, trial, log, lambda _status: None, fast=True).report
    return Stream(
        scenario=trial.scenario.name,
        seed=trial.seed,
        events=tuple(log.events),
        truth=report.truth,
        phases=_phases(log.kept["plan"]),
        outcome=report.outcome.value,
        failures=report.failures,
        touchdown=report.touchdown,
        notices=tuple((notice.time_s, notice.text) for notice in log.kept["notice"]),
    )


def settings_of(trial: Trial) -> CompanionConfig:
    """The app's settings for a trial, as shipped."""
    return desk_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)


def _phases(plans: Sequence[PlanStep]) -> tuple[tuple[float, str], ...]:
    begun: list[tuple[float, str]] = []
    for plan in plans:
        if not begun or begun[-1][1] != plan.phase.value:
            begun.append((plan.time_s, plan.phase.value))
    return tuple(begun)


# ---------------------------------------------------------------- files


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
        Event(t, arrival_s, KEPT[t](**values)) for t, arrival_s, values in plain["events"]
    )
    plain["truth"] = tuple(Truth(**values) for values in plain["truth"])
    return Stream(**plain)


def _values(message: Any) -> dict[str, Any]:
    return {item.name: getattr(message, item.name) for item in fields(message)}


# ---------------------------------------------------------------- running again


def new_estimator(config: CompanionConfig) -> Estimator:
    """The estimator as the app makes it."""
    pad = load_pad(config.pad)
    vehicle = load_model(VehicleConfig, find_file("vehicles", config.vehicle))
    antenna = config.sense.gps.antenna_position_body_m
    return Estimator(config.estimate, vehicle, antenna, 0.5 * min(pad.width_m, pad.length_m))


def rerun(stream: Stream, config: CompanionConfig | None = None, rate_hz: float = 10.0) -> Samples:
    """Run a new estimator over the stream and compare it with the truth.

    Args:
        stream: as flown, or edited.
        config: settings of the app; None: those shipped, under the stream's scenario.
        rate_hz: of the samples, which fall on the control cycles that flew.
    """
    estimator = new_estimator(config or settings_of(Trial.load(stream.scenario, stream.seed)))
    recorder, next_s = _Recorder(stream, estimator), 0.0
    for event in stream.events:
        if event.topic in INPUTS:
            feed(estimator, event)
        elif event.topic == "vehicle" and event.arrival_s >= next_s - 1e-6:
            next_s = max(next_s + 1.0 / rate_hz, event.arrival_s)
            recorder.sample(event.arrival_s)
    return recorder.samples()


def feed(estimator: Estimator, event: Event) -> None:
    """Give the estimator one input."""
    take: dict[str, Callable[[Any], bool]] = {
        "imu": estimator.add_imu,
        "mag": estimator.add_mag,
        "gps": estimator.add_gps,
        "range": estimator.add_range,
        "sighting": estimator.add_sighting,
    }
    take[event.topic](event.message)


@dataclass
class _Answers:
    """What the estimator has answered; a row each."""

    vehicle: VehicleState
    covariance: FloatArray
    pad: PadState | None
    pad_covariance: FloatArray | None


class _Recorder:
    """Asks the estimator, and compares with the truth at the end."""

    def __init__(self, stream: Stream, estimator: Estimator) -> None:
        self._stream = stream
        self._estimator = estimator
        self._rows: list[_Answers] = []

    def sample(self, now_s: float) -> None:
        """Ask for everything, as a control cycle does."""
        vehicle, covariance = self._estimator.vehicle(now_s), self._estimator.vehicle_covariance()
        if vehicle is None or covariance is None:
            return
        pad, pad_covariance = self._estimator.pad(now_s), self._estimator.pad_covariance(now_s)
        self._rows.append(_Answers(vehicle, covariance, pad, pad_covariance))

    def samples(self) -> Samples:
        """Errors and covariances of all rows within the track of the truth."""
        track, rows = self._stream.track, self._rows
        rows = [row for row in rows if bool(track.covers(np.array([row.vehicle.time_s]))[0])]
        times = np.array([row.vehicle.time_s for row in rows])
        start_s, end_s = self._stream.airborne_s
        return Samples(
            time_s=times,
            **_vehicle_errors([row.vehicle for row in rows], track, times),
            covariance=np.array([row.covariance for row in rows]).reshape(-1, 9, 9),
            **self._pad_errors(rows, times),
            airborne=(times > start_s) & (times < end_s),
        )

    def _pad_errors(self, rows: Sequence[_Answers], times: FloatArray) -> dict[str, FloatArray]:
        track, nothing = self._stream.track, (np.nan,) * 3
        pads = [row.pad for row in rows]
        place = np.array([p.relative_position_ned_m if p else nothing for p in pads]).reshape(-1, 3)
        speed = np.array([p.relative_velocity_ned_m_s if p else nothing for p in pads]).reshape(-1, 3)
        over_ground = np.array([p.velocity_ned_m_s if p else nothing for p in pads]).reshape(-1, 3)
        heading = np.array([p.heading_rad if p else np.nan for p in pads])
        pad_velocity = track.at("pad_velocity", times)
        truth_times = [t.time_s for t in self._stream.truth]
        headings = np.unwrap([t.pad_heading_rad for t in self._stream.truth])
        turned = np.interp(times, truth_times, headings) - heading
        empty = np.full((9, 9), np.nan)
        covariances = [empty if row.pad_covariance is None else row.pad_covariance for row in rows]
        return {
            "pad_position_m": track.at("pad_position", times) - track.at("position", times) - place,
            "pad_velocity_m_s": pad_velocity - track.at("velocity", times) - speed,
            "pad_ned_velocity_m_s": pad_velocity - over_ground,
            "pad_heading_rad": (turned + np.pi) % (2.0 * np.pi) - np.pi,
            "pad_covariance": np.array(covariances).reshape(-1, 9, 9),
            "seen_for_s": _seen_for(pads, times),
        }


def _vehicle_errors(
    vehicles: Sequence[VehicleState], track: TruthTrack, times: FloatArray
) -> dict[str, FloatArray]:
    rotations = [
        rotation_vector(quat_multiply(_quaternion(true), quat_conjugate(vehicle.attitude)))
        for true, vehicle in zip(track.at("attitude", times), vehicles, strict=True)
    ]
    velocity = np.array([v.velocity_ned_m_s for v in vehicles]).reshape(-1, 3)
    position = np.array([_from_home(v) for v in vehicles]).reshape(-1, 3)
    return {
        "rotation_rad": np.array(rotations).reshape(-1, 3),
        "velocity_m_s": track.at("velocity", times) - velocity,
        "position_m": track.at("position", times) - position,
    }


def _quaternion(values: FloatArray) -> tuple[float, float, float, float]:
    w, x, y, z = values.tolist()
    return (w, x, y, z)


def _from_home(vehicle: VehicleState) -> FloatArray:
    """The EKF counts from its first fix, the world from home."""
    if vehicle.origin is None:
        return np.full(3, np.nan)
    return np.add(vehicle.position_ned_m, ned_from_geodetic(*vehicle.origin, HOME))


def _seen_for(pads: Sequence[PadState | None], times: FloatArray) -> FloatArray:
    """As in the result contract: in view without a gap of half a second."""
    spans, since = np.full(len(pads), np.nan), None
    for row, (pad, time_s) in enumerate(zip(pads, times.tolist(), strict=True)):
        if pad is None or time_s - pad.seen_time_s > SEEN_GAP_S:
            since = None
            continue
        since = time_s if since is None else since
        spans[row] = time_s - since
    return spans


# ---------------------------------------------------------------- command line


def stream_path(folder: Path, scenario: str, seed: int) -> Path:
    """Where a stream is kept."""
    return folder / f"{scenario}_{seed}.pickle"


def _make(scenario: str, seed: int, folder: Path) -> str:
    path = stream_path(folder, scenario, seed)
    if not path.exists():
        save(fly_stream(Trial.load(scenario, seed)), path)
    return str(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point: fly what the folder does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--scenarios", nargs="+", default=["figure_8"])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--folder", type=Path, required=True)
    chosen = parser.parse_args(arguments)
    with ProcessPoolExecutor(chosen.jobs) as pool:
        waiting = [
            pool.submit(_make, scenario, seed, chosen.folder)
            for scenario in chosen.scenarios
            for seed in range(chosen.seeds)
        ]
        for future in waiting:
            print(future.result(), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
