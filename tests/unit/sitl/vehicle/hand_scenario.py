"""A scenario for a vehicle that is carried by hand."""

from sitl.scenario.home import USUAL_HOMES, magnetic_field_ned_ut
from sitl.scenario.scenario import load_scenario

MAGNETIC_FIELD_NED_UT = magnetic_field_ned_ut(USUAL_HOMES["px4"])
STEP_S = 0.0025
STATIC = load_scenario("static")
STOPPED = (0.0, 0.0, 0.0, 0.0)
