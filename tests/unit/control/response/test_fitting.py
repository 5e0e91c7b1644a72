"""The loop is made to fit the vehicle's response, and never quicker or bolder than it was set."""

import pytest

from companion.base.messages import AutopilotSetup
from companion.config import ARDUPILOT, PX4, AxisResponse, ControlConfig, KindResponse
from companion.control.response.fitting import QUICK_S, fitted, loop_rad_s, misfits
from tests.unit.control.control_plants import vehicle_config

CONFIG = ControlConfig()
VEHICLE = vehicle_config()


def _by(dead_time_s: float, frequency_rad_s: float, damping: float) -> KindResponse:
    axis = AxisResponse(dead_time_s=dead_time_s, frequency_rad_s=frequency_rad_s, damping=damping)
    return KindResponse(sideways=axis, down=axis)


def test_a_quick_response_leaves_all_as_it_was_set() -> None:
    assert fitted(CONFIG, _by(0.0, 100.0, 1.0)) == CONFIG


def test_twice_as_late_is_flown_half_as_fast() -> None:
    slow = fitted(CONFIG, _by(2.0 * QUICK_S - 0.02, 100.0, 1.0))
    for before, after in ((CONFIG.horizontal, slow.horizontal), (CONFIG.vertical, slow.vertical)):
        assert loop_rad_s(after) == pytest.approx(0.5 * loop_rad_s(before))
        assert after.velocity_m_s == pytest.approx(2.0 * before.velocity_m_s)
        assert after.effort_m_s2 == before.effort_m_s2


def test_one_that_rings_is_flown_far_below_its_ringing() -> None:
    damped, ringing = (fitted(CONFIG, _by(0.03, 8.0, damping)) for damping in (0.7, 0.26))
    assert loop_rad_s(ringing.horizontal) < 0.5 * loop_rad_s(damped.horizontal)


def test_no_more_is_asked_than_the_autopilot_lets_through() -> None:
    velocity = CONFIG.model_copy(update={"setpoint": "velocity"})
    own = fitted(velocity, ARDUPILOT.velocity).limits
    assert (own.horizontal_acceleration_m_s2, own.jerk_m_s3) == (2.5, 5.0)
    assert fitted(CONFIG, PX4.attitude).limits == CONFIG.limits
    # what was read from the autopilot goes before the vehicle's file, and never widens what was set
    setup = AutopilotSetup(acceleration_m_s2=4.0, jerk_m_s3=90.0, tilt_deg=20.0)
    read = fitted(velocity, ARDUPILOT.velocity, setup).limits
    assert (read.horizontal_acceleration_m_s2, read.jerk_m_s3, read.tilt_deg) == (
        4.0,
        CONFIG.limits.jerk_m_s3,
        20.0,
    )


def test_its_limits_on_velocity_setpoints_bind_no_attitude() -> None:
    attitude = CONFIG.model_copy(update={"setpoint": "attitude"})
    setup = AutopilotSetup(acceleration_m_s2=1.0, jerk_m_s3=5.0, tilt_deg=45.0)
    assert fitted(attitude, ARDUPILOT.attitude, setup).limits == CONFIG.limits


def test_what_does_not_fit_is_reported_a_line_each() -> None:
    assert misfits(CONFIG, VEHICLE, AutopilotSetup(45.0, VEHICLE.hover_thrust)) == []
    told = misfits(CONFIG, VEHICLE, AutopilotSetup(tilt_deg=20.0, hover_thrust=0.2))
    assert [line.split(":")[0] for line in told] == ["hover thrust", "tilt limit"]
