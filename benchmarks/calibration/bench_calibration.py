"""All calibration tools beside their bars: magnetometer, camera, mount, one after another.

    python -m benchmarks calibration [DATA]

DATA is a folder of real logs and photos in its subfolders magnetometer and aruco.
"""

import argparse
from collections.abc import Sequence
from typing import Final

from benchmarks.calibration import bench_camera, bench_magnetometer, bench_mount
from benchmarks.report import BenchReport

SMOKE: Final = ("--quick",)


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", nargs="?", metavar="DATA")
    parser.add_argument("--quick", action="store_true", help="of each what takes seconds")
    chosen = parser.parse_args(arguments)
    data = [] if chosen.data is None else [chosen.data]
    report = BenchReport()
    for bench in (bench_magnetometer, bench_camera, bench_mount):
        report.include(bench.main([*data, *(bench.SMOKE if chosen.quick else ())]))
    return report
