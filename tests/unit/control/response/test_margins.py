"""Every loop that is shipped has margins, and what is computed is what the controller that flies does."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.control.margins import (
    DOWN,
    SIDEWAYS,
    MarginCase,
    Margins,
    loop_transfer,
    margins,
    respond,
    while_turning,
)
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray
from companion.config import (
    CONFIG_FOLDER,
    AxisResponse,
    ControlConfig,
    Kind,
    VehicleConfig,
    find_file,
    load_model,
)
from companion.control.adaptive_feedforward import FASTEST_TURN_SHARE, learning_s
from companion.control.response.fitting import fitted, loop_rad_s

VEHICLES = sorted(path.stem for path in (CONFIG_FOLDER / "vehicles").glob("*.yaml"))
FLOWN: tuple[tuple[AutopilotKind, Kind], ...] = (
    ("px4", "acceleration"),
    ("px4", "attitude"),
    ("ardupilot", "attitude"),
)
LEAST_DELAY_S, LEAST_PHASE_DEG, LEAST_GAIN = 0.1, 45.0, 10.0 ** (6.0 / 20.0)
KICK_M_S2 = 0.5


@cache
def _case(vehicle: str, autopilot_kind: AutopilotKind, kind: Kind, axis: int) -> MarginCase:
    config = load_model(VehicleConfig, find_file("vehicles", vehicle))
    response = config.responses.of(autopilot_kind, kind)
    along = response.sideways if axis == SIDEWAYS else response.down
    return MarginCase(ControlConfig(setpoint=kind), config, autopilot_kind, axis, along)


@cache
def _loop(case_of: tuple[str, AutopilotKind, Kind, int]) -> tuple[FloatArray, NDArray[np.complex128]]:
    return loop_transfer(_case(*case_of))


@cache
def _margins(case_of: tuple[str, AutopilotKind, Kind, int]) -> Margins:
    return margins(*_loop(case_of))


@pytest.mark.parametrize("axis", [SIDEWAYS, DOWN])
@pytest.mark.parametrize(("autopilot_kind", "kind"), FLOWN)
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_every_shipped_loop_has_margins(
    vehicle: str, autopilot_kind: AutopilotKind, kind: Kind, axis: int
) -> None:
    found = _margins((vehicle, autopilot_kind, kind, axis))
    assert found.delay_s >= LEAST_DELAY_S
    assert found.phase_deg >= LEAST_PHASE_DEG
    assert found.gain_up >= LEAST_GAIN
    assert found.gain_down >= LEAST_GAIN


@pytest.mark.parametrize("late_s", [0.02, 0.05])
@pytest.mark.parametrize("axis", [SIDEWAYS, DOWN])
@pytest.mark.parametrize(("autopilot_kind", "kind"), FLOWN)
def test_an_acceleration_measured_later_than_believed_leaves_the_margins(
    autopilot_kind: AutopilotKind, kind: Kind, axis: int, late_s: float
) -> None:
    case = replace(_case("x500", autopilot_kind, kind, axis), sensor_late_s=late_s)
    found = margins(*loop_transfer(case))
    assert found.delay_s >= LEAST_DELAY_S
    assert found.phase_deg >= LEAST_PHASE_DEG
    assert found.gain_up >= LEAST_GAIN


@pytest.mark.parametrize(("autopilot_kind", "kind"), FLOWN)
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_what_is_learnt_over_a_turning_pad_leaves_the_margins(
    vehicle: str, autopilot_kind: AutopilotKind, kind: Kind
) -> None:
    case = _case(vehicle, autopilot_kind, kind, SIDEWAYS)
    response = case.vehicle.responses.of(autopilot_kind, kind)
    weights = fitted(case.control, response).horizontal
    w, L = _loop((vehicle, autopilot_kind, kind, SIDEWAYS))
    fastest_rad_s = FASTEST_TURN_SHARE * loop_rad_s(weights)
    for turn_rad_s in np.linspace(-fastest_rad_s, fastest_rad_s, 9).tolist():
        found = margins(w, while_turning(w, L, turn_rad_s, learning_s(weights)))
        assert found.delay_s >= LEAST_DELAY_S
        assert found.phase_deg >= LEAST_PHASE_DEG
        assert found.gain_up >= LEAST_GAIN
        assert found.gain_down >= LEAST_GAIN


def _answer(case: MarginCase, from_s: float) -> float:
    """The most that the MPC itself, constraints and all, commands later than `from_s` after a kick (m/s2).

    One that swings up to its limits may fail to solve in the end, and stops.
    """
    kicks = np.zeros(round(30.0 * case.control.rate_hz))
    kicks[3] = KICK_M_S2
    answers = np.abs(respond(case, kicks, controller="mpc"))
    return float(answers[round(from_s * case.control.rate_hz) :].max())


@pytest.mark.parametrize(
    "case_of",
    [
        ("x500", "px4", "acceleration", SIDEWAYS),
        pytest.param(("x500", "ardupilot", "attitude", SIDEWAYS), marks=pytest.mark.slow),
        pytest.param(("x500", "px4", "attitude", DOWN), marks=pytest.mark.slow),
    ],
)
def test_the_mpc_that_flies_swings_where_the_margins_say(
    case_of: tuple[str, AutopilotKind, Kind, int],
) -> None:
    case, found = _case(*case_of), _margins(case_of)
    assert _answer(replace(case, extra_delay_s=0.85 * found.delay_s), 23.0) < 0.01 * KICK_M_S2
    assert _answer(replace(case, extra_delay_s=1.15 * found.delay_s), 5.0) > KICK_M_S2
    assert _answer(replace(case, gain=0.9 * found.gain_up), 23.0) < 0.01 * KICK_M_S2
    # soon: what sinks faster and faster is handed to its autopilot, and nothing more is commanded
    assert _answer(replace(case, gain=1.1 * found.gain_up), 1.0) > KICK_M_S2


def test_the_margins_of_a_textbook_loop() -> None:
    """An integrator with a dead time: L = k exp(-s T) / s."""
    k, T = 2.0, 0.3
    w = np.geomspace(0.05, 90.0, 20000)
    found = margins(w, k * np.exp(-1j * w * T) / (1j * w))
    assert found.crossover_rad_s == pytest.approx(k, rel=1e-3)
    assert found.phase_deg == pytest.approx(90.0 - math.degrees(k * T), abs=0.1)
    assert found.delay_s == pytest.approx((math.pi / 2.0 - k * T) / k, rel=1e-3)
    assert found.gain_up == pytest.approx(math.pi / (2.0 * k * T), rel=1e-3)
    assert found.gain_down == math.inf


def test_a_loop_that_needs_its_gain_tells_how_much_of_it() -> None:
    """L = k (s + 1) / (s (s - 1)) is stable for k > 1 alone."""
    w = np.geomspace(0.05, 90.0, 20000)
    s = 1j * w
    assert margins(w, 3.0 * (s + 1.0) / (s * (s - 1.0))).gain_down == pytest.approx(3.0, rel=1e-3)


def test_a_response_that_is_slower_than_believed_costs_margin() -> None:
    case = _case("x500", "px4", "attitude", SIDEWAYS)
    slow = AxisResponse(dead_time_s=0.1, frequency_rad_s=case.response.frequency_rad_s, damping=0.7)
    worse = margins(*loop_transfer(replace(case, response=slow)))
    assert worse.delay_s < _margins(("x500", "px4", "attitude", SIDEWAYS)).delay_s - 0.04
