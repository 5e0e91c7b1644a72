"""The simulator's flight controller: PX4's or ArduPilot's manners around one cascade."""

from sitl.autopilot.control.airframe import Airframe, hover_thrust
from sitl.autopilot.control.estimator import ESTIMATORS, NO_ERRORS, EstimatorErrors, EstimatorName
from sitl.autopilot.control.mixer import Motors
from sitl.autopilot.control.setpoints import (
    AttitudeSetpoint,
    Frame,
    Ignore,
    MotionSetpoint,
    StreamedAttitude,
    StreamedMotion,
)
from sitl.autopilot.flight.autopilot import Autopilot
from sitl.autopilot.flight.flight_state import MANNERS
from sitl.autopilot.flight.modes import Result, Severity, Task

__all__ = [
    "ESTIMATORS",
    "MANNERS",
    "NO_ERRORS",
    "Airframe",
    "AttitudeSetpoint",
    "Autopilot",
    "EstimatorErrors",
    "EstimatorName",
    "Frame",
    "Ignore",
    "MotionSetpoint",
    "Motors",
    "Result",
    "Severity",
    "StreamedAttitude",
    "StreamedMotion",
    "Task",
    "hover_thrust",
]
