"""The kinds of boards and lens models, by name: what the command line needs before OpenCV is imported."""

from typing import Final, Literal

Pattern = Literal["charuco", "grid", "chessboard"]
Model = Literal["brown", "rational", "fisheye"]
DEFAULT_BOARD: Final = "charuco_a4"
