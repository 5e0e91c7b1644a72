"""Orientation against an optical reference: the trials of BROAD, one set of parameters for all.

    python -m benchmarks ahrs FOLDER        (or: make bench-ahrs DATA=FOLDER)

FOLDER (or its folder `broad`) holds trials of BROAD (Laidig et al. 2021, CC-BY-4.0) as .npz: `fs` (Hz),
`gyr` (rad/s), `acc` (m/s²), `mag` (µT), `quat_enu` (w, x, y, z, sensor to ENU, NaN in gaps), `movement`
(bool). The error is BROAD's: of q_truth * conj(q_estimate) the whole angle, and its parts about the vertical
(heading) and off it (inclination), root mean square over the samples in movement; a table's last line is the
mean over trials.

Three filters run: Madgwick's at the gain of its published peer, our orientation pre-filter alone, and the
31-state EKF with it as it flies, shipped settings, no GPS. Place and so the field are unknown indoors: its
size and dip are the mean of the first seconds at rest, its horizontal part is north. With `ahrs` and `vqf`
installed (extra `peers`) the peers run on the same trials. On no trial may the EKF do worse than its own
pre-filter.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from benchmarks.report import BenchReport
from companion.base.geometry import FloatArray, Quaternion, Vector3, quat_rotate, vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError, EstimateConfig, VehicleConfig, find_file, load_model
from companion.estimate.ahrs.complementary import OrientationFilter
from companion.estimate.ahrs.madgwick import MadgwickFilter, align
from companion.estimate.estimator import StateEstimator

SMOKE: Final = ("--jobs", "1")
NEEDS: Final = "DATA: trials of BROAD"
EKF_BAR_DEG: Final = 2.5  # without VQF to compare with
VQF_SHARE: Final = 0.75  # of VQF's error: the EKF's, mean over the trials
LARGEST_VQF_SHARE: Final = 1.3  # on one trial, or
LARGEST_DEG: Final = 1.0  # this, whichever is more
MADGWICK_BAR_DEG: Final = 0.1
PEER_GAIN: Final = 0.12
# Madgwick at gain 0.12, mean of the total error: over the six trials shipped to developers and over the
# thirty undisturbed and disturbed ones (ahrs 0.4.0)
PUBLISHED_DEG: Final = {6: 4.34, 30: 4.88}
REST_S: Final = 5.0
FLU_FROM_FRD: Final = np.array([1.0, -1.0, -1.0])
_HALF: Final = math.sqrt(0.5)
NED_FROM_ENU: Final = np.array([[0.0, _HALF, _HALF, 0.0]])
HALF_TURN_X: Final = np.array([[0.0, 1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class AhrsTrial:
    """One recording, turned to FRD and NED; `truth` (n, 4) stands at the samples `judged`."""

    name: str
    period_s: float
    rates: FloatArray
    forces: FloatArray
    fields: FloatArray
    judged: Any
    truth: FloatArray

    @property
    def start(self) -> tuple[Quaternion, Vector3]:
        """Attitude (north is where the field points) and field NED, from the rest at the beginning."""
        rest = int(REST_S / self.period_s)
        field = vector3(self.fields[:rest].mean(0))
        attitude = align(vector3(self.forces[:rest].mean(0)), field, 0.0)
        north, east, down = quat_rotate(attitude, field)
        return attitude, (math.hypot(north, east), 0.0, down)


Run = Callable[[AhrsTrial], FloatArray]


# ---------------------------------------------------------------- data and errors


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Hamilton products of rows (n, 4)."""
    w = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(1, keepdims=True)
    v = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])
    return np.concatenate([w, v], axis=1)


def ned_from_enu(sensor_to_enu: FloatArray) -> FloatArray:
    """Body (FRD) to NED from sensor (x forward, z up) to ENU, rows (n, 4)."""
    return multiply(multiply(NED_FROM_ENU, sensor_to_enu), HALF_TURN_X)


