"""The autopilot as a second gyroscope: a step of our bias is found, and nothing that only looks like one."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_integrate,
    quat_multiply,
    rotation_vector_from_quat,
    scale,
    subtract,
    vector3,
)
from companion.base.messages import AutopilotAttitude
from companion.estimate.motion import MotionHistory
from companion.estimate.vehicle.gyro_bias_check import BiasStep, SecondGyro
from tests.attitudes import DEGREE

Told = Callable[[float], tuple[float, Quaternion] | None]  # what arrives from the autopilot, if anything

IMU_S = 0.005
TOLD_EVERY = 8  # samples of the IMU: 25 Hz
BIAS = (0.01, -0.01, 0.005)
STEP_S = 20.0


def turning(t: float) -> Quaternion:
    """15 degrees to and fro in 3 s, 10 in 4 s, and turns of heading with 0.5 rad/s² at most."""
    return quat_from_euler(
        15 * DEGREE * math.sin(2.1 * t), 10 * DEGREE * math.sin(1.6 * t), 1.5 * math.sin(0.57 * t)
    )


def gentle(t: float) -> Quaternion:
    """As a hovering vehicle moves."""
    return quat_from_euler(
        2 * DEGREE * math.sin(1.1 * t), 2 * DEGREE * math.sin(0.9 * t), 0.3 * math.sin(0.4 * t)
    )


def yawing(t: float) -> Quaternion:
    """A steady turn of 3 degrees a second."""
    return quat_from_euler(0.0, 0.0, 3 * DEGREE * t)


@dataclass(frozen=True)
class SteppedBias:
    """A motion, and by how much our gyroscope's bias steps at STEP_S."""

    attitude: Callable[[float], Quaternion] = turning
    step_rad_s: Vector3 = ZERO3
    seconds: float = 60.0
    seed: int = 1
    found: list[tuple[float, BiasStep]] = field(default_factory=list)

    def noisy(self, t: float) -> Quaternion:
        """The autopilot's attitude, off by 0.05 degrees a reading."""
        rng = np.random.default_rng((self.seed, max(round(t * 1e4), 0)))
        return quat_multiply(
            self.attitude(t), quat_from_rotation_vector(vector3(0.05 * DEGREE * rng.normal(size=3)))
        )

    def run(self, told: Told | None = None) -> list[tuple[float, BiasStep]]:
        """(time, step) of all that is found; a step found is believed from then on."""
        motion, believed = MotionHistory(3.0), BIAS
        gyro, ours = SecondGyro(motion), IDENTITY
        rng = np.random.default_rng(self.seed)
        before = self.attitude(0.0)
        for k in range(1, round(self.seconds / IMU_S)):
            t = k * IMU_S
            now = self.attitude(t)
            rate = scale(rotation_vector_from_quat(quat_multiply(quat_conjugate(before), now)), 1.0 / IMU_S)
            before = now
            bias = add(BIAS, self.step_rad_s) if t >= STEP_S else BIAS
            measured = add(add(rate, bias), vector3(0.003 * rng.normal(size=3)))
            ours = quat_integrate(ours, subtract(measured, believed), IMU_S)
            motion.add(t, ours, ZERO3)
            heard = (told or self.on_time)(t) if k % TOLD_EVERY == 0 else None
            step = gyro.add_attitude(AutopilotAttitude(*heard), believed) if heard is not None else None
            if step is not None:
                self.found.append((t, step))
                believed = step.gyro_bias_rad_s
        return self.found

    def on_time(self, t: float) -> tuple[float, Quaternion]:
        return t - 0.01, self.noisy(t - 0.01)


@pytest.mark.parametrize("attitude", [gentle, yawing])
@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.577, 0.577, 0.577)])
def test_a_step_of_two_degrees_a_second_is_found_within_one_and_a_half_seconds(
    attitude: Callable[[float], Quaternion], direction: Vector3
) -> None:
    change = scale(direction, 2 * DEGREE)
    found = SteppedBias(attitude, change, 25.0).run()
    assert len(found) == 1
    time_s, step = found[0]
    assert 0.5 < time_s - STEP_S <= 1.5
    assert step.gyro_bias_rad_s == pytest.approx(add(BIAS, change), abs=0.5 * DEGREE)
    assert step.for_s == pytest.approx(time_s - STEP_S, abs=0.35)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_step_is_found_once_and_well_in_a_turning_flight_too(direction: Vector3) -> None:
    change = scale(direction, 2 * DEGREE)
    found = SteppedBias(turning, change, 40.0).run()
    assert len(found) == 1
    assert found[0][0] - STEP_S < 4.5
    assert found[0][1].gyro_bias_rad_s == pytest.approx(add(BIAS, change), abs=0.6 * DEGREE)


