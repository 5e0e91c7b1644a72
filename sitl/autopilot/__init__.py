"""The simulator's flight controller: PX4's or ArduPilot's manners around one cascade."""

from sitl.autopilot.airframe import Airframe, hover_thrust
from sitl.autopilot.autopilot import Autopilot
from sitl.autopilot.estimator import ESTIMATORS, NO_ERRORS, EstimatorErrors, EstimatorName
from sitl.autopilot.flight import MANNERS
from sitl.autopilot.mixer import Motors
from sitl.autopilot.modes import Result, Severity, Task
from sitl.autopilot.setpoints import AttitudeSetpoint, Frame, Ignore, MotionSetpoint, StreamedMotion

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
    "StreamedMotion",
    "Task",
    "hover_thrust",
]
