"""`calibrate-camera`."""

from typing import Final, Literal

NAME: Final = "calibrate-camera"
DEFAULT_BOARD: Final = "charuco_a4"
Pattern = Literal["charuco", "grid", "chessboard"]
Model = Literal["brown", "rational", "fisheye"]
