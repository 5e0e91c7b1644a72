"""The airframe and its motors."""

from typing import Literal

HandMotion = Literal["still", "tumble", "faces", "sway", "over-pad"]
