"""Fig. 13: the EKF's position beside the GPS's and the truth, over a flight and zoomed into.

Section 7.2's sensors (MPU9250 and a 5 Hz NEO-6M) in a simulated flight, and this project's 31-state EKF. A
position by GPS is off by a metre and more that wanders over a minute, and by noise on top that differs from
fix to fix. No other sensor here knows the first, so how far off the EKF's place is as a whole is the luck of
where the wander was when it aligned: reported, without a bar. Judged is what an observer can do: the path
(the error about its mean over the flight) and the noise (the error's steps from one fix to the next).

NED from the simulator's home, m and s.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from companion.base.geometry import FloatArray, ned_from_geodetic
from companion.base.messages import GpsFix, VehicleState
from companion.config import ConfigError
from companion.flightlog.errors import TruthTrack
from experiments.flown import EndedFlight

mpl.use("Agg")

AXES: Final = ("north", "east", "down")
ZOOM_S: Final = 6.0
# of the fixes' own, on every axis
LARGEST_PATH_RATIO: Final = 1.0
LARGEST_NOISE_RATIO: Final = 0.25
TRUTH_COLOUR: Final = "black"
GPS_COLOUR: Final = "#d68910"
EKF_COLOUR: Final = "#2471a3"


@dataclass(frozen=True, slots=True)
class PositionTrack:
    """Positions (n, 3) at times (n,), and their errors against the truth (n, 3)."""

    time_s: FloatArray
    position_m: FloatArray
    error_m: FloatArray

    def rmse_m(self) -> FloatArray:
        """Root mean square error of each axis (3,)."""
        rmse: FloatArray = np.sqrt(np.mean(self.error_m**2, axis=0))
        return rmse

    def worst_m(self) -> FloatArray:
        """Greatest error of each axis (3,)."""
        worst: FloatArray = np.abs(self.error_m).max(axis=0)
        return worst

    def mean_m(self) -> FloatArray:
        """Mean error of each axis (3,): where the whole path is, against where it was flown."""
        mean: FloatArray = self.error_m.mean(axis=0)
        return mean

    def path_m(self) -> FloatArray:
        """Root mean square of the error about its mean, of each axis (3,)."""
        spread: FloatArray = self.error_m.std(axis=0)
        return spread

    def noise_m(self, at_s: FloatArray) -> FloatArray:
        """Root mean square step of the error from one of these times to the next, of each axis (3,)."""
        errors = np.stack([np.interp(at_s, self.time_s, column) for column in self.error_m.T], axis=1)
        noise: FloatArray = np.sqrt(np.mean(np.diff(errors, axis=0) ** 2, axis=0))
        return noise


@dataclass(frozen=True, slots=True)
class Observed:
    """One flight in the air: the fixes, the EKF and the truth."""

    gps: PositionTrack
    ekf: PositionTrack
    truth: TruthTrack
    title: str

    def holds(self) -> bool:
        """Whether the EKF keeps both bars on every axis."""
        noise = self.ekf.noise_m(self.gps.time_s) <= LARGEST_NOISE_RATIO * self.gps.noise_m(self.gps.time_s)
        path = self.ekf.path_m() <= LARGEST_PATH_RATIO * self.gps.path_m()
        return bool(noise.all() and path.all())


def observe(flown: EndedFlight) -> Observed:
    """Positions of a flight from take-off to contact.

    Raises:
        ConfigError: the flight never got into the air.
    """
    airborne = [record.time_s for record in flown.truth if not record.in_contact]
    if not airborne:
        raise ConfigError(f"{flown.result.scenario}: never got into the air; expected a flight")
    began_s, ended_s = airborne[0], flown.contact_s() or airborne[-1]
    truth = TruthTrack(flown.truth)
    fixes: list[GpsFix] = [f for f in flown.kept["gps"] if began_s <= f.time_s <= ended_s]
    states: list[VehicleState] = [v for v in flown.kept["vehicle"] if began_s <= v.time_s <= ended_s]
    gps = [ned_from_geodetic(f.latitude_deg, f.longitude_deg, f.altitude_m, flown.home) for f in fixes]
    ekf = [
        np.add(v.position_ned_m, ned_from_geodetic(*v.origin, flown.home))
        for v in states
        if v.origin is not None
    ]
    times = [v.time_s for v in states if v.origin is not None]
    title = f"{flown.result.scenario}, seed {flown.result.seed}"
    return Observed(_track([f.time_s for f in fixes], gps, truth), _track(times, ekf, truth), truth, title)


def _track(times_s: list[float], positions: list[Any], truth: TruthTrack) -> PositionTrack:
    times, rows = np.array(times_s), np.array(positions, dtype=float).reshape(-1, 3)
    return PositionTrack(times, rows, rows - truth.at("position", times))


def table(observed: Observed) -> Table:
    """RMSE, worst, path and noise of both, beside the bars."""
    made = Table(title=f"Fig. 13, {observed.title}: position error (m)", title_justify="left")
    for name in ("", *AXES):
        made.add_column(name, justify="right" if name else "left")
    gps, ekf, fixes_s = observed.gps, observed.ekf, observed.gps.time_s
    for name, row in (
        ("GPS, RMSE", gps.rmse_m()),
        ("EKF, RMSE", ekf.rmse_m()),
        ("GPS, mean", gps.mean_m()),
        ("EKF, mean", ekf.mean_m()),
        ("GPS, worst", gps.worst_m()),
        ("EKF, worst", ekf.worst_m()),
        ("GPS, path", gps.path_m()),
        (f"EKF, path (bar: {LARGEST_PATH_RATIO:g} of the GPS's)", ekf.path_m()),
        ("GPS, step from fix to fix", gps.noise_m(fixes_s)),
        (f"EKF, step (bar: {LARGEST_NOISE_RATIO:g} of the GPS's)", ekf.noise_m(fixes_s)),
    ):
        made.add_row(name, *(f"{value:.3f}" for value in row))
    return made


EXPLANATION: Final = (
    "RMSE² = mean² + path². The EKF's mean is the GPS's wander at its first fixes, which nothing on board "
    "observes: chance, and on some axis more than the GPS's own over the flight."
)


def draw(observed: Observed, path: Path) -> None:
    """The figure: each axis over the flight, and a few seconds of it.

    Raises:
        OSError: it cannot be written.
    """
    figure = Figure(figsize=(13.0, 8.5), dpi=110, layout="constrained")
    grid = figure.subplots(3, 2, sharex="col", width_ratios=(1.7, 1.0))
    begin_s, end_s = observed.gps.time_s[0], observed.gps.time_s[-1]
    middle_s = 0.5 * (begin_s + end_s)
    window = (middle_s - 0.5 * ZOOM_S, middle_s + 0.5 * ZOOM_S)
    for row, name in enumerate(AXES):
        whole, zoom = grid[row]
        _draw_axis(whole, observed, row, (begin_s, end_s))
        _draw_axis(zoom, observed, row, window)
        whole.axvspan(*window, color="grey", alpha=0.15)
        whole.set_ylabel(f"{name} (m)")
    grid[0][0].legend(loc="best", fontsize=8)
    grid[0][0].set_title("EKF observer of position")
    grid[0][1].set_title("zoomed in")
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    figure.suptitle(observed.title)
    figure.savefig(path)


def _draw_axis(axes: Any, observed: Observed, row: int, window_s: tuple[float, float]) -> None:
    """One coordinate within a window; the vertical range is that of what is drawn."""
    times = observed.truth.time_s
    truth = observed.truth.at("position", times)[:, row]
    curves = (
        (times, truth, {"color": TRUTH_COLOUR, "linewidth": 1.2, "label": "truth"}),
        (observed.gps.time_s, observed.gps.position_m[:, row],
         {"color": GPS_COLOUR, "marker": ".", "markersize": 4, "linewidth": 0.6, "label": "GPS, measured"}),
        (observed.ekf.time_s, observed.ekf.position_m[:, row],
         {"color": EKF_COLOUR, "linewidth": 1.2, "label": "EKF"}),
    )  # fmt: skip
    for curve_times, values, style in curves:
        inside = (curve_times >= window_s[0]) & (curve_times <= window_s[1])
        axes.plot(curve_times[inside], values[inside], **style)
    axes.grid(visible=True, alpha=0.25)
