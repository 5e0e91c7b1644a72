"""The simulator's flight controller: the profile of PX4 or ArduPilot around one control cascade."""

from sitl.autopilot.control.airframe import Airframe, hover_thrust
from sitl.autopilot.control.estimator import ESTIMATORS, NO_ERRORS, EstimatorErrors, EstimatorName
from sitl.autopilot.control.mixer import Motors
from sitl.autopilot.control.setpoints import (
    AttitudeSetpoint,
    Ignore,
    LocalFrame,
    MotionSetpoint,
    StreamedAttitude,
    StreamedMotion,
)
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.flight_state import PROFILES
from sitl.autopilot.flight.modes import CommandResult, Severity, Task

__all__ = [
    "ESTIMATORS",
    "NO_ERRORS",
    "PROFILES",
    "Airframe",
    "AttitudeSetpoint",
    "CommandResult",
    "EstimatorErrors",
    "EstimatorName",
    "Ignore",
    "LocalFrame",
    "MotionSetpoint",
    "Motors",
    "Severity",
    "SimulatedAutopilot",
    "StreamedAttitude",
    "StreamedMotion",
    "Task",
    "hover_thrust",
]
