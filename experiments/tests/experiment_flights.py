"""Made-up flights for the experiments' tests: known paths, known errors."""

from typing import Any

import numpy as np

from companion.base.geometry import IDENTITY, ZERO3, Vector3, geodetic_from_ned, vector3
from companion.base.messages import GpsFix, Outcome, Phase, PlanStep, Truth, VehicleState
from companion.flightlog.result import (
    CameraResult,
    EstimateResult,
    FirstContact,
    Latency,
    PadResult,
    PhaseTimes,
    Result,
    SimResult,
)
from sitl.scenario.scenario import USUAL_HOMES

HOME = USUAL_HOMES["px4"]


def result(outcome: Outcome = Outcome.LANDED) -> Result:
    """A score with a touchdown at 0.2 m/s, 3 cm beside the middle."""
    return Result(
        scenario="made up",
        seed=5,
        outcome=outcome,
        touchdown=FirstContact(
            lateral_error_m=0.03,
            vertical_speed_m_s=0.2,
            horizontal_speed_m_s=0.0,
            tilt_deg=0.0,
            yaw_error_deg=0.0,
        ),
        pad=PadResult(speed_m_s=1.0),
        time=PhaseTimes(search_s=0.0, approach_s=0.0, descent_s=0.0, total_s=0.0),
        vision=CameraResult(frames=0, frames_with_pad=0, relative_position_rmse_m=None),
        estimate=EstimateResult(attitude_rmse_deg=None, velocity_rmse_m_s=None, pad_velocity_rmse_m_s=None),
        latency_ms=Latency(exposure_to_setpoint_p50=None, exposure_to_setpoint_p99=None),
        sim=SimResult(real_time_factor=1.0),
        events=(),
    )


def truth(time_s: float, position: Vector3, velocity: Vector3 = ZERO3, *, touching: bool = False) -> Truth:
    """One record over a pad that drives east at 1 m/s from the origin."""
    return Truth(
        time_s=time_s,
        vehicle_position_ned_m=position,
        vehicle_velocity_ned_m_s=velocity,
        vehicle_attitude=IDENTITY,
        pad_position_ned_m=(0.0, time_s, 0.0),
        pad_velocity_ned_m_s=(0.0, 1.0, 0.0),
        pad_heading_rad=0.0,
        in_contact=touching,
    )


def fix(time_s: float, position: Vector3) -> GpsFix:
    """A fix that says that place (NED from home)."""
    return GpsFix(time_s, *geodetic_from_ned(position, HOME), ZERO3, 1.0, 1.5, 0.1, 9)


def state(time_s: float, position: Vector3, origin: Vector3) -> VehicleState:
    """An estimate of that place (NED from home), counted from an origin (NED from home too)."""
    own = vector3(np.subtract(position, origin).tolist())
    return VehicleState(
        time_s=time_s,
        attitude=IDENTITY,
        rate_body_rad_s=ZERO3,
        position_ned_m=own,
        velocity_ned_m_s=ZERO3,
        acceleration_ned_m_s2=ZERO3,
        gyro_bias_rad_s=ZERO3,
        accel_bias_m_s2=ZERO3,
        attitude_std_rad=0.0,
        velocity_std_m_s=0.0,
        position_std_m=0.0,
        aligned=True,
        has_gps=True,
        origin=geodetic_from_ned(origin, HOME),
    )


def plans(*begun: tuple[float, Phase]) -> list[Any]:
    """A plan for each phase when it began."""
    return [PlanStep(time_s, phase) for time_s, phase in begun]
