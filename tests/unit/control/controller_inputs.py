"""A vehicle, a pad and references for the controller's step."""

from dataclasses import replace

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    Vector3,
    quat_conjugate,
    quat_rotate,
    side_force,
    subtract,
)
from companion.base.messages import PadState, Phase, PlanStep, Reference, VehicleState
from tests.unit.control.control_plants import reference_rows

PERIOD_S = 1.0 / 30.0


def vehicle_state(now_s: float, **changes: object) -> VehicleState:
    """A vehicle that hovers, with changes; its accelerometer feels what its acceleration and attitude say."""
    state = VehicleState(
        time_s=now_s,
        attitude=IDENTITY,
        rate_body_rad_s=ZERO3,
        position_ned_m=(10.0, -4.0, -7.0),
        velocity_ned_m_s=ZERO3,
        acceleration_ned_m_s2=ZERO3,
        gyro_bias_rad_s=ZERO3,
        accel_bias_m_s2=ZERO3,
        attitude_std_rad=0.01,
        velocity_std_m_s=0.05,
        position_std_m=0.5,
        aligned=True,
        has_gps=True,
    )
    state = replace(state, **changes)  # type: ignore[arg-type]
    felt = subtract(state.acceleration_ned_m_s2, (0.0, 0.0, GRAVITY_M_S2))
    body = quat_rotate(quat_conjugate(state.attitude), felt)
    return replace(state, side_force_ned_m_s2=side_force(state.attitude, body))


def pad_state(now_s: float, relative: Vector3 = (0.0, 0.0, 2.0), velocity: Vector3 = ZERO3) -> PadState:
    return PadState(
        now_s, relative, velocity, velocity, ZERO3, 0.0, 0.0, 0.01, 0.02, seen_time_s=now_s - 0.07
    )


def hover_reference(
    now_s: float, origin: str = "pad", height: float = 2.0, heading_rad: float = 0.0
) -> Reference:
    place = ((0.0, 0.0, -height), ZERO3, ZERO3)
    return reference_rows(now_s, lambda _t: place, origin=origin, heading_rad=heading_rad)


def plan_step(
    now_s: float, reference: Reference | None, *, on_ground: bool = False, unloading: float = 0.0
) -> PlanStep:
    return PlanStep(now_s, Phase.DESCEND, reference, on_ground=on_ground, unloading=unloading)
