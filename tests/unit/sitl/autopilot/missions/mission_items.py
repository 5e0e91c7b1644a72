"""Kinds of mission items, for missions over MAVLink."""

import pytest

BOTH = pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
WAYPOINT, TAKE_OFF, LAND, RETURN = 16, 22, 21, 20
