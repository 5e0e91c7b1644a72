"""What a flight came to: the result contract (`--json`), computed from the flight log and the truth.

All values are SI unless the name says otherwise. PhaseTimes are those of the app's clock, counted from the
start of the flight. Only `sim.real_time_factor` depends on the machine.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict

from companion.base.geometry import FloatArray
from companion.base.messages import (
    ContactResult,
    ControlReport,
    FrameReport,
    Outcome,
    PadSighting,
    Phase,
    PlanStep,
    Setpoint,
    Truth,
)
from companion.flightlog.errors import TruthTrack, estimate_errors, sighting_errors_body_m

_DIGITS: Final = 6
_TIME_FIELDS: Final = ("time_s", "seen_time_s", "exposure_time_s", "received_s", "done_s")


class ResultPart(BaseModel):
    """A part of a result contract."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FirstContact(ResultPart):
    """The moment of the first contact, relative to the pad and by truth."""

    lateral_error_m: float
    vertical_speed_m_s: float
    horizontal_speed_m_s: float
    tilt_deg: float
    yaw_error_deg: float


class PadResult(ResultPart):
    """The pad's own speed at touchdown (or at the end)."""

    speed_m_s: float


class PhaseTimes(ResultPart):
    """How long the phases took."""

    search_s: float
    approach_s: float
    descent_s: float
    total_s: float


class CameraResult(ResultPart):
    """What the camera gave; the error is the sightings', before any filter."""

    frames: int
    frames_with_pad: int
    relative_position_rmse_m: float | None


class EstimateResult(ResultPart):
    """Estimates against the truth while airborne."""

    attitude_rmse_deg: float | None
    velocity_rmse_m_s: float | None
    pad_velocity_rmse_m_s: float | None


class Latency(ResultPart):
    """From a frame's mid-exposure to the first setpoint that used it; how late control cycles began."""

    exposure_to_setpoint_p50: float | None
    exposure_to_setpoint_p99: float | None
    cycle_late_p50: float | None = None
    cycle_late_p99: float | None = None


class ControlResult(ResultPart):
    """How the tracker fared: its cycles, those without a solution, and how often what left was cut."""

    cycles: int = 0
    unsolved: int = 0
    late: int = 0
    stopped: int = 0
    blind: int = 0
    limited: int = 0
    iterations_p99: float | None = None


class SimResult(ResultPart):
    """How fast the simulation ran."""

    real_time_factor: float


class ResultEvent(ResultPart):
    """Something that happened."""

    time_s: float
    kind: str
    text: str


class Result(ResultPart):
    """The whole contract."""

    scenario: str
    seed: int
    as_built: dict[str, float | list[float]] | None = None
    outcome: Outcome
    touchdown: FirstContact | None
    contacts: tuple[ContactResult, ...] = ()
    pad: PadResult
    time: PhaseTimes
    vision: CameraResult
    estimate: EstimateResult
    latency_ms: Latency
    control: ControlResult = ControlResult()
    sim: SimResult
    events: tuple[ResultEvent, ...]


def from_start(
    kept: Mapping[str, Sequence[Any]], truth: Sequence[Truth]
) -> tuple[dict[str, list[Any]], list[Truth]]:
    """The same messages with all times counted from the app's first cycle (its first plan)."""
    begun_s = start_s(kept, truth)
    topics = {topic: [_earlier(message, begun_s) for message in messages] for topic, messages in kept.items()}
    return topics, [_earlier(record, begun_s) for record in truth]


def start_s(kept: Mapping[str, Sequence[Any]], truth: Sequence[Truth]) -> float:
    plans = kept.get("plan", ())
    return float(plans[0].time_s if plans else truth[0].time_s)


def _earlier(message: Any, shift_s: float) -> Any:
    """A copy of a message with its times less `shift_s`."""
    times = {name: getattr(message, name, None) for name in _TIME_FIELDS}
    return replace(
        message, **{name: time_s - shift_s for name, time_s in times.items() if time_s is not None}
    )


def build_result(
    *,
    scenario: str,
    seed: int,
    outcome: Outcome,
    touchdown: Mapping[str, float] | None,
    pad_speed_m_s: float,
    kept: Mapping[str, Sequence[Any]],
    truth: Sequence[Truth],
    real_time_factor: float,
    contacts: Sequence[ContactResult] = (),
    as_built: Mapping[str, float | list[float]] | None = None,
) -> Result:
    """Put the contract together from the log's kept topics and the simulator's truth.

    PhaseTimes are taken as they are: `from_start` makes them count from the flight's start.

    Raises:
        ValueError: fewer than two records of truth.
    """
    track = TruthTrack(truth)
    return Result(
        scenario=scenario,
        seed=seed,
        as_built=None if as_built is None else dict(as_built),
        outcome=outcome,
        touchdown=None
        if touchdown is None
        else FirstContact(**{k: six_decimals(v) for k, v in touchdown.items()}),
        contacts=tuple(map(_rounded, contacts)),
        pad=PadResult(speed_m_s=six_decimals(pad_speed_m_s)),
        time=phase_times(kept.get("plan", ())),
        vision=_vision(kept.get("frame_report", ()), kept.get("sighting", ()), track),
        estimate=_estimate(kept, track),
        latency_ms=latency(kept.get("setpoint", ()), kept.get("control_report", ())),
        control=control_result(kept.get("control_report", ())),
        sim=SimResult(real_time_factor=round(real_time_factor, 2)),
        events=tuple(
            ResultEvent(time_s=six_decimals(notice.time_s), kind=notice.kind, text=notice.text)
            for notice in kept.get("notice", ())
        ),
    )


