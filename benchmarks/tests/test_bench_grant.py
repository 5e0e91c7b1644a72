"""How the bench of the grant judges: by the fall below the highest since the first setpoint."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.control.bench_grant import Grant, GrantWitness, bar, rows, scenario_of
from companion.link.codec import mavlink


def attitude_setpoint() -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    message = mavlink.MAVLink_set_attitude_target_message(
        0, 1, 1, 0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5
    )
    return bytes(message.pack(mav))


def fallen(heights_m: list[float], first: int, descends_m_s: float = 0.0, text: str = "") -> Grant:
    """What the witness finds when the first setpoint comes at that step; the plan descends so fast."""
    found = Grant(1.0, 0, texts=[text])
    state = SimpleNamespace(position_ned_m=(0.0, 0.0, 0.0))
    world = SimpleNamespace(state=state, time_s=0.0)
    simulation: Any = SimpleNamespace(world=world)
    plan = SimpleNamespace(reference=SimpleNamespace(velocity_m_s=np.array([[0.0, 0.0, descends_m_s]])))
    log: Any = SimpleNamespace(kept={"plan": [plan]})
    witness = GrantWitness(simulation, found, log)
    for k, height_m in enumerate(heights_m):
        state.position_ned_m, world.time_s = (0.0, 0.0, -height_m), 0.1 * k
        witness.step()
        if k == first:
            witness.hear(attitude_setpoint(), world.time_s)
    return found


def test_a_fall_is_what_is_lost_from_the_highest_after_the_first_setpoint() -> None:
    assert fallen([9.0, 5.0, 5.2, 4.8, 5.3], 1).fall_m == pytest.approx(0.4)
    assert fallen([5.0, 4.0, 3.0], 9).began_s is None


def test_what_the_plan_descends_is_no_fall_unless_it_was_moved_after_the_vehicle() -> None:
    heights_m = [5.0, 4.95, 4.9, 4.7, 4.7]
    assert fallen(heights_m, 0, 0.5).fall_m == pytest.approx(0.15)
    moved = fallen(heights_m, 0, 0.5, "reference error 1.0 m: replanned")
    assert moved.fall_m == pytest.approx(0.3)


def test_the_vehicle_needs_another_hover_thrust_than_was_told() -> None:
    built = scenario_of(1.6).built(3)
    assert built.hover_thrust == 1.0 / 1.6
    assert (built.mass, built.thrust_exponent) == (1.0, 1.0)


def test_the_bar_is_on_the_worst_and_needs_one_that_was_taken() -> None:
    grants = [
        Grant(0.5, 0, 9.0, lag_m=0.1),
        Grant(0.5, 1, 9.0, lag_m=0.31),
        Grant(1.6, 0, texts=["abort: no"]),
    ]
    assert not bar("bundled", grants).holds
    assert bar("bundled", grants[:1]).holds
    assert not bar("bundled", grants[2:]).holds
    lines = rows("bundled", grants)
    assert "2/2 taken, worst fall  0.31 m (seed 1)" in lines[0]
    assert "0/1 taken" in lines[1]
    assert "abort: no" in lines[1]
