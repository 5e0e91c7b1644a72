"""A vehicle, a pad and references for the controller's step."""

from dataclasses import replace
from typing import Any

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
from companion.base.messages import (
    ControlReport,
    PadState,
    Phase,
    PlanStep,
    Reference,
    Setpoint,
    VehicleState,
)
from companion.control.controller import Controller
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


def plan_step(now_s: float, reference: Reference | None, **given: Any) -> PlanStep:
    return PlanStep(now_s, given.pop("phase", Phase.DESCEND), reference, **given)


def answered(
    fly: Controller,
    now_s: float = 0.0,
    *,
    reference: Reference | None = None,
    vehicle: VehicleState | None = None,
    pad: PadState | None = None,
    seen: bool = True,
    heard: dict[str, Any] | None = None,
    **plan: Any,
) -> tuple[Setpoint, ControlReport]:
    """What it sends at this time; by default as it hovers 2 m over a pad and shall stay."""
    answer = fly.step(
        plan_step(now_s, reference or hover_reference(now_s), **plan),
        vehicle or vehicle_state(now_s),
        (pad or pad_state(now_s)) if seen else None,
        now_s,
        **(heard or {}),
    )
    assert answer is not None
    return answer