def load(path: Path) -> AhrsTrial:
    """Read one trial.

    Raises:
        ValueError: the file is not such a trial; the line names it and what is missing.
    """
    try:
        with np.load(path) as data:
            truth = np.array(data["quat_enu"], dtype=float)
            judged = np.flatnonzero(data["movement"].astype(bool) & ~np.isnan(truth).any(axis=1))
            rates, forces, fields = (
                np.array(data[k], dtype=float) * FLU_FROM_FRD for k in ("gyr", "acc", "mag")
            )
            period_s = 1.0 / float(data["fs"])
    except (KeyError, OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a trial of BROAD as .npz: {error}") from error
    if not len(judged):
        raise ValueError(f"{path}: expected samples in movement with a reference, found none")
    return AhrsTrial(path.stem, period_s, rates, forces, fields, judged, ned_from_enu(truth[judged]))


def errors_deg(trial: AhrsTrial, estimate: FloatArray) -> tuple[float, float, float]:
    """Total, heading and inclination error (deg), root mean square, of attitudes (n, 4) at every sample."""
    e = np.abs(multiply(trial.truth, estimate[trial.judged] * np.array([1.0, -1.0, -1.0, -1.0])))
    total = 2.0 * np.arccos(np.clip(e[:, 0], 0.0, 1.0))
    heading = 2.0 * np.arctan2(e[:, 3], e[:, 0])
    inclination = 2.0 * np.arccos(np.clip(np.hypot(e[:, 0], e[:, 3]), 0.0, 1.0))
    rms = [math.degrees(math.sqrt(float(np.mean(part**2)))) for part in (total, heading, inclination)]
    return rms[0], rms[1], rms[2]


# ---------------------------------------------------------------- ours


def run_filter(trial: AhrsTrial, make: Callable[[Quaternion, Vector3], Any]) -> FloatArray:
    """One of the orientation filters by itself."""
    attitude, field = trial.start
    own, dt_s = make(attitude, field), trial.period_s
    rows = zip(trial.rates.tolist(), trial.forces.tolist(), trial.fields.tolist(), strict=True)
    estimate = np.empty((len(trial.rates), 4))
    for k, (rate, force, measured) in enumerate(rows):
        own.update_mag(tuple(measured), dt_s)
        estimate[k] = own.update_imu(tuple(rate), tuple(force), dt_s)
    return estimate


def run_madgwick(trial: AhrsTrial) -> FloatArray:
    """Madgwick's filter alone, at its peer's gain."""
    return run_filter(trial, lambda attitude, _field: MadgwickFilter(PEER_GAIN, 0.0, attitude))


def run_prefilter(trial: AhrsTrial) -> FloatArray:
    """The complementary pre-filter alone: without the EKF, and so without a gyroscope bias."""
    return run_filter(trial, lambda attitude, field: OrientationFilter(field, attitude))


def run_ekf(trial: AhrsTrial) -> FloatArray:
    """The whole vehicle estimator at its shipped settings, without GPS."""
    attitude, field = trial.start
    config = EstimateConfig(magnetic_field_ned_ut=field)
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
    estimator = StateEstimator(config, vehicle, (0.0, 0.0, 0.0), 0.5)
    rows = zip(trial.rates.tolist(), trial.forces.tolist(), trial.fields.tolist(), strict=True)
    estimate = np.empty((len(trial.rates), 4))
    for k, (rate, force, measured) in enumerate(rows):
        # a sample of such a strapdown sensor is the mean over the period that it ends
        now_s = k * trial.period_s
        estimator.add_mag(MagSample(now_s, vector3(measured)))
        estimator.add_imu(ImuSample(now_s - 0.5 * trial.period_s, vector3(rate), vector3(force), 25.0))
        state = estimator.vehicle(now_s)
        estimate[k] = attitude if state is None else state.attitude
    return estimate


# ---------------------------------------------------------------- peers, when installed


def peers() -> dict[str, Run]:
    """The other projects' filters that are installed."""
    found: dict[str, Run] = {}
    try:
        from ahrs.filters import Madgwick
    except ImportError:
        pass
    else:
        found["ahrs Madgwick 0.12"] = lambda trial: _run_ahrs(trial, Madgwick)
    try:
        from vqf import VQF
    except ImportError:
        pass
    else:
        found["VQF"] = lambda trial: _run_vqf(trial, VQF)
    return found


def _upright(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values * FLU_FROM_FRD)


def _run_ahrs(trial: AhrsTrial, filter_class: Any) -> FloatArray:
    # this one's world frame is north, west, up: a quarter turn from ENU
    run = filter_class(
        gyr=_upright(trial.rates),
        acc=_upright(trial.forces),
        mag=_upright(trial.fields) * 1e3,
        frequency=1.0 / trial.period_s,
        gain=PEER_GAIN,
    )
    quarter = np.array([[_HALF, 0.0, 0.0, _HALF]])
    return ned_from_enu(multiply(quarter, np.asarray(run.Q)))


def _run_vqf(trial: AhrsTrial, filter_class: Any) -> FloatArray:
    run = filter_class(trial.period_s)
    result = run.updateBatch(_upright(trial.rates), _upright(trial.forces), _upright(trial.fields))
    return ned_from_enu(result["quat9D"])


# ---------------------------------------------------------------- the table

OURS: Final[dict[str, Run]] = {
    "Madgwick 0.12": run_madgwick,
    "pre-filter": run_prefilter,
    "EKF": run_ekf,
}


def judge(path: Path) -> tuple[str, dict[str, tuple[float, float, float]]]:
    """All filters over one trial."""
    trial = load(path)
    runs = {**OURS, **peers()}
    return trial.name, {name: errors_deg(trial, run(trial)) for name, run in runs.items()}


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge.

    Raises:
        ConfigError: there is nothing to judge.
    """
    parser = argparse.ArgumentParser(description="Orientation filters over trials of BROAD.")
    parser.add_argument("folder", type=Path, help="the trials, *.npz")
    parser.add_argument("--jobs", type=int, default=2)
    chosen = parser.parse_args(arguments)
    folder = chosen.folder / "broad" if (chosen.folder / "broad").is_dir() else chosen.folder
    paths = sorted(folder.glob("*.npz")) if folder.is_dir() else []
    if not paths:
        raise ConfigError(f"{chosen.folder}: expected a folder with trials of BROAD, *.npz")
    with ProcessPoolExecutor(chosen.jobs) as pool:
        try:
            results = list(pool.map(judge, paths))
        except ValueError as error:
            raise ConfigError(str(error)) from error
    report = BenchReport(width=max(110, 44 + 24 * len(results[0][1])))
    report.show(table(results))
    return verdict(report, {name: [errors[name][0] for _, errors in results] for name in results[0][1]})


def table(results: list[tuple[str, dict[str, tuple[float, float, float]]]]) -> Table:
    """A line a trial, and their mean."""
    names = list(results[0][1])
    shown = Table("trial", title="RMS error in movement, deg: total (heading / inclination)")
    for name in names:
        shown.add_column(name, justify="right")
    for trial, errors in results:
        shown.add_row(trial.removeprefix("broad_"), *(_cell(errors[name]) for name in names))
    rows = {name: np.mean([errors[name] for _, errors in results], axis=0) for name in names}
    shown.add_section()
    shown.add_row("mean", *(_cell(rows[name]) for name in names))
    return shown


def _cell(row: Sequence[float] | FloatArray) -> str:
    return f"{row[0]:.2f} ({row[1]:.2f} / {row[2]:.2f})"


def verdict(report: BenchReport, totals: dict[str, list[float]]) -> BenchReport:
    """Judge by the total error (deg) of each filter on each trial."""
    trials = len(totals["EKF"])
    means = {name: float(np.mean(values)) for name, values in totals.items()}
    bars: dict[str, bool] = {}

    def judged(what: str, value: float, bar: float) -> None:
        bars[f"{what} {value:.2f} <= {bar:.2f}"] = value <= bar

    if "VQF" in totals:
        judged(f"EKF's mean against {VQF_SHARE:g} x VQF's, deg", means["EKF"], VQF_SHARE * means["VQF"])
        shares = [
            own / max(LARGEST_VQF_SHARE * peer, LARGEST_DEG)
            for own, peer in zip(totals["EKF"], totals["VQF"], strict=True)
        ]
        judged(f"worst trial against {LARGEST_VQF_SHARE:g} x VQF's or {LARGEST_DEG:g} deg", max(shares), 1.0)
    else:
        judged("EKF's mean, deg", means["EKF"], EKF_BAR_DEG)
        report.show("VQF is not installed")
    own = max(e - p for e, p in zip(totals["EKF"], totals["pre-filter"], strict=True))
    judged("EKF less its pre-filter at worst, deg", own, 0.0)
    peer = means.get("ahrs Madgwick 0.12", PUBLISHED_DEG.get(trials))
    if peer is None:
        report.show("Madgwick: no peer (install ahrs, or run the 6 or 30 trials of the published figure)")
    else:
        judged("Madgwick from its peer, deg", abs(means["Madgwick 0.12"] - peer), MADGWICK_BAR_DEG)
    return report.judge(bars)
