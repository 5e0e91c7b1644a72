"""The estimators' figures over many flights, and which of their bars hold."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from benchmarks.state.consistency import Consistency, band, consistency, nees
from benchmarks.state.fault_flights import LARGEST_ATTITUDE_DEG, RECOVERY_S, FaultFlight, usual_for
from benchmarks.state.samples import Samples, rms
from benchmarks.state.streams import INPUTS, Stream, feed, new_estimator
from companion.base.clock import wall_clock_s
from companion.base.geometry import FloatArray
from companion.config import CompanionConfig
from companion.estimate.pad.pad_filter import PadFilter
from companion.estimate.pad.pad_types import PadMeasurement
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import ImuStep
from companion.sim.trial import Trial

PAD_SCENARIO: Final = "figure_8"  # the bars are for this one, and it flies under more vibration, too
VIBRATION: Final = (1.0, 2.0, 4.0)
ATTITUDE_DEG: Final = {1.0: 1.0, 2.0: 1.2, 4.0: 2.0}  # by the vibration
VELOCITY_M_S: Final = 0.10
PAD_VELOCITY_M_S: Final = 0.10
STEP_US: Final = 100.0
SEEN_S: Final = 2.0
COST_BARS: Final = ("EKF: predict + IMU update", "pad filter: predict + sighting")


@dataclass(frozen=True, slots=True)
class FlightCase:
    """A scenario, under so many times its usual vibration."""

    scenario: str
    vibration: float = 1.0

    @property
    def name(self) -> str:
        """For tables."""
        return self.scenario if self.vibration == 1.0 else f"{self.scenario}, {self.vibration:g} x vibration"

    @property
    def slug(self) -> str:
        """For files."""
        return self.scenario if self.vibration == 1.0 else f"{self.scenario}_x{self.vibration:g}"

    @property
    def attitude_bar_deg(self) -> float | None:
        """None: not judged."""
        return ATTITUDE_DEG.get(self.vibration) if self.scenario == PAD_SCENARIO else None

    def trial(self, seed: int) -> Trial:
        """One flight of it."""
        trial = Trial.load(self.scenario, seed)
        sensors = trial.scenario.sensors.model_copy(update={"vibration_factor": self.vibration})
        return replace(trial, scenario=trial.scenario.model_copy(update={"sensors": sensors}))


def cases_of(scenarios: Sequence[str], vibration: Sequence[float]) -> list[FlightCase]:
    """Each scenario as it is; the one with the bars under every vibration."""
    cases = []
    for scenario in scenarios:
        factors = vibration if scenario == PAD_SCENARIO else (1.0,)
        cases += [FlightCase(scenario, factor) for factor in factors]
    return cases


@dataclass(frozen=True)
class FlightErrors:
    """One flight in the air, and while the pad has been seen for 2 s."""

    case: FlightCase
    seed: int
    outcome: str
    samples: Samples

    @property
    def air(self) -> Samples:
        """From take-off to touchdown."""
        return self.samples.where(self.samples.airborne)

    @property
    def seen(self) -> Samples:
        """The pad in view for 2 s at least."""
        return self.air.where(self.air.seen_for_s >= SEEN_S)


def pooled(parts: Sequence[Samples], value: Callable[[Samples], FloatArray]) -> float:
    """Root mean square over the samples of several flights."""
    return rms(np.concatenate([value(part) for part in parts]))


# ---------------------------------------------------------------- consistency


def consistencies(flights: Sequence[FlightErrors]) -> dict[str, Consistency]:
    """The NEES of both filters, whole and in parts."""
    air, seen = [flight.air for flight in flights], [flight.seen for flight in flights]
    return {
        name: consistency(last - first, [nees_of(part, first, last) for part in parts])
        for name, nees_of, parts, first, last in (
            ("EKF: rotation", _vehicle_nees, air, 0, 3),
            ("EKF: velocity", _vehicle_nees, air, 3, 6),
            ("EKF: rotation, velocity", _vehicle_nees, air, 0, 6),
            ("EKF: rotation, velocity, position", _vehicle_nees, air, 0, 9),
            ("pad: relative position", _pad_nees, seen, 0, 3),
            ("pad: relative velocity", _pad_nees, seen, 3, 6),
            ("pad: relative position, velocity", _pad_nees, seen, 0, 6),
        )
    }


def _vehicle_nees(s: Samples, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    errors = np.hstack([s.rotation_rad, s.velocity_m_s, s.position_m])[:, first:last]
    return _since_start(s), nees(errors, s.covariance[:, first:last, first:last])


def _pad_nees(s: Samples, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    errors = np.hstack([s.pad_position_m, s.pad_velocity_m_s])[:, first:last]
    return _since_start(s), nees(errors, s.pad_covariance[:, first:last, first:last])


def _since_start(s: Samples) -> FloatArray:
    return s.time_s - s.time_s[0] if len(s.time_s) else s.time_s


# ---------------------------------------------------------------- bars


def bars(
    flights: Sequence[FlightErrors], by_case: dict[FlightCase, dict[str, Consistency]]
) -> dict[str, bool]:
    """Which bars hold; of figure-8 one by one for each vibration."""
    held: dict[str, bool] = {}
    for case, figures in by_case.items():
        bar_deg = case.attitude_bar_deg
        if bar_deg is None:
            continue
        own = [flight for flight in flights if flight.case == case]
        air, seen = [flight.air for flight in own], [flight.seen for flight in own]
        words = {
            "attitude": pooled(air, lambda s: s.attitude_deg) <= bar_deg,
            "velocity": pooled(air, lambda s: s.velocity_m_s) <= VELOCITY_M_S,
            "pad velocity": pooled(seen, lambda s: s.pad_ned_velocity_m_s) <= PAD_VELOCITY_M_S,
            "EKF NEES": figures["EKF: rotation, velocity"].holds,
            "pad NEES": figures["pad: relative position, velocity"].holds,
        }
        held |= {f"{name} at {case.vibration:g} x": holds for name, holds in words.items()}
    return held


def fault_bars(flights: Sequence[FaultFlight]) -> dict[str, bool]:
    """No divergence, recovery in time and a landing, whatever the fault."""
    faulted = [flight for flight in flights if flight.case.fault is not None]
    recoveries = [max(flight.recovery_s(usual_for(flight, flights)).values()) for flight in faulted]
    return {
        "no divergence": all(f.largest_since_fault()["attitude °"] < LARGEST_ATTITUDE_DEG for f in faulted),
        "recovery": all(time_s <= RECOVERY_S for time_s in recoveries),
        "landings with faults": all(flight.outcome == "landed" for flight in faulted),
    }


def cost_bars(costs: Costs) -> dict[str, bool]:
    """The two steps that have a bar."""
    return {"cost": all(costs.median_us[kind] <= STEP_US for kind in COST_BARS)}


# ---------------------------------------------------------------- costs
# What one step of each filter costs on this machine, measured over a recorded flight in one process.


@dataclass(frozen=True)
class Costs:
    """Medians in µs of one call, by kind; `all_ms_per_s`: all inputs of a second of flight, in ms."""

    median_us: dict[str, float]
    calls: dict[str, int]
    all_ms_per_s: float


def measure(stream: Stream, config: CompanionConfig, passes: int = 3) -> Costs:
    """Run the estimator over the stream with its filters' steps timed."""
    spent_s: defaultdict[str, list[float]] = defaultdict(list)
    inputs = [event for event in stream.events if event.topic in INPUTS]
    seconds = inputs[-1].arrival_s - inputs[0].arrival_s
    totals = []
    for _ in range(passes):
        estimator = new_estimator(config)
        started_s = wall_clock_s()
        for event in inputs:
            feed(estimator, event)
        totals.append(wall_clock_s() - started_s)
    with _timed(VehicleEkf, _ekf_kind, spent_s), _timed(PadFilter, _pad_kind, spent_s):
        for _ in range(passes):
            estimator = new_estimator(config)
            for event in inputs:
                feed(estimator, event)
    return Costs(
        median_us={kind: 1e6 * median(values) for kind, values in sorted(spent_s.items())},
        calls={kind: len(values) // passes for kind, values in spent_s.items()},
        all_ms_per_s=1e3 * median(totals) / seconds,
    )


def _ekf_kind(item: Any) -> str:
    if not isinstance(item, ImuStep):
        return "EKF: predict + GPS update"
    if item.still or item.at_rest:
        return "EKF: predict + IMU update, standing"
    if item.field_body_ut is None and item.attitude is None:
        return "EKF: predict + IMU update"
    return "EKF: predict + IMU, magnetometer or orientation update"


def _pad_kind(item: Any) -> str:
    return f"pad filter: predict + {'sighting' if isinstance(item, PadMeasurement) else 'echo'}"


@contextmanager
def _timed(
    owner: type[Any], kind_of: Callable[[Any], str], spent_s: dict[str, list[float]]
) -> Iterator[None]:
    """While inside, each `apply(time_s, item)` of the class is timed."""
    apply: Callable[..., None] = owner.apply

    def timed(self: Any, time_s: float, item: Any) -> None:
        started_s = wall_clock_s()
        apply(self, time_s, item)
        spent_s[kind_of(item)].append(wall_clock_s() - started_s)

    owner.apply = timed
    try:
        yield
    finally:
        owner.apply = apply


# ---------------------------------------------------------------- tables
# The tables of the estimators' bench: figures beside their bars.


def error_table(flights: Sequence[FlightErrors]) -> Table:
    """A row a scenario: root mean squares over all its flights, the worst flight's beside them."""
    grid = Table(title="Estimates against the truth, from take-off to touchdown: all flights (worst flight)")
    grid.add_column("scenario")
    for heading in (
        "flights (landed)",
        "attitude °",
        "bar",
        "inclination °",
        "heading °",
        f"velocity m/s (<= {VELOCITY_M_S:g})",
        "position m",
        f"pad velocity m/s (<= {PAD_VELOCITY_M_S:g})",
        "pad position m",
    ):
        grid.add_column(heading, justify="right")
    for case in dict.fromkeys(flight.case for flight in flights):
        own = [flight for flight in flights if flight.case == case]
        bar_deg = case.attitude_bar_deg
        landed = sum(flight.outcome == "landed" for flight in own)
        air, seen = [flight.air for flight in own], [flight.seen for flight in own]
        grid.add_row(
            case.name,
            f"{len(own)} ({landed})",
            _both(air, lambda s: s.attitude_deg),
            "" if bar_deg is None else f"{bar_deg:g}",
            _both(air, lambda s: s.inclination_deg),
            _both(air, lambda s: s.heading_deg),
            _both(air, lambda s: s.velocity_m_s, digits=3),
            _both(air, lambda s: s.position_m),
            _both(seen, lambda s: s.pad_ned_velocity_m_s, digits=3),
            _both(seen, lambda s: s.pad_position_m, digits=3),
        )
    return grid


def _both(parts: Sequence[Samples], value: Callable[[Samples], FloatArray], digits: int = 2) -> str:
    worst = max((r for part in parts if np.isfinite(r := rms(value(part)))), default=float("nan"))
    return f"{pooled(parts, value):.{digits}f} ({worst:.{digits}f})"


def consistency_table(by_case: dict[FlightCase, dict[str, Consistency]]) -> Table:
    """Mean NEES beside its band; how much of the time the mean over the flights lies in its own."""
    grid = Table(title="Consistency: normalised estimation error squared, mean over flights and time")
    for heading in ("scenario", "error", "states", "mean NEES", "95 % band", "time in the band"):
        grid.add_column(heading, justify="left" if heading in {"scenario", "error"} else "right")
    for case, figures in by_case.items():
        for name, c in figures.items():
            inside = f"{100 * c.share_inside:.0f} %"
            bounds = f"{c.low:.2f} to {c.high:.2f}"
            grid.add_row(case.name, name, str(c.dimension), f"{c.mean:.2f}", bounds, inside)
        grid.add_section()
    return grid


def fault_table(flights: Sequence[FaultFlight]) -> Table:
    """A row a fault: the worst of its seeds."""
    grid = Table(
        title="Faults in closed loop, the worst of the seeds: largest error since (back to usual after)"
    )
    grid.add_column("fault")
    names = ("attitude °", "velocity m/s", "pad m", "pad m/s")
    attitude = f"attitude ° (< {LARGEST_ATTITUDE_DEG:g}; <= {RECOVERY_S:g} s)"
    for heading in ("landed", attitude, *names[1:]):
        grid.add_column(heading, justify="right")
    for case in dict.fromkeys(flight.case.name for flight in flights):
        own = [flight for flight in flights if flight.case.name == case]
        landed = f"{sum(flight.outcome == 'landed' for flight in own)}/{len(own)}"
        grid.add_row(case, landed, *(_worst(own, flights, name) for name in names))
    return grid


def _worst(own: Sequence[FaultFlight], flights: Sequence[FaultFlight], name: str) -> str:
    if name not in own[0].largest_since_fault():
        return "-"
    largest = f"{max(flight.largest_since_fault()[name] for flight in own):.2f}"
    if own[0].case.fault is None:
        return largest
    back_s = max(flight.recovery_s(usual_for(flight, flights))[name] for flight in own)
    return f"{largest} ({back_s:.1f} s)" if np.isfinite(back_s) else f"{largest} (never)"


def cost_table(costs: Costs) -> Table:
    """A row a kind of step."""
    grid = Table(title=f"Costs; all inputs together {costs.all_ms_per_s:.0f} ms a second of flight")
    grid.add_column("step")
    for heading in ("median µs", "bar", "calls"):
        grid.add_column(heading, justify="right")
    for kind, microseconds in costs.median_us.items():
        bar = f"<= {STEP_US:g}" if kind in COST_BARS else ""
        grid.add_row(kind, f"{microseconds:.0f}", bar, str(costs.calls[kind]))
    return grid


# ---------------------------------------------------------------- pictures
# Pictures of the estimators' errors: with the filters' own 3-sigma bands, and the NEES over time.

AXES: Final = ("north", "east", "down")


def draw_errors(samples: Samples, title: str, path: Path) -> None:
    """One flight's errors, a row a quantity, a column an axis, each within its ±3 sigma band."""
    air = samples.where(samples.airborne)
    degrees = 180.0 / np.pi
    rows: list[tuple[str, FloatArray, FloatArray, float]] = [
        ("attitude °", air.rotation_rad, air.covariance[:, 0:3, 0:3], degrees),
        ("velocity m/s", air.velocity_m_s, air.covariance[:, 3:6, 3:6], 1.0),
        ("position m", air.position_m, air.covariance[:, 6:9, 6:9], 1.0),
        ("pad, relative position m", air.pad_position_m, air.pad_covariance[:, 0:3, 0:3], 1.0),
        ("pad, relative velocity m/s", air.pad_velocity_m_s, air.pad_covariance[:, 3:6, 3:6], 1.0),
    ]
    figure = Figure(figsize=(12.0, 12.0), layout="constrained")
    grid: Any = figure.subplots(len(rows), 3, sharex=True)
    for line, (name, errors, covariances, factor) in enumerate(rows):
        for axis in range(3):
            three_sigma = 3.0 * factor * np.sqrt(covariances[:, axis, axis])
            plot = grid[line, axis]
            plot.fill_between(air.time_s, -three_sigma, three_sigma, color="0.85", label="±3 σ")
            plot.plot(air.time_s, factor * errors[:, axis], lw=0.9, label="error")
            _limit(plot, factor * errors[:, axis])
            plot.set_title(f"{name}, {AXES[axis]}", fontsize=9)
    grid[0, 0].legend(fontsize=8)
    for plot in grid[-1]:
        plot.set_xlabel("s")
    _save(figure, title, path)


def _limit(plot: Any, errors: FloatArray) -> None:
    """A band that opens wide, unseen, shall not hide the error."""
    largest = np.nanmax(np.abs(errors), initial=0.0) if np.isfinite(errors).any() else 1.0
    low, high = plot.get_ylim()
    reach = min(max(abs(low), abs(high)), 4.0 * max(largest, 1e-3))
    plot.set_ylim(-reach, reach)


def draw_consistency(figures: dict[str, Consistency], title: str, path: Path) -> None:
    """The mean NEES of all flights over time, each kind with the band in which 95 % should lie."""
    figure = Figure(figsize=(10.0, 2.4 * len(figures)), layout="constrained")
    grid: Any = figure.subplots(len(figures), 1, squeeze=False)
    for plot, (name, kind) in zip(grid[:, 0], figures.items(), strict=True):
        if len(kind.count):
            low, high = band(kind.dimension, kind.count)
            plot.fill_between(kind.time_s, low, high, color="0.85")
        plot.plot(kind.time_s, kind.by_time, lw=0.9)
        plot.axhline(kind.dimension, color="0.5", lw=0.6)
        plot.set_yscale("log")
        plot.set_title(f"{name}: mean {kind.mean:.2f}, band {kind.low:.2f} to {kind.high:.2f}", fontsize=9)
    grid[-1, 0].set_xlabel("s since take-off, or since the pad has been in view for 2 s")
    _save(figure, title, path)


def draw_faults(curves: Sequence[tuple[str, FloatArray, FloatArray, FloatArray]], path: Path) -> None:
    """Attitude and velocity errors of faulted flights: name, times (n,), ° (n,), m/s (n,)."""
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for name, times, attitude, velocity in curves:
        upper.plot(times, attitude, lw=0.8, label=name)
        lower.plot(times, velocity, lw=0.8, label=name)
    upper.set_ylabel("attitude error °")
    lower.set_ylabel("velocity error m/s")
    lower.set_xlabel("s")
    upper.legend(fontsize=7, ncols=2)
    _save(figure, "faults", path)


def _save(figure: Figure, title: str, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.suptitle(title)
    figure.savefig(path, dpi=90)
