"""Level attitudes, by where the nose points."""

import math

from companion.base.geometry import Quaternion

HALF = math.sqrt(0.5)
NORTH: Quaternion = (1.0, 0.0, 0.0, 0.0)
EAST: Quaternion = (HALF, 0.0, 0.0, HALF)  # level, the nose to the east
SOUTH: Quaternion = (0.0, 0.0, 0.0, 1.0)
WEST: Quaternion = (HALF, 0.0, 0.0, -HALF)