def six_decimals(value: float) -> float:
    """As a contract states it."""
    return round(float(value), _DIGITS)


def _rounded(contact: ContactResult) -> ContactResult:
    numbers: dict[str, Any] = {k: six_decimals(v) for k, v in asdict(contact).items() if isinstance(v, float)}
    north, east, down = map(six_decimals, contact.position_ned_m)
    return replace(contact, **numbers, position_ned_m=(north, east, down))


def phase_times(plans: Sequence[PlanStep]) -> PhaseTimes:
    """Seconds spent searching, approaching and descending, and in all."""
    spent: dict[Phase, float] = dict.fromkeys(Phase, 0.0)
    for now, following in pairwise(plans):
        spent[now.phase] += following.time_s - now.time_s
    total = plans[-1].time_s - plans[0].time_s if plans else 0.0
    return PhaseTimes(
        search_s=six_decimals(spent[Phase.SEARCH]),
        approach_s=six_decimals(spent[Phase.APPROACH]),
        descent_s=six_decimals(spent[Phase.DESCEND] + spent[Phase.TOUCHDOWN]),
        total_s=six_decimals(total),
    )


def control_result(reports: Sequence[ControlReport]) -> ControlResult:
    iterations = [report.iterations for report in reports]
    return ControlResult(
        cycles=len(reports),
        unsolved=sum(not report.solved for report in reports),
        late=sum(report.late for report in reports),
        stopped=sum(report.stopped for report in reports),
        blind=sum(report.blind for report in reports),
        limited=sum(bool(report.limited) for report in reports),
        iterations_p99=six_decimals(np.percentile(iterations, 99)) if iterations else None,
    )


def _vision(
    reports: Sequence[FrameReport], sightings: Sequence[PadSighting], track: TruthTrack
) -> CameraResult:
    return CameraResult(
        frames=len(reports),
        frames_with_pad=sum(report.seen for report in reports),
        relative_position_rmse_m=_rms(sighting_errors_body_m(sightings, track)[1]),
    )


def _estimate(kept: Mapping[str, Sequence[Any]], track: TruthTrack) -> EstimateResult:
    errors = estimate_errors(kept, track)
    return EstimateResult(
        attitude_rmse_deg=_rms(errors["attitude_deg"][:, None]),
        velocity_rmse_m_s=_rms(errors["velocity_m_s"]),
        pad_velocity_rmse_m_s=_rms(errors["pad_velocity_m_s"]),
    )


def _rms(rows: FloatArray) -> float | None:
    """Root mean square of the rows' lengths; None without rows."""
    return six_decimals(math.sqrt(float(np.mean(np.sum(rows**2, axis=1))))) if len(rows) else None


def latency(setpoints: Sequence[Setpoint], reports: Sequence[ControlReport] = ()) -> Latency:
    """Milliseconds from a frame's exposure to the first setpoint that used it, and of the cycles' delay."""
    exposure_p50, exposure_p99 = _percentiles_ms(setpoint_delays_s(setpoints))
    late_p50, late_p99 = _percentiles_ms([report.cycle_late_s for report in reports])
    return Latency(
        exposure_to_setpoint_p50=exposure_p50,
        exposure_to_setpoint_p99=exposure_p99,
        cycle_late_p50=late_p50,
        cycle_late_p99=late_p99,
    )


def setpoint_delays_s(setpoints: Sequence[Setpoint]) -> list[float]:
    """Seconds from each frame's exposure to the first setpoint that used it."""
    first: dict[float, float] = {}
    for setpoint in setpoints:
        if setpoint.exposure_time_s is not None:
            first.setdefault(setpoint.exposure_time_s, setpoint.time_s)
    return [sent - exposed for exposed, sent in first.items()]


def _percentiles_ms(delays_s: Sequence[float]) -> tuple[float, float] | tuple[None, None]:
    if not delays_s:
        return None, None
    p50, p99 = np.percentile(1e3 * np.array(delays_s), [50, 99])
    return round(float(p50), 3), round(float(p99), 3)
