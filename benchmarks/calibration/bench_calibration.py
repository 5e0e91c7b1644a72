"""All calibration tools beside their bars: magnetometer, camera, mount, one after another.

    python -m benchmarks calibration [DATA]

DATA is a folder of real logs and photos in its subfolders magnetometer and aruco.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

from benchmarks.calibration import bench_camera, bench_magnetometer, bench_mount
from benchmarks.report import BenchReport

SMOKE: Final = ("--seeds", "1")


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", nargs="?", metavar="DATA")
    parser.add_argument("--seeds", help="of each; without it, their own number")
    chosen = parser.parse_args(arguments)
    words = [] if chosen.data is None else [chosen.data]
    words += [] if chosen.seeds is None else ["--seeds", chosen.seeds]
    report = BenchReport()
    for run in (bench_magnetometer.main, bench_camera.main, bench_mount.main):
        report.include(run(words))
    return report
