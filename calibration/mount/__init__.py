"""`calibrate-mount`."""

from typing import Final

NAME: Final = "calibrate-mount"
EXPECTED: Final = "expected the folder or the flight.mcap of 'calibrate-mount record' or of a flight"
# body axes (FRD): which way is down when the vehicle lies on that face
FACES: Final[dict[str, tuple[float, float, float]]] = {
    "level": (0.0, 0.0, 1.0),
    "upside-down": (0.0, 0.0, -1.0),
    "nose-down": (1.0, 0.0, 0.0),
    "nose-up": (-1.0, 0.0, 0.0),
    "right-down": (0.0, 1.0, 0.0),
    "left-down": (0.0, -1.0, 0.0),
}
