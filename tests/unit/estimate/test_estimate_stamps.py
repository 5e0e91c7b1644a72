"""IMU samples whose times jitter or jump, as another clock's do once turned into ours."""

import math
from dataclasses import replace

import numpy as np

from companion.base.geometry import norm, quat_conjugate, quat_multiply, rotation_vector_from_quat
from companion.base.messages import ImuSample
from tests.unit.estimate.estimate_flight import EstimateFlight, circle, feed, new_estimator

INTERVAL_S = 0.005
FLIGHT = EstimateFlight(circle(3.0, 2.0), seed=5, duration_s=24.0, sensors=frozenset({"imu", "mag", "gps"}))
JUMP_S, STALL_S = 20.0, 0.2


def attitude_errors_deg(jitter_s: float, stall_s: float, *, intervals: bool) -> list[float]:
    """Over the turns of a circle, of the estimate against the truth at the samples' true times.

    The autopilot's clock stands still for `stall_s`: from then on all is measured later by ours.
    """
    rng, estimator, errors = np.random.default_rng(3), new_estimator(), []
    for _, sample in FLIGHT.samples:
        shift_s = stall_s if sample.time_s > JUMP_S else 0.0
        if not isinstance(sample, ImuSample):
            feed(estimator, replace(sample, time_s=sample.time_s + shift_s))
            continue
        off_s = shift_s + float(rng.uniform(-jitter_s, jitter_s))
        interval_s = INTERVAL_S if intervals else None
        estimator.add_imu(replace(sample, time_s=sample.time_s + off_s, interval_s=interval_s))
        state = estimator.vehicle(sample.time_s + off_s)
        if state is not None and sample.time_s > 16.0:
            apart = quat_multiply(quat_conjugate(FLIGHT.attitude(sample.time_s)), state.attitude)
            errors.append(math.degrees(norm(rotation_vector_from_quat(apart))))
    return errors


def test_times_that_jitter_do_not_turn_the_attitude() -> None:
    smooth = attitude_errors_deg(0.0, 0.0, intervals=True)
    jittery = attitude_errors_deg(0.002, 0.0, intervals=True)
    assert max(jittery) < max(smooth) + 0.5
    assert np.mean(jittery) < np.mean(smooth) + 0.1


def test_a_jump_of_the_times_without_one_of_the_stamps_turns_nothing() -> None:
    smooth = attitude_errors_deg(0.0, 0.0, intervals=True)
    jumped = attitude_errors_deg(0.0, STALL_S, intervals=True)
    by_times_alone = attitude_errors_deg(0.0, STALL_S, intervals=False)
    assert max(jumped) < max(smooth) + 0.5
    assert max(by_times_alone) > max(jumped) + 2.0
