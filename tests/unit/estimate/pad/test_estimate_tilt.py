"""A deck's tilt: followed, its swing measured, its level moments predicted."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import ZERO3
from companion.base.messages import PadState
from companion.base.motion import Motion
from companion.config import PadFilterConfig, TouchdownConfig
from companion.estimate.pad.tilt_filter import LEVEL, TiltState
from companion.plan.landing.success import SuccessEstimate, tilt_in_rad

FRAME_S = 1.0 / 30.0
ROLL_RAD, PERIOD_S, LIST_RAD = math.radians(8.0), 8.0, math.radians(2.0)


def rolling(time_s: float) -> tuple[float, float]:
    """A deck that lists to the east and rolls about that."""
    return 0.0, LIST_RAD + ROLL_RAD * math.sin(math.tau * time_s / PERIOD_S)


def watched(seconds: float, noise_rad: float = math.radians(0.5)) -> TiltState:
    rng, density = np.random.default_rng(4), PadFilterConfig().tilt_acceleration_rad_s2_rthz
    state = TiltState.first(rolling(0.0), noise_rad)
    for k in range(1, round(seconds / FRAME_S)):
        north, east = np.add(rolling(k * FRAME_S), noise_rad * rng.standard_normal(2)).tolist()
        state = state.after(FRAME_S, density).corrected((north, east), noise_rad, FRAME_S)
    return state


def pad_of(tilt: TiltState) -> PadState:
    pad = PadState(0.0, (0.0, 0.0, 0.5), ZERO3, ZERO3, ZERO3, 0.0, 0.0, 0.01, 0.01, 0.0)
    return replace(
        pad,
        tilt_rad=tilt.tilt_rad,
        tilt_rate_rad_s=tilt.rate_rad_s,
        tilt_mean_rad=tilt.mean_rad,
        tilt_swing_rad=tilt.swing_rad,
        tilt_frequency_rad_s=tilt.frequency_rad_s,
    )


def test_tilt_and_rate_are_followed() -> None:
    tilt, time_s = watched(25.0), 25.0 - FRAME_S
    rate = ROLL_RAD * math.tau / PERIOD_S * math.cos(math.tau * time_s / PERIOD_S)
    assert tilt.tilt_rad[1] == pytest.approx(rolling(time_s)[1], abs=math.radians(0.6))
    assert tilt.rate_rad_s[1] == pytest.approx(rate, abs=math.radians(1.5))


def test_list_swing_and_period_are_measured() -> None:
    tilt = watched(40.0)
    assert tilt.mean_rad[1] == pytest.approx(LIST_RAD, abs=math.radians(2.0))
    assert tilt.swing_rad == pytest.approx(ROLL_RAD / math.sqrt(2.0), rel=0.25)
    assert math.tau / tilt.frequency_rad_s == pytest.approx(PERIOD_S, rel=0.3)


@pytest.mark.parametrize("seconds", [24.0, 26.0, 28.0, 30.0])
def test_tilt_is_predicted_through_a_quarter_of_the_swing(seconds: float) -> None:
    ahead_s = PERIOD_S / 4.0
    will_be = math.hypot(*rolling(seconds - FRAME_S + ahead_s))
    tilt_rad, std_rad = tilt_in_rad(pad_of(watched(seconds)), ahead_s)
    assert tilt_rad == pytest.approx(will_be, abs=math.radians(3.0))
    assert abs(tilt_rad - will_be) < 2.0 * std_rad


def pad_level(pad: PadState, ahead_s: float) -> float:
    """The probability that a contact so much later meets it level enough."""
    success = SuccessEstimate(TouchdownConfig())
    likely = success.factors(
        pad,
        pad.vehicle_from_pad,
        ahead_s,
        sink_m_s=0.2,
        contact=Motion(ZERO3),
        drift=(0.0, 0.0),
        slack=1.0,
    )
    return likely["pad tilt"]


def test_a_slope_that_does_not_swing_is_met_at_any_time() -> None:
    slope = replace(pad_of(LEVEL), tilt_rad=(0.2, 0.0), tilt_mean_rad=(0.2, 0.0), tilt_swing_rad=0.001)
    assert pad_level(slope, 0.0) == 1.0


def test_a_deck_at_its_roll_is_waited_for() -> None:
    roll = replace(
        pad_of(LEVEL),
        tilt_rad=(0.0, ROLL_RAD),
        tilt_swing_rad=ROLL_RAD / math.sqrt(2.0),
        tilt_frequency_rad_s=math.tau / PERIOD_S,
    )
    assert pad_level(roll, 0.0) < 0.01
    assert pad_level(roll, PERIOD_S / 4.0) > 0.9
