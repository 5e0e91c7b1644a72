"""Nothing sways: the loop of controller, autopilot and late estimates dies out, with room to spare.

The vehicle answers like a real one (`SwayingAutopilot`): rate and attitude loops, motors, an outer loop at
100 Hz, and an acceleration that is told late. The controller knows one lag and one delay only.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray
from tests.unit.control.control_plants import (
    ControlFlight,
    Loop,
    Motion3,
    PadMotion,
    circle,
    controller,
    figure_eight,
    line,
    still,
)
from tests.unit.control.control_vehicles import SwayingAutopilot

LINK_S = 0.01  # what the simulator's link and loops take; the settings assume more
# outer gains (north, east, down) and integral gains, as PX4's and ArduPilot's parameters have them
AUTOPILOT_KINDS = {
    "px4": ((1.8, 1.8, 4.0), (0.5, 0.5, 2.0)),
    "ardupilot": ((2.0, 2.0, 5.0), (1.0, 1.0, 2.0)),
}


def _nudged(time_s: float) -> Motion3:
    """Hold over the pad, and from the third second on half a metre to the north: a kick."""
    return (0.0 if time_s < 3.0 else 0.5, 0.0, -3.0), ZERO3, ZERO3


def _held(_time_s: float) -> Motion3:
    return (0.0, 0.0, -3.0), ZERO3, ZERO3


def _heave(time_s: float) -> Motion3:
    """A quarter of a metre every 5 s."""
    h, w = 0.25, math.tau / 5.0
    return (
        (0.0, 0.0, h * math.sin(w * time_s)),
        (0.0, 0.0, h * w * math.cos(w * time_s)),
        (0.0, 0.0, -h * w * w * math.sin(w * time_s)),
    )


def _fly(
    autopilot: SwayingAutopilot,
    pad: PadMotion = still,
    offset: Callable[[float], Motion3] = _held,
    *,
    kind: str = "velocity",
    link_s: float = LINK_S,
    noise: float = 0.0,
) -> ControlFlight:
    loop = Loop(controller(setpoint=kind), autopilot, pad, offset, noise=noise, link_delay_s=link_s)
    loop.sensor_lag_s, loop.sensor_delay_s = 0.025, 0.01
    return loop.fly(13.0)


def _tilt_deg(flight: ControlFlight, after_s: float) -> FloatArray:
    """Tilt (n, 2) in degrees, by the acceleration that it gives."""
    keep = np.array(flight.time_s) >= after_s
    tilt: FloatArray = np.degrees(np.array(flight.acceleration_m_s2)[keep, :2] / GRAVITY_M_S2)
    return tilt


def _sway_deg(flight: ControlFlight) -> float:
    """Greatest standard deviation of the tilt in the last five seconds."""
    return float(_tilt_deg(flight, 8.0).std(axis=0).max())


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
@pytest.mark.parametrize("pad", [still, line])
@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_holds_level_and_still_over_a_pad_that_does_not_turn(
    autopilot_kind: str, pad: PadMotion, kind: str
) -> None:
    flight = _fly(SwayingAutopilot(*AUTOPILOT_KINDS[autopilot_kind]), pad, kind=kind, noise=1.0)
    tilt = _tilt_deg(flight, 4.0)
    rates = np.radians(np.diff(tilt, axis=0)) * 30.0
    assert tilt.std(axis=0).max() < 1.0
    assert np.sqrt((rates**2).mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
@pytest.mark.parametrize(
    ("link_s", "slowness"), [(0.0, 1.0), (0.03, 1.0), (0.07, 1.0), (0.03, 0.6), (0.03, 1.4)]
)
def test_a_kick_dies_out_whatever_the_delay_and_the_lag(kind: str, link_s: float, slowness: float) -> None:
    flight = _fly(SwayingAutopilot(slowness=slowness), offset=_nudged, kind=kind, link_s=link_s)
    assert np.abs(_tilt_deg(flight, 3.0)).max() > 1.0  # it was kicked
    assert _sway_deg(flight) < 0.2


@pytest.mark.parametrize("gain_1_s", [1.5, 2.5, 4.0])
@pytest.mark.parametrize("link_s", [0.0, 0.05])
def test_a_kick_dies_out_whatever_the_autopilots_velocity_gain(gain_1_s: float, link_s: float) -> None:
    autopilot = SwayingAutopilot(gain=(gain_1_s, gain_1_s, 2.0 * gain_1_s))
    assert _sway_deg(_fly(autopilot, offset=_nudged, link_s=link_s)) < 0.2


@pytest.mark.parametrize(("pad", "bound_m"), [(circle, 0.04), (figure_eight, 0.06)])
def test_a_turning_pad_is_followed_within_a_few_centimetres(pad: PadMotion, bound_m: float) -> None:
    flight = _fly(SwayingAutopilot(), pad, noise=1.0)
    assert flight.lateral_error_m(5.0) < bound_m


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
@pytest.mark.parametrize("kind", ["velocity", "attitude"])
def test_a_heaving_pad_is_followed_in_height_and_speed(autopilot_kind: str, kind: str) -> None:
    flight = _fly(SwayingAutopilot(*AUTOPILOT_KINDS[autopilot_kind]), _heave, kind=kind)
    speed = np.array(flight.relative_velocity_m_s)[np.array(flight.time_s) >= 5.0, 2]
    assert np.abs(flight.error_m(5.0)[:, 2]).max() < 0.03
    assert np.abs(speed).max() < 0.08


def test_an_attitude_loop_slower_than_the_models_is_not_taken_for_wind() -> None:
    """The tilt itself tells of wind; what lies between command and tilt is hardly believed."""
    flight = _fly(SwayingAutopilot(slowness=1.4), offset=_nudged, kind="attitude")
    push = np.array([report.disturbance_ned_m_s2[0] for report in flight.reports])
    kicked = np.array(flight.time_s) >= 1.0  # it is seen coming
    assert np.abs(_tilt_deg(flight, 1.0)).max() > 1.5
    assert np.abs(push[kicked] - push[kicked][0]).max() < 0.25
