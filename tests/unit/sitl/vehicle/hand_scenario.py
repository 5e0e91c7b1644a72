"""A scenario for a vehicle that is carried by hand."""

from __future__ import annotations

from sitl.scenario.scenario import load_scenario

STEP_S = 0.0025
STATIC = load_scenario("static")
STOPPED = (0.0, 0.0, 0.0, 0.0)
