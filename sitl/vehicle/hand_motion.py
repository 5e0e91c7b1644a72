"""The motions of a vehicle that is carried by hand, by name."""

from typing import Literal

HandMotion = Literal["still", "tumble", "faces", "sway", "over-pad"]
