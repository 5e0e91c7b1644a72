"""`calibrate-mount` on simulated recordings of known truth, and what its file is worth in flight.

    python -m benchmarks mount --seeds 10

In the order in which the documentation has it: the six faces first, then, with that inertial file in the
settings, recordings of the hand-held vehicle (60 s of `sway` at most: it stops when that is enough), with a
mount that is off by up to 4° about every axis and stamps that are off by up to 30 ms. The bar counts the
camera's rotation against the gyroscope's axes. Two more are shown beside it. Against the airframe, with what
is stated of it: a chip whose axes are askew by 0.3° (what the simulator leaves of its ±2 % cross-axis
sensitivity) knows no better. And tilted against what the accelerometer takes for level, which is what a
flight feels, since its attitude comes from there: with the six faces, and what it would be without.

Prints tables and ends in one line that says which bars hold; the exit status matches. There are no recordings
of real vehicles: DATA is not looked at.
"""

import argparse
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from rich.table import Table

from benchmarks.report import BenchReport, figures_table, watched
from benchmarks.state.consistency import band
from calibration.mount.imu_calibration import calibrate_accelerometer, faces_from
from calibration.mount.model import log
from calibration.mount.recording import read_recording
from calibration.mount.result import configured_rotation, mount_calibration, prior_of, reasons, shutter_s
from calibration.mount.solver import MountSolution, solve
from companion.base.clock import run_in_virtual_time
from companion.base.geometry import FloatArray
from companion.config import CompanionConfig, InertialCalibration, MountCalibration, load_model, validate
from tests.scenario.flying import fly, scenario_file
from tests.unit.calibration.mount.mount_world import HandHeld, mount_errors, record_sway, scenario_of

SMOKE: Final = ("--seeds", "1", "--flights", "0")
ROTATION_DEG: Final = 0.3
OFFSET_S: Final = 0.002
ACCEL_OFFSET_M_S2: Final = 0.03  # 3 mg: 2 % across the axes, felt on faces that lie 3° askew
RECORDING_S: Final = 61.0
# what a calibrated camera's lens is off by, in the simulator and by the settings
LENS_ERROR: Final = 0.001
FLIGHT_MOUNT_DEG: Final = [2.0, -2.0, 1.0]  # 3° in all
FLIGHT_STAMP_S: Final = 0.02


@dataclass(frozen=True)
class MountRow:
    """One recording's outcome: errors, solution, verdict.

    `off_level_deg` is the camera's tilt against what the accelerometer takes for level: with its six faces,
    and as that would be without them.
    """

    seed: int
    to_body: FloatArray
    to_gyro: FloatArray
    off_level_deg: tuple[float, float]
    offset_s: float
    solution: MountSolution
    against: tuple[str, ...]

    @property
    def rotation_deg(self) -> float:
        """Against the gyroscope's axes."""
        return float(np.degrees(np.linalg.norm(self.to_gyro)))

    @property
    def nees(self) -> float:
        """Of the rotation, against the airframe: what is stated is about that."""
        return float(self.to_body @ np.linalg.solve(self.solution.rotation_covariance, self.to_body))

    @property
    def offset_nees(self) -> float:
        """Of the time offset."""
        return (self.offset_s / self.solution.time_offset_std_s) ** 2


def settings(inertial: Path) -> CompanionConfig:
    """The app's, with a lens and an inertial sensor that were calibrated."""
    sense = {"vision": {"scale_error": LENS_ERROR}, "imu": {"inertial_calibration": str(inertial)}}
    return validate(CompanionConfig, {"sense": sense}, "bench")


def rested(held: HandHeld, output: Path) -> Path:
    """The six faces, as the program does it; returns the file."""
    with redirect_stdout(StringIO()):
        # the hand lays it down in an order of its own: what was asked does not count here
        rests = run_in_virtual_time(faces_from(CompanionConfig(), None, held.boards, virtual=True))
        calibrate_accelerometer(replace(rests, asked=(), answers=()), output, force=True)
    return output


def off_level_deg(held: HandHeld, found: MountSolution, calibrated: InertialCalibration | None) -> float:
    """The camera's tilt against what the accelerometer, calibrated so, takes for level."""
    right = held.felt_level(calibrated) @ held.body_from_camera
    apart = log(found.unknowns.body_from_camera @ right.T)
    return float(np.degrees(np.linalg.norm(apart[:2])))


