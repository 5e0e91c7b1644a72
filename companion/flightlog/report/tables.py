"""The table at the end of a simulated flight."""

from collections.abc import Mapping
from typing import Final

from rich.table import Table

from companion.base.units import without_unit
from companion.flightlog.result import PhaseTimes, Result

# decimals that mean something: a landing is not repeated to the tenth of a millimetre or of a millisecond
DECIMALS: Final = {"m": 3, "m/s": 2, "°": 1, "ms": 0}
MOST_DECIMALS: Final = 6


def result_table(result: Result, bounds: Mapping[str, float]) -> Table:
    """The result as a table for the terminal; `bounds` maps the touchdown's keys to what passes."""
    title = f"{result.scenario}, seed {result.seed}: {result.outcome}"
    table = Table(title=title, title_justify="left")
    table.add_column("")
    table.add_column("measured", justify="right")
    table.add_column("passes at", justify="right")
    for row in result_rows(result, bounds):
        table.add_row(*row)
    return table


def flight_texts(time: PhaseTimes, frames_with_pad: int, frames: int) -> dict[str, str]:
    """What is known of every flight; a dash for a stage that was never reached."""
    stages_s = (time.search_s, time.approach_s, time.descent_s)
    stages = " / ".join(f"{seconds:.1f}" if seconds > 0.0 else "-" for seconds in stages_s)
    return {
        "search / approach / descent": f"{stages} s",
        "whole flight": f"{time.total_s:.1f} s",
        "frames with the pad": f"{frames_with_pad} of {frames}",
    }


def result_rows(result: Result, bounds: Mapping[str, float]) -> list[tuple[str, str, str]]:
    """Name, measured value and bound ("" for none), in this order, with units."""
    rows: list[tuple[str, str, str]] = []
    if result.touchdown is not None:
        for key, value in result.touchdown.model_dump().items():
            name, unit = without_unit(key)
            bound = bounds.get(key)
            limit = "" if bound is None else f"<= {bound:g} {unit}"
            rows.append((f"touchdown {name}", figure(value, unit, bound), limit))
    texts = {
        "pad speed": f"{result.pad.speed_m_s:.2f} m/s",
        **flight_texts(result.time, result.vision.frames_with_pad, result.vision.frames),
        "sighting error (rms)": _optional(result.vision.relative_position_rmse_m, "m"),
        "attitude error (rms)": _optional(result.estimate.attitude_rmse_deg, "°"),
        "velocity error (rms)": _optional(result.estimate.velocity_rmse_m_s, "m/s"),
        "pad velocity error (rms)": _optional(result.estimate.pad_velocity_rmse_m_s, "m/s"),
        "exposure to setpoint": _optional(result.latency_ms.exposure_to_setpoint_p50, "ms", " (median)"),
        "control cycles late": _optional(result.latency_ms.cycle_late_p99, "ms", " (p99)"),
        "control cycles unsolved": f"{result.control.unsolved} of {result.control.cycles}",
        "simulated / real time": f"{result.sim.real_time_factor:.1f}",
    }
    return rows + [(name, text, "") for name, text in texts.items()]


def figure(value: float, unit: str, bound: float | None = None) -> str:
    """A value with its unit and the decimals that mean something.

    It has more of them where it would otherwise seem to be on the other side of its bound.
    """
    decimals = DECIMALS.get(unit, 3)
    while (
        bound is not None and decimals < MOST_DECIMALS and (round(value, decimals) > bound) != (value > bound)
    ):
        decimals += 1
    return f"{value:.{decimals}f} {unit}"


def _optional(value: float | None, unit: str, how: str = "") -> str:
    return "-" if value is None else f"{figure(value, unit)}{how}"
