"""`calibrate-mount`: its help and its subcommands, each imported when it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from calibration.command_line import run
from calibration.mount.options import NAME
from companion.base.command_line import Command, VersionOption, lazy_app

HELP: Final = """Calibrate the IMU and the camera mount (camera-IMU extrinsics and time offset) in the field.

First calibrate the IMU (once, on a table). Then record while you move the vehicle over the pad, and solve
for the camera. No step needs a screen. The log of a flight that hovered over the pad also works.

\b
calibrate-mount accelerometer -o inertial.yaml
calibrate-mount record swayed
calibrate-mount camera swayed -o mount.yaml --plots pictures
calibrate-mount gyro -o inertial.yaml

The settings then say: mount: mount.yaml, and sense.imu.inertial_calibration: inertial.yaml.

Exit codes: 0 calibrated, 1 refused (the message says why), 2 user error, 130 interrupted.
"""
COMMANDS: Final[Mapping[str, Command]] = {
    "accelerometer": Command(
        "calibration.mount.imu.command:accelerometer_command",
        "Calibrate the accelerometer on six faces, and the gyro bias.",
        "ACCELEROMETER_HELP",
    ),
    "gyro": Command(
        "calibration.mount.imu.command:gyro_command", "Calibrate the gyro bias only.", "GYRO_HELP"
    ),
    "record": Command("calibration.mount.record.command:record_command", "Record motion over the pad."),
    "camera": Command(
        "calibration.mount.solve.command:camera_command",
        "Solve for the camera's rotation, position and time offset.",
    ),
}
cli = lazy_app(COMMANDS)


@cli.callback(help=HELP)
def calibrate_mount(*, version: VersionOption = False) -> None:
    """What all subcommands have in common."""


def main() -> None:
    """Entry point."""
    run(cli, NAME)


if __name__ == "__main__":
    main()
