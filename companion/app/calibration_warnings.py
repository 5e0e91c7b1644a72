"""Warnings about the calibrations in use: those that were written with `--force` although they were rejected.

The app flies with them, since the user asked for it, but warns at every start.
"""

from collections.abc import Iterator

from companion.app.sensing import load_used_magnetometer
from companion.config import (
    CameraConfig,
    CompanionConfig,
    find_file,
    load_inertial,
    load_model,
    load_mount,
)


def forced_calibrations(config: CompanionConfig) -> Iterator[str]:
    """A line for each calibration that was written by force, with the reasons.

    Raises:
        ConfigError: a file is missing or wrong.
    """
    camera = load_model(CameraConfig, find_file("cameras", config.camera)).calibration
    if camera is not None and camera.verdict:
        yield _line(config.camera, camera.verdict)
    mount = load_mount(config.mount, config.camera)
    if mount is not None and mount.forced:
        yield _line(str(config.mount), mount.forced)
    magnetometer = load_used_magnetometer(config.sense)
    if magnetometer is not None and magnetometer.quality.verdict == "refused":
        yield _line("the magnetometer", magnetometer.quality.reasons)
    inertial = load_inertial(config.sense)
    if inertial is not None and inertial.forced:
        yield _line(str(config.sense.imu.inertial_calibration), inertial.forced)


def _line(name: str, reasons: tuple[str, ...]) -> str:
    return f"calibration of {name} was written by force: {'; '.join(reasons)}"
