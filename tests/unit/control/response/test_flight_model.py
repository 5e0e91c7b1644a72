"""The model of how a vehicle answers: exact under a held input, and consistent with itself."""

import numpy as np
import pytest
from scipy.linalg import expm

from companion.base.autopilot_kind import AutopilotKind
from companion.base.motion import Motion
from companion.config import ControlConfig, Kind, VehicleConfig, find_file, load_model
from companion.control.response.flight_model import advance, advance_axis, discretise, lags, velocity_gains
from tests.unit.control.control_plants import vehicle_config

TAU_S = 0.18
LAGS_S = (0.18, 0.12, 0.05)


@pytest.mark.parametrize("step_s", [0.005, 0.033, 0.1, 0.5])
def test_discretisation_equals_the_matrix_exponential(step_s: float) -> None:
    continuous = np.zeros((4, 4))
    continuous[0, 1] = continuous[1, 2] = 1.0
    continuous[2, 2], continuous[2, 3] = -1.0 / TAU_S, 1.0 / TAU_S
    exact = expm(continuous * step_s)
    A, B = discretise(step_s, TAU_S)
    np.testing.assert_allclose(A, exact[:3, :3], atol=1e-12)
    np.testing.assert_allclose(B, exact[:3, 3], atol=1e-12)


def test_two_short_steps_make_one_long_one() -> None:
    start = (1.0, -2.0, 0.5)
    halfway = advance_axis(start, 1.5, 0.04, TAU_S)
    assert advance_axis(halfway, 1.5, 0.06, TAU_S) == pytest.approx(advance_axis(start, 1.5, 0.1, TAU_S))


def test_no_time_changes_nothing_and_long_time_reaches_the_input() -> None:
    assert advance_axis((1.0, 2.0, 3.0), 9.0, 0.0, TAU_S) == (1.0, 2.0, 3.0)
    assert advance_axis((0.0, 0.0, -3.0), 0.7, 5.0, TAU_S)[2] == pytest.approx(0.7, abs=1e-9)


def test_axes_do_not_mix() -> None:
    start = Motion((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (-1.0, 0.0, 1.0))
    end = advance(start, (0.5, -0.5, 0.25), 0.2, LAGS_S)
    for axis, u in enumerate((0.5, -0.5, 0.25)):
        alone = advance_axis(
            (start.position_m[axis], start.velocity_m_s[axis], start.acceleration_m_s2[axis]),
            u,
            0.2,
            LAGS_S[axis],
        )
        assert (end.position_m[axis], end.velocity_m_s[axis], end.acceleration_m_s2[axis]) == alone


def _late(name: str) -> VehicleConfig:
    return load_model(VehicleConfig, find_file("vehicles", name))


@pytest.mark.parametrize("kind", ["attitude", "acceleration", "velocity"])
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_lag_and_delay_together_are_as_late_as_the_response(
    autopilot_kind: AutopilotKind, kind: Kind
) -> None:
    vehicle, config = _late("x500"), ControlConfig(setpoint=kind, command_delay_s=0.02)
    response = vehicle.responses.of(autopilot_kind, kind)
    x, y, z = lags(vehicle, config, autopilot_kind)
    assert x == y == pytest.approx(response.sideways.delay_s - 0.02)
    assert z == pytest.approx(response.down.delay_s - 0.02)


def test_what_was_measured_on_the_vehicle_goes_before_its_responses() -> None:
    vehicle = vehicle_config(acceleration_time_constant_s=0.11, thrust_time_constant_s=0.04)
    shaped = ControlConfig(setpoint="velocity", autopilot_lag_s=0.2, autopilot_climb_lag_s=0.3)
    assert lags(vehicle, shaped) == (0.2, 0.2, 0.3)
    for kind in ("attitude", "acceleration"):
        assert lags(vehicle, shaped.model_copy(update={"setpoint": kind})) == (0.11, 0.11, 0.04)


def test_velocity_gains_are_the_autopilots_own_unless_they_were_measured() -> None:
    vehicle, config = _late("x500"), ControlConfig(setpoint="acceleration")
    assert velocity_gains(vehicle, config, "px4", sideways=False) == (0.0, 0.0, 4.0)
    assert velocity_gains(vehicle, config, "px4") == (1.8, 1.8, 4.0)
    measured = ControlConfig(setpoint="velocity", autopilot_velocity_gain_1_s=3.0)
    assert velocity_gains(vehicle, measured, "ardupilot") == (3.0, 3.0, 1.7)
    assert velocity_gains(vehicle, ControlConfig(setpoint="attitude"), "ardupilot") == (0.0, 0.0, 0.0)