def swayed(seed: int, folder: Path) -> MountRow:
    """Record and solve one."""
    mount_deg, stamp_s = mount_errors(seed)
    camera = {"mount_error_deg": mount_deg, "stamp_error_s": stamp_s, "calibration_error": LENS_ERROR}
    scenario = scenario_of({"camera": camera})
    held = HandHeld(scenario, seed, "sway")
    folder.mkdir()
    inertial = rested(HandHeld(scenario, seed, "faces"), folder / "inertial.yaml")
    with redirect_stdout(StringIO()):
        record_sway(held, settings(inertial), folder / "swayed", RECORDING_S)
    found, against = solved(folder / "swayed")[:2]
    calibrated = load_model(InertialCalibration, inertial)
    return MountRow(
        seed,
        *held.rotation_errors(found),
        (off_level_deg(held, found, calibrated), off_level_deg(held, found, None)),
        found.time_offset_s + stamp_s,
        found,
        against,
    )


def solved(folder: Path) -> tuple[MountSolution, tuple[str, ...], MountCalibration]:
    """As the program does it."""
    recording = read_recording(folder)
    place = np.array(recording.vehicle.camera_position_body_m)
    found = solve(
        recording.inertial, recording.sightings, place, shutter_s(recording), prior_of(recording, 0.02)
    )
    against = reasons(found, configured_rotation(recording), place, 10.0)
    return found, against, mount_calibration(found, recording, against, "2026-01-01")


def table(rows: Sequence[MountRow]) -> Table:
    """The recordings."""
    grid = figures_table(
        f"60 s of sway at most: mount off by up to 4°, stamps by up to 30 ms, lens by {LENS_ERROR:g}",
        *("seed", f"rotation ° (<= {ROTATION_DEG:g})", "against the airframe °", "stated °"),
        *("off level °", "without faces °"),
        *(f"offset ms (<= {1e3 * OFFSET_S:g})", "stated ms", "place mm", "sightings", "NEES", "verdict"),
    )
    for row in rows:
        stated = np.degrees(np.sqrt(np.trace(row.solution.rotation_covariance)))
        grid.add_row(
            str(row.seed),
            f"{row.rotation_deg:.3f}",
            f"{np.degrees(np.linalg.norm(row.to_body)):.3f}",
            f"{stated:.3f}",
            f"{row.off_level_deg[0]:.3f}",
            f"{row.off_level_deg[1]:.3f}",
            f"{1e3 * row.offset_s:+.2f}",
            f"{1e3 * row.solution.time_offset_std_s:.2f}",
            f"{1e3 * np.linalg.norm(row.solution.position_m - (0.03, 0.0, 0.08)):.0f}",
            f"{row.solution.kept.sum()} of {len(row.solution.kept)}",
            f"{row.nees:.1f}",
            "good" if not row.against else "; ".join(row.against),
        )
    return grid


def six_faces(seed: int, folder: Path) -> tuple[float, float, float]:
    """Errors of a shop-fresh accelerometer's offset and scale, and of the bias of the gyroscope (deg/s)."""
    held = HandHeld(scenario_of({"sensors": {"calibrated": False}}), seed, "faces")
    found = load_model(InertialCalibration, rested(held, folder / f"inertial_{seed}.yaml"))
    assert held.vehicle is not None
    assert found.accelerometer is not None
    truth = held.vehicle.simulation.sensor_truth.boards
    scale = np.diag(np.array(found.accelerometer.matrix) @ truth.accelerometer.matrix) - 1.0
    return (
        float(np.abs(np.array(found.accelerometer.offset_m_s2) - truth.accelerometer.offset).max()),
        float(np.abs(scale).max()),
        float(np.degrees(np.abs(np.array(found.gyro.bias_rad_s) - truth.gyroscope.offset).max())),
    )


def flights(folder: Path, seeds: int) -> list[tuple[str, list[dict[str, Any]]]]:
    """Landings with the camera askew and late stamps: by the settings as they were, and by the mount file."""
    camera = {"mount_error_deg": FLIGHT_MOUNT_DEG, "stamp_error_s": FLIGHT_STAMP_S}
    held = HandHeld(scenario_of({"camera": camera}), 0, "sway")
    with redirect_stdout(StringIO()):
        record_sway(held, CompanionConfig(), folder / "askew", RECORDING_S)
    mount = folder / "mount.yaml"
    mount.write_text(yaml.safe_dump(solved(folder / "askew")[2].model_dump(mode="json")))
    cases = {"nothing wrong": {}, "askew": {"camera": camera}}
    cases["askew, with the mount file"] = {"camera": camera, "companion": {"mount": str(mount)}}
    rows = []
    for name, changes in cases.items():
        base = scenario_file(folder, "line", changes)
        flown = [fly(base, seed, folder) for seed in range(seeds)]
        rows.append((name, [run.result or {} for run in flown]))
    return rows


