"""Plots of a mount calibration: rates before and after, residuals, the time offset search."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from calibration.mount.model import GYRO_BIAS, log
from calibration.mount.recording import ImuSamples, PadObservations
from calibration.mount.solver import MountSolution
from companion.base.files import make_folder, save_figure
from companion.base.geometry import FloatArray

AXES: Final = ("forward", "right", "down")
COLOURS: Final = ("tab:blue", "tab:orange", "tab:green")
SHOWN_S: Final = 10.0
GYRO_NAME, MISSES_NAME = "mount_rates.png", "mount_residuals.png"


def write_mount_plots(
    folder: Path, solution: MountSolution, inertial: ImuSamples, configured: FloatArray
) -> list[Path]:
    """Write both pictures; returns their paths."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    rates, residuals = Figure((11, 8), layout="constrained"), Figure((11, 8), layout="constrained")
    _draw_rates(rates, solution, inertial, configured)
    _draw_residuals(residuals, solution)
    paths = [make_folder("--plots", folder) / name for name in (GYRO_NAME, MISSES_NAME)]
    for figure, path in zip((rates, residuals), paths, strict=True):
        save_figure(figure, path, dpi=100)
    return paths


def camera_rates(sightings: PadObservations, body_from_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and rates (k, 3) in body axes by which the camera saw itself turn."""
    turned = sightings.camera_from_pad.mT
    span = np.diff(sightings.time_s)
    near = (span > 0.0) & (span < 0.3)
    step = log(turned[:-1].mT @ turned[1:])[near] / span[near, None]
    return (sightings.time_s[:-1] + 0.5 * span)[near], step @ body_from_camera.T


def _draw_rates(figure: Any, solution: MountSolution, inertial: ImuSamples, configured: FloatArray) -> None:
    seen = solution.sightings.taken(solution.kept)
    begin, end = _liveliest(seen, inertial)
    cases = (
        ("as the settings have it", configured, 0.0),
        ("calibrated", solution.unknowns.body_from_camera, solution.time_offset_s),
    )
    bias = solution.unknowns.values[GYRO_BIAS]
    axes = figure.subplots(3, 2, sharex=True, sharey="row")
    shown = (inertial.time_s > begin) & (inertial.time_s < end)
    for column, (title, rotation, offset_s) in enumerate(cases):
        times, rates = camera_rates(seen, rotation)
        inside = (times + offset_s > begin) & (times + offset_s < end)
        for row, axis in enumerate(axes[:, column]):
            gyro = inertial.rate[shown, row] - bias[row]
            axis.plot(
                inertial.time_s[shown] - begin, np.degrees(gyro), color="0.4", lw=1.0, label="gyroscope"
            )
            axis.plot(
                times[inside] + offset_s - begin,
                np.degrees(rates[inside, row]),
                ".",
                ms=3,
                color=COLOURS[row],
                label="camera",
            )
            axis.set_ylabel(f"about {AXES[row]}, deg/s")
            axis.grid(alpha=0.3)
        axes[0, column].set_title(title)
        axes[2, column].set_xlabel("s")
    axes[0, 1].legend(loc="upper right")
    figure.suptitle(f"time offset {1e3 * solution.time_offset_s:+.1f} ms")


def _liveliest(seen: PadObservations, inertial: ImuSamples) -> tuple[float, float]:
    """The segment of SHOWN_S, with the pad seen, in which it turned most."""
    starts = np.arange(seen.time_s[0], max(seen.time_s[-1] - SHOWN_S, seen.time_s[0]) + 1e-6, 0.5 * SHOWN_S)
    speed = np.linalg.norm(inertial.rate, axis=1)
    within = [speed[(inertial.time_s >= s) & (inertial.time_s < s + SHOWN_S)].sum() for s in starts]
    begin = float(starts[int(np.argmax(within))])
    return begin, begin + SHOWN_S


def _draw_residuals(figure: Any, solution: MountSolution) -> None:
    seen, kept = solution.sightings, solution.kept
    scale = np.sqrt(np.diagonal(seen.covariance, axis1=1, axis2=2)) * solution.scatter
    (place, turn), (spread, search) = figure.subplots(2, 2)
    start_s = seen.time_s[0]
    for k, name in enumerate("xyz"):
        for axis, at, unit in ((place, k, 1e3), (turn, 3 + k, np.degrees(1.0))):
            # along the whitened axes, in the size that they stand for
            values = solution.residuals[kept, at] * np.median(scale[kept, at]) * unit
            axis.plot(seen.time_s[kept] - start_s, values, ".", ms=2, color=COLOURS[k], label=name)
    place.set(title="position, mm (camera axes)", xlabel="s")
    turn.set(title="rotation, deg (camera axes)", xlabel="s")
    turn.legend(loc="upper right")
    spread.hist(solution.residuals[kept].ravel() / solution.scatter, bins=60, density=True, color="0.6")
    x = np.linspace(-4.0, 4.0, 200)
    spread.plot(x, np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi), color="k", lw=1.0)
    spread.set(title="misses over their standard deviation", xlim=(-4.5, 4.5))
    search.plot(1e3 * solution.coarse.grid_s, np.degrees(solution.coarse.misfit_rad), color="0.3")
    search.axvline(1e3 * solution.time_offset_s, color="tab:red", lw=1.0)
    search.set(title="turns that do not match, deg, by time offset", xlabel="ms")
    for axis in (place, turn, search):
        axis.grid(alpha=0.3)
