"""All calibration tools beside their bars: magnetometer, camera, mount, one after another.

    python -m benchmarks calibration [DATA]

DATA is a folder of real logs and photos in its subfolders magnetometer and aruco.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from benchmarks.calibration import bench_camera, bench_magnetometer, bench_mount


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", nargs="?", metavar="DATA")
    chosen = parser.parse_args(arguments)
    words = [] if chosen.data is None else [chosen.data]
    return max([run(words) for run in (bench_magnetometer.main, bench_camera.main, bench_mount.main)])
