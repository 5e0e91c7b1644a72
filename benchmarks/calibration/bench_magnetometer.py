"""The magnetometer's calibration beside its bars: made-up truth, real logs, and flights that use it.

    python -m benchmarks magnetometer DATA --flights 2

Made-up magnetometers with 30 % soft iron and 2 % noise are turned over half the sphere under many seeds: the
error of the hard iron, and the normalised error squared (NEES) of all nine parameters by the stated
covariance. Real logs (DATA/magnetometer) against the published residuals. Then vehicles with uncalibrated
magnetometers are carried about by hand and calibrated over their registers, and fly figure_8 with the file;
beside them the same flights with the simulator's default residuals. Ends in one line that says which bars
hold; the exit status is 0 when all do.
"""

import argparse
import io
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final
from unittest import mock

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.report import BenchReport, figures_table
from benchmarks.state.samples import rms
from benchmarks.state.streams import fly_stream, rerun, settings_of
from calibration.magnetometer.calibrate import Calibrated, TrueField, calibrate
from calibration.magnetometer.collect import collect
from calibration.magnetometer.ellipsoid import fit_ellipsoid
from calibration.magnetometer.live import Mpu9250Compass
from calibration.magnetometer.report import yaml_text
from calibration.magnetometer.sources import read_recording
from companion.base.clock import run_in_virtual_time
from companion.base.geometry import FloatArray
from companion.config import ImuConfig
from companion.sim.trial import Trial
from sitl.run.in_process import carried
from sitl.scenario.scenario import Scenario, SensorSettings, magnetic_field_ned_ut
from sitl.sensors.inertial import SensorErrors, sensor_errors
from tests.unit.calibration.magnetometer.magnetometer_truth import FIELD_UT, turned

SMOKE: Final = ("--seeds", "3", "--flights", "0")
OFFSET: Final = 0.01  # share of the field, in 95 of 100
BAR_SAMPLES: Final = 6000  # a minute of the AK8963
SAMPLES: Final = (500, 1500, BAR_SAMPLES)
NEES_BAND: Final = (0.85, 1.15)
PUBLISHED: Final = {"ck_acc_mag.csv": 0.01255, "qmc5883l_noisy.csv": 0.0618}
ROUNDING: Final = 5e-6
LIVE_OFFSET: Final = 0.01
ATTITUDE_DEG: Final = 1.0
SCENARIO: Final = "figure_8"
_ELEMENTS: Final = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])


# ---------------------------------------------------------------- made-up truth


def scores(seed: int, samples: int, *, half: bool) -> tuple[float, float, float]:
    """Error of the hard iron and its stated standard deviation (shares of the field), and the NEES over 9."""
    case = turned(seed, samples, half=half)
    fit = fit_ellipsoid(case.raw, np.random.default_rng(0))
    scale = float(np.cbrt(np.linalg.det(case.matrix)))
    shape = (fit.ellipsoid.matrix * FIELD_UT - case.matrix)[_ELEMENTS] / scale
    centre = (fit.ellipsoid.centre - case.centre) * scale / FIELD_UT
    error = np.concatenate([shape, centre])
    stated = float(np.linalg.norm(fit.centre_std))
    return float(np.linalg.norm(centre)), stated, float(error @ np.linalg.solve(fit.covariance, error)) / 9.0


def made_up(seeds: int, report: BenchReport) -> dict[str, bool]:
    """The table over made-up truth, and its bars."""
    grid = figures_table(
        f"30 % soft iron, 2 % noise, {seeds} seeds",
        *("sphere", "samples", "hard iron rms %", f"95 % (<= {100 * OFFSET:g})", "stated %"),
        f"NEES / 9 ({NEES_BAND[0]:g}..{NEES_BAND[1]:g})",
    )
    held = {}
    for half, samples in [(True, samples) for samples in SAMPLES] + [(False, 1500)]:
        rows = np.array([scores(seed, samples, half=half) for seed in range(seeds)])
        errors, nees = rows[:, 0], float(rows[:, 2].mean())
        worst = float(np.percentile(errors, 95.0))
        cells = (100 * rms(errors), 100 * worst, 100 * rms(rows[:, 1]))
        name = "half" if half else "whole"
        grid.add_row(name, str(samples), *(f"{cell:.2f}" for cell in cells), f"{nees:.3f}")
        held[f"NEES {name} {samples}"] = NEES_BAND[0] <= nees <= NEES_BAND[1]
        if samples == BAR_SAMPLES:
            held["hard iron over half a sphere"] = worst <= OFFSET
    report.show(grid)
    return held