def hovered(folder: Path) -> str:
    """What a flight's own log gives: over the pad, before it lands or gives up."""
    camera = {"mount_error_deg": FLIGHT_MOUNT_DEG, "stamp_error_s": FLIGHT_STAMP_S}
    fly(scenario_file(folder, "static", {"camera": camera}), 0, folder, "--record", folder / "hover")
    found, against, file = solved(folder / "hover")
    angles = (file.camera_roll_deg, file.camera_tilt_deg, file.camera_yaw_deg)
    off_deg = np.abs(np.subtract(angles, FLIGHT_MOUNT_DEG)).max()
    offset_ms = 1e3 * (found.time_offset_s + FLIGHT_STAMP_S)
    verdict = "; ".join(against) or "good"
    return (
        f"a flight's own log over a pad at rest ({found.kept.sum()} frames): every angle within "
        f"{off_deg:.2f}°, offset {offset_ms:+.2f} ms off, verdict {verdict}"
    )


def worst_line(rows: Sequence[MountRow]) -> str:
    """What to remember of the table."""
    air = np.degrees([np.linalg.norm(row.to_body) for row in rows])
    level = np.array([row.off_level_deg for row in rows])
    turned = max(row.rotation_deg for row in rows)
    return (
        f"worst of {len(rows)}: rotation {turned:.2f}°; against the airframe {air.max():.2f}° (mean "
        f"{air.mean():.2f}); off what is felt for level {level[:, 0].max():.2f}° (mean "
        f"{level[:, 0].mean():.2f}), without the six faces {level[:, 1].max():.2f}° (mean "
        f"{level[:, 1].mean():.2f})"
    )


def flight_table(rows: list[tuple[str, list[dict[str, Any]]]]) -> Table:
    """The landings."""
    title = f"landings on 'line', camera turned by {FLIGHT_MOUNT_DEG} deg, stamps {FLIGHT_STAMP_S} s late"
    grid = figures_table(title, "camera", "landed", "off the centre, cm", "worst, cm", "touchdown m/s")
    for name, results in rows:
        touched = [r["touchdown"] for r in results if r.get("touchdown")]
        away = [100.0 * t["lateral_error_m"] for t in touched] or [float("nan")]
        speed = [t["vertical_speed_m_s"] for t in touched] or [float("nan")]
        landed = sum(r.get("outcome") == "landed" for r in results)
        grid.add_row(
            name,
            f"{landed} of {len(results)}",
            f"{np.mean(away):.1f}",
            f"{max(away):.1f}",
            f"{np.mean(speed):.2f}",
        )
    return grid


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", nargs="?", help="not looked at: no real recordings of this kind")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--flights", type=int, default=3)
    chosen = parser.parse_args(arguments)
    report = BenchReport(width=170)
    with tempfile.TemporaryDirectory(prefix="bench-mount-") as name:
        folder = Path(name)
        rows = [swayed(seed, folder / f"sway{seed}") for seed in watched(range(chosen.seeds), "swayed")]
        report.show(table(rows))
        faces = np.array([six_faces(seed, folder) for seed in watched(range(chosen.seeds), "six faces")])
        flown = flights(folder, chosen.flights) if chosen.flights else []
        hover = hovered(folder) if chosen.flights else ""
    report.show(worst_line(rows))
    low, high = band(3, len(rows))
    nees, offset_nees = (
        float(np.mean([getattr(row, what) for row in rows])) for what in ("nees", "offset_nees")
    )
    offset_high = band(1, len(rows))[1]
    report.show(
        f"NEES of the rotation {nees:.2f} ({low:.2f}..{high:.2f}), of the offset {offset_nees:.2f} "
        f"(<= {offset_high:.2f})"
    )
    worst = faces.max(axis=0)
    report.show(
        f"six faces, shop-fresh sensors: offset within {worst[0]:.4f} m/s² (<= {ACCEL_OFFSET_M_S2:g}), scale "
        f"within {100 * worst[1]:.2f} %, gyroscope's bias within {worst[2]:.3f}°/s"
    )
    bars = {
        "rotation": max(row.rotation_deg for row in rows) <= ROTATION_DEG,
        "offset": max(abs(row.offset_s) for row in rows) <= OFFSET_S,
        "NEES": nees <= high and offset_nees <= offset_high,
        "verdicts": not any(row.against for row in rows),
        "six faces": worst[0] <= ACCEL_OFFSET_M_S2,
    }
    if flown:
        report.show(flight_table(flown))
        report.show(hover)
        away = [
            np.mean([r["touchdown"]["lateral_error_m"] if r.get("touchdown") else 9.0 for r in results])
            for _, results in flown
        ]
        bars["flights"] = bool(away[2] < away[1])
    return report.judge(bars)
