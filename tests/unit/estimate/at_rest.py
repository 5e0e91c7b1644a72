"""What a level vehicle at rest, heading north, feels: the force (m/s², body), and a field (µT, NED)."""

from companion.base.geometry import GRAVITY_M_S2

FIELD = (20.9, 0.6, 42.9)
DOWN_FORCE = (0.0, 0.0, -GRAVITY_M_S2)