# ---------------------------------------------------------------- real logs


def real(data: Path | None, report: BenchReport) -> dict[str, bool]:
    """Residuals over all samples of real logs; nothing without the data."""
    if data is None:
        report.show("real logs: not run; give the folder that has magnetometer/ in it")
        return {}
    grid = Table("log", "samples", "residual %", "published %", "verdict", title="Real logs, all samples")
    held = {}
    for name, published in PUBLISHED.items():
        rng = np.random.default_rng(0)
        path = data / "magnetometer" / name
        recording = read_recording(path, columns=None, unit=None, sensor="other", field_ut=None, rng=rng)
        done = calibrate(recording, rng, field=None, aligned=False, tool="bench", date="")
        quality = done.file.quality
        figures = (f"{100 * quality.residual:.3f}", f"{100 * published:.3f}")
        grid.add_row(name, str(len(recording.raw)), *figures, quality.verdict)
        held[f"residual of {name}"] = quality.residual <= published + ROUNDING
    report.show(grid)
    return held


# ---------------------------------------------------------------- carried about, then flown


def magnetometer_from_the_shop(settings: SensorSettings, vibration: float = 1.0) -> SensorErrors:
    """The simulator's sensors, of which the magnetometer alone is not calibrated."""
    errors = sensor_errors(settings, vibration)
    return replace(errors, magnetometer=replace(errors.magnetometer, calibrated=False))


async def carried_about(scenario: Scenario, seed: int) -> tuple[Calibrated, FloatArray]:
    """Calibrate a vehicle that is turned about by hand; and its true hard iron (µT)."""
    async with carried(scenario, seed, "tumble", camera=False) as vehicle:
        source = Mpu9250Compass(vehicle.imu_bus, ImuConfig())
        recording = await collect(source, Console(file=io.StringIO()), 150.0)
        truth = vehicle.simulation.sensor_truth.boards.magnetometer.offset
    field = TrueField(magnetic_field_ned_ut(scenario.place), "the simulator's")
    rng = np.random.default_rng(0)
    return calibrate(recording, rng, field=field, aligned=False, tool="bench", date=""), truth


def attitude_deg(trial: Trial) -> tuple[float, str]:
    """The attitude's root mean square error in the air, and how the flight ended."""
    stream = fly_stream(trial)
    samples = rerun(stream, settings_of(trial))
    return rms(samples.where(samples.airborne).attitude_deg), stream.outcome


def flown(seeds: int, report: BenchReport) -> dict[str, bool]:
    """Flights by the calibration, beside those of the simulator's default residuals."""
    grid = figures_table(
        f"Carried about by hand, then flown: {SCENARIO}",
        *("seed", f"hard iron % (<= {100 * LIVE_OFFSET:g})", f"attitude ° (<= {ATTITUDE_DEG:g})"),
        "with default residuals °",
    )
    errors, attitudes, outcomes = [], [], []
    for seed in range(seeds):
        trial = Trial.load(SCENARIO, seed)
        with (
            tempfile.TemporaryDirectory() as folder,
            mock.patch("sitl.run.simulation.sensor_errors", magnetometer_from_the_shop),
        ):
            done, truth = run_in_virtual_time(carried_about(trial.scenario, seed))
            path = Path(folder) / "magnetometer.yaml"
            path.write_text(yaml_text(done.file))
            sense = {"sense": {"imu": {"magnetometer_calibration": str(path)}}}
            scenario = trial.scenario.model_copy(update={"companion": {**trial.scenario.companion, **sense}})
            by_file, outcome = attitude_deg(replace(trial, scenario=scenario))
        error = float(np.linalg.norm(done.centre - truth)) / done.file.field_strength
        usual, _ = attitude_deg(trial)
        grid.add_row(str(seed), f"{100 * error:.3f}", f"{by_file:.3f} ({outcome})", f"{usual:.3f}")
        errors.append(error)
        attitudes.append(by_file)
        outcomes.append(outcome)
    report.show(grid)
    return {
        "hard iron over the registers": max(errors) <= LIVE_OFFSET,
        "attitude by the file": rms(np.array(attitudes)) <= ATTITUDE_DEG,
        "landings by the file": set(outcomes) == {"landed"},
    }


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("data", type=Path, nargs="?", help="folder of real data")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--flights", type=int, default=2)
    chosen, report = parser.parse_args(arguments), BenchReport(width=110)
    held = made_up(chosen.seeds, report) | real(chosen.data, report)
    if chosen.flights:
        held |= flown(chosen.flights, report)
    return report.judge(held)
