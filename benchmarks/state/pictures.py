"""Pictures of the estimators' errors: with the filters' own 3-sigma bands, and the NEES over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.state.consistency import Consistency, band
from benchmarks.state.samples import Samples
from companion.base.geometry import FloatArray

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
