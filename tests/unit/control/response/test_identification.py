"""Identification: the numbers that were flown with come out, with deviations that mean something."""

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.control.response.flight_model import advance_axis
from companion.control.response.identification import (
    IdentifiedResponse,
    ResponseEstimate,
    ResponseRecord,
    TooLittleError,
    fit,
    hover_thrust,
    prediction_error_m_s,
    windows,
)

PERIOD_S = 1.0 / 30.0
DELAY_S = 0.06
ASSUMED = IdentifiedResponse(2.2, 0.11)


def _flight(
    truth: IdentifiedResponse,
    seed: int,
    *,
    seconds: float = 25.0,
    excitation: float = 1.0,
    offset: float = 0.6,
) -> ResponseRecord:
    """Three axes that answer smoothed random commands, with wander, estimate noise and a late link.

    The velocity commanded is off the one flown by `offset` (m/s), which is what tells the gain.
    """
    rng, steps = np.random.default_rng(seed), round(seconds / PERIOD_S)
    late = DELAY_S / PERIOD_S
    smooth = np.exp(-0.5 * (np.arange(-20, 21) / 6.0) ** 2) / 6.0

    def wander(size: float) -> FloatArray:
        rows = [np.convolve(rng.normal(size=steps), smooth, "same") for _ in range(3)]
        return size * np.stack(rows, axis=1)

    feed, aside, push = wander(excitation), wander(excitation * offset), 0.2 * wander(1.0) + 0.4
    velocity, command = np.zeros((steps, 3)), np.zeros((steps, 3))
    for axis in range(3):
        p, v, a = 0.0, 0.0, 0.0
        for k in range(steps):
            velocity[k, axis], command[k, axis] = v, v + aside[k, axis]
            for piece in range(4):  # the command that is in effect by then
                at = k - late + piece / 4
                then = [np.interp(at, np.arange(k + 1), rows[: k + 1, axis]) for rows in (feed, command)]
                wanted = then[0] + (truth.gain_1_s * (then[1] - v)) + push[k, axis]
                p, v, a = advance_axis((p, v, a), wanted, PERIOD_S / 4, truth.lag_s)
    return ResponseRecord(
        time_s=PERIOD_S * np.arange(steps, dtype=np.float64),
        velocity_ned_m_s=velocity + rng.normal(0.0, 0.004, velocity.shape),
        force_m_s2=np.full(steps, GRAVITY_M_S2),
        command_velocity_ned_m_s=command,
        command_acceleration_ned_m_s2=feed,
        thrust=None,
        pieces=((20, steps // 2), (steps // 2 + 10, steps)),
    )


@pytest.mark.parametrize("truth", [IdentifiedResponse(1.4, 0.28), IdentifiedResponse(3.5, 0.15)])
def test_gain_and_lag_come_out_and_predict_a_flight_that_was_not_fitted(truth: IdentifiedResponse) -> None:
    fitted, held_out = (windows(_flight(truth, seed), (0, 1), DELAY_S) for seed in (1, 2))
    found = fit(fitted, ASSUMED)
    assert found.response.gain_1_s == pytest.approx(truth.gain_1_s, rel=0.1)
    assert found.response.lag_s == pytest.approx(truth.lag_s, rel=0.1)
    assert abs(found.response.gain_1_s - truth.gain_1_s) < 4.0 * found.gain_std_1_s
    assert abs(found.response.lag_s - truth.lag_s) < 4.0 * found.lag_std_s
    assert prediction_error_m_s(held_out, found.response) < 0.8 * prediction_error_m_s(held_out, ASSUMED)


def test_a_gain_that_nothing_asked_for_stays_and_the_lag_still_comes_out() -> None:
    truth = IdentifiedResponse(2.2, 0.25)
    found = fit(windows(_flight(truth, 3, offset=0.0), (0, 1), DELAY_S), ASSUMED)
    assert found.response.gain_1_s == ASSUMED.gain_1_s
    assert np.isinf(found.gain_std_1_s)
    assert found.response.lag_s == pytest.approx(0.25, rel=0.1)


def test_what_does_not_contradict_the_settings_changes_nothing() -> None:
    found = ResponseEstimate(IdentifiedResponse(3.0, 0.13), gain_std_1_s=0.3, lag_std_s=0.02, windows=20)
    assert found.adopted(ASSUMED) == IdentifiedResponse(3.0, ASSUMED.lag_s)


def test_by_attitude_there_is_no_gain() -> None:
    truth = IdentifiedResponse(0.0, 0.16)
    found = fit(windows(_flight(truth, 4, seconds=12.0), (0, 1), DELAY_S), IdentifiedResponse(0.0, 0.11))
    assert found.response.gain_1_s == 0.0
    assert found.response.lag_s == pytest.approx(0.16, rel=0.1)


def test_a_flight_in_which_nothing_moves_or_that_is_too_short_says_so() -> None:
    calm = _flight(ASSUMED, 5, excitation=0.004)
    with pytest.raises(TooLittleError, match="too little excitation: lag known"):
        fit(windows(calm, (2,), DELAY_S), ASSUMED)
    short = _flight(ASSUMED, 6, seconds=4.0)
    with pytest.raises(TooLittleError, match=r"3 windows of 1 s of flight by setpoints, expected 10"):
        windows(short, (0, 1), DELAY_S)


def _hovering(thrust: FloatArray | None, noise: float = 0.3, steps: int = 600) -> ResponseRecord:
    rng, still = np.random.default_rng(7), np.zeros((steps, 3))
    force = GRAVITY_M_S2 / 0.43 * (np.full(steps, 0.43) if thrust is None else thrust)
    force = force + rng.normal(0.0, noise, steps)
    return ResponseRecord(
        PERIOD_S * np.arange(steps, dtype=np.float64), still, force, still, still, thrust, ((0, steps),)
    )


def test_hover_thrust_is_what_carries_the_weight() -> None:
    thrust = 0.45 + 0.05 * np.sin(0.7 * PERIOD_S * np.arange(600))
    hover, std = hover_thrust(_hovering(thrust))
    assert hover == pytest.approx(0.43, rel=0.01)
    assert abs(hover - 0.43) < 4.0 * std


def test_without_thrust_or_with_one_that_does_not_fit_there_is_no_hover_thrust() -> None:
    with pytest.raises(TooLittleError, match="no thrust in the log"):
        hover_thrust(_hovering(None))
    with pytest.raises(TooLittleError, match="1 s of flight"):
        hover_thrust(_hovering(np.full(45, 0.43), steps=45))
    erratic = np.random.default_rng(8).uniform(0.2, 0.8, 20).repeat(30)
    flown = _hovering(None)
    with pytest.raises(TooLittleError, match="expected 2 %"):
        hover_thrust(
            ResponseRecord(
                flown.time_s,
                flown.velocity_ned_m_s,
                flown.force_m_s2,
                flown.command_velocity_ned_m_s,
                flown.command_acceleration_ned_m_s2,
                erratic,
                flown.pieces,
            )
        )
