"""Weak motors: what is left of each command, and that the vehicle feels it."""

from __future__ import annotations

import pytest

from companion.config import validate
from sitl.scenario.scenario import Scenario
from sitl.vehicle.quadrotor import Motors, QuadrotorState
from sitl.world.world import World

HOVER = (0.5, 0.5, 0.5, 0.5)


def test_sound_motors_give_what_is_asked() -> None:
    assert Motors().given(HOVER) is HOVER


def test_one_is_weak_or_all_are_and_mended_they_are_sound() -> None:
    motors = Motors()
    motors.weaken(2, 0.85)
    assert motors.given((0.2, 0.4, 0.6, 0.8)) == pytest.approx((0.2, 0.34, 0.6, 0.8))
    motors.weaken(None, 0.5)
    assert motors.given((0.2, 0.4, 0.6, 0.8)) == pytest.approx((0.1, 0.17, 0.3, 0.4))
    motors.clear_faults()
    assert motors.given(HOVER) is HOVER


def rates_after(motor: int | None, share: float) -> tuple[float, float, float, float]:
    """Body rates and climb speed after a fifth of a second in the air with equal commands."""
    world = World(validate(Scenario, {"name": "x", "description": "x"}, "x"), 0)
    world.place(QuadrotorState((0.0, 0.0, -20.0), thrust_share=HOVER))
    world.motors.weaken(motor, share)
    for _ in range(80):
        world.step(HOVER, 0.0025)
    return (*world.state.rate_body_rad_s, world.state.velocity_ned_m_s[2])


@pytest.mark.parametrize(
    ("motor", "axis", "sign"),
    [(1, 1, -1.0), (2, 0, -1.0), (3, 1, 1.0), (4, 0, 1.0)],  # front: nose down; right: right side down...
)
def test_the_vehicle_sinks_on_the_side_of_a_weak_motor(motor: int, axis: int, sign: float) -> None:
    # negative pitch rate is nose down, positive roll rate right side down
    rates = rates_after(motor, 0.85)
    expected = sign if axis == 1 else -sign
    assert rates[axis] * expected > 0.3
    assert abs(rates[1 - axis]) < 0.1


def test_a_sagging_battery_costs_lift_and_turns_nothing() -> None:
    sound, sagging = rates_after(None, 1.0), rates_after(None, 0.9)
    # a tenth of g for a fifth of a second, less the motors' lag
    assert 0.12 < sagging[3] - sound[3] < 0.19
    assert max(abs(rate) for rate in sagging[:3]) < 1e-6
