"""`calibrate-magnetometer`."""

from typing import Final

PROGRAM: Final = "calibrate-magnetometer"