def test_nothing_is_found_in_a_minute_of_turning_without_a_step() -> None:
    assert SteppedBias().run() == []


def test_the_autopilots_heading_and_horizon_are_its_own() -> None:
    setting = SteppedBias(seconds=30.0)
    off = quat_from_euler(0.05, -0.04, 2.0)
    assert setting.run(lambda t: (t - 0.01, quat_multiply(off, setting.noisy(t - 0.01)))) == []


def test_an_autopilot_mounted_askew_is_no_step() -> None:
    setting = SteppedBias()
    askew = quat_from_euler(DEGREE, -DEGREE, DEGREE)
    assert setting.run(lambda t: (t - 0.01, quat_multiply(setting.noisy(t - 0.01), askew))) == []


@pytest.mark.parametrize("delay_s", [0.02, 0.05, -0.03])
def test_a_wrong_time_is_no_step(delay_s: float) -> None:
    setting = SteppedBias()
    assert setting.run(lambda t: (t - 0.01, setting.noisy(t - 0.01 - delay_s))) == []


@pytest.mark.parametrize("silent_s", [0.5, 3.0])
def test_an_autopilot_that_falls_silent_now_and_then_is_no_step(silent_s: float) -> None:
    setting = SteppedBias()
    assert setting.run(lambda t: None if t % 5.0 < silent_s else setting.on_time(t)) == []


def test_a_silence_is_not_bridged_but_a_step_is_found_after_it() -> None:
    setting = SteppedBias(gentle, (0.0, 2 * DEGREE, 0.0), 25.0)
    found = setting.run(lambda t: None if 20.3 < t < 21.3 else setting.on_time(t))
    assert [22.2 < time_s < 23.0 for time_s, _ in found] == [True]


@pytest.mark.parametrize("attitude", [turning, yawing])
def test_a_frozen_attitude_is_no_step(attitude: Callable[[float], Quaternion]) -> None:
    setting = SteppedBias(attitude, seconds=30.0)
    assert setting.run(lambda t: (t - 0.01, setting.noisy(min(t, 10.0) - 0.01))) == []


@pytest.mark.parametrize("attitude", [turning, gentle])
def test_attitudes_out_of_order_are_no_step_and_hide_none(attitude: Callable[[float], Quaternion]) -> None:
    stepping = attitude is gentle
    change = (2 * DEGREE, 0.0, 0.0) if stepping else ZERO3
    setting, order = SteppedBias(attitude, change), np.random.default_rng(3)

    def shuffled(t: float) -> tuple[float, Quaternion]:
        time_s = t - 0.01 - float(order.choice([0.0, 0.0, 0.1, 0.4]))
        return time_s, setting.noisy(time_s)

    assert [time_s - STEP_S < 2.0 for time_s, _ in setting.run(shuffled)] == [True] * stepping


def test_a_change_too_large_for_a_bias_is_none() -> None:
    assert SteppedBias(gentle, (0.0, 15 * DEGREE, 0.0), 25.0).run() == []


@pytest.mark.parametrize("jump_deg", [1.0, 2.0, 4.0, 7.0, 40.0])
def test_a_heading_set_anew_is_no_step(jump_deg: float) -> None:
    setting = SteppedBias(gentle, seconds=25.0)

    def told(t: float) -> tuple[float, Quaternion]:
        jump = quat_from_euler(0.0, 0.0, jump_deg * DEGREE * (t // 2.1))
        return t - 0.01, quat_multiply(jump, setting.noisy(t - 0.01))

    assert setting.run(told) == []


def test_corrections_of_our_attitude_are_no_turn_of_the_gyroscope() -> None:
    """GPS and compass turn ours by 3 deg/s for two seconds, the gyroscope is right."""
    motion, ours = MotionHistory(3.0), IDENTITY
    gyro = SecondGyro(motion)
    for k in range(1, 800):
        t = k * IMU_S
        ours = quat_integrate(ours, (0.2, -0.1, 0.3), IMU_S)
        if 1.0 < t < 3.0 and k % 4 == 0:
            correction = (0.0, 0.06 * DEGREE, 0.0)
            motion.correct(correction)
            ours = quat_multiply(quat_from_rotation_vector(correction), ours)
        motion.add(t, ours, ZERO3)
        truth = quat_from_rotation_vector(scale((0.2, -0.1, 0.3), t))
        if k % TOLD_EVERY == 0:
            assert gyro.add_attitude(AutopilotAttitude(t, truth), ZERO3) is None
