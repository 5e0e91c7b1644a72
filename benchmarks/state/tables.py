"""The tables of the estimators' bench: figures beside their bars."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from rich.table import Table

from benchmarks.state.consistency import Consistency
from benchmarks.state.costs import Costs
from benchmarks.state.fault_flights import LARGEST_ATTITUDE_DEG, RECOVERY_S, FaultFlight, usual_for
from benchmarks.state.figures import (
    COST_BARS,
    PAD_VELOCITY_M_S,
    STEP_US,
    VELOCITY_M_S,
    FlightCase,
    FlightErrors,
    pooled,
)
from benchmarks.state.samples import Samples, rms
from companion.base.geometry import FloatArray


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
