"""Commands under way."""

import pytest

from companion.base.motion import Motion
from companion.control.response.flight_model import advance
from companion.control.response.history import CommandHistory, SentCommand

LAGS_S = (0.18, 0.18, 0.05)
GAINS_1_S = (2.5, 2.5, 4.0)
REST = Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _sent(at_s: float, north: float) -> SentCommand:
    return SentCommand(at_s, (north, 0.0, 0.0))


def test_a_command_counts_from_its_arrival() -> None:
    history = CommandHistory(0.04)
    first, second = _sent(1.0, 1.0), _sent(1.033, 2.0)
    history.add(first)
    history.add(second)
    pieces = history.segments(1.0, 1.1)
    assert [command for _, command in pieces] == [None, first, second]
    assert [duration for duration, _ in pieces] == pytest.approx([0.04, 0.033, 0.027])


def test_old_commands_leave_one_piece_with_the_newest() -> None:
    history = CommandHistory(0.04)
    for k in range(200):
        history.add(_sent(0.01 * k, float(k)))
    pieces = history.segments(5.0, 5.1)
    assert [duration for duration, _ in pieces] == pytest.approx([0.1])
    assert pieces[0][1] == _sent(1.99, 199.0)


def test_nothing_between_equal_times_and_none_without_commands() -> None:
    history = CommandHistory(0.04)
    assert history.segments(1.0, 1.0) == []
    assert [command for _, command in history.segments(1.0, 1.2)] == [None]
    assert history.last_effect((0.0, 0.0, 0.0)) is None


def test_the_velocity_loop_adds_its_share() -> None:
    history = CommandHistory(0.04)
    history.add(SentCommand(0.0, (0.1, 0.0, 0.0), (1.0, 0.0, -1.0), GAINS_1_S))
    assert history.last_effect((0.8, 0.2, 0.0)) == pytest.approx((0.6, -0.5, -4.0))


def test_carry_flies_each_piece_with_its_command_and_the_disturbance() -> None:
    history = CommandHistory(0.04)
    history.add(_sent(0.0, 1.0))
    history.add(_sent(0.05, -1.0))
    end = history.carry(REST, 0.04, 0.12, (0.0, 0.5, 0.0), LAGS_S)
    expected = advance(advance(REST, (1.0, 0.5, 0.0), 0.05, LAGS_S), (-1.0, 0.5, 0.0), 0.03, LAGS_S)
    assert end.position_m == pytest.approx(expected.position_m)
    assert end.acceleration_m_s2 == pytest.approx(expected.acceleration_m_s2)


def test_before_the_first_command_the_vehicle_goes_on_as_it_is() -> None:
    moving = Motion((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.4, 0.0, 0.0))
    end = CommandHistory(0.04).carry(moving, 0.0, 0.1, (1.0, 0.0, 0.0), LAGS_S)
    assert end.acceleration_m_s2 == pytest.approx((0.4, 0.0, 0.0))
    assert end.position_m[0] == pytest.approx(0.1 + 0.5 * 0.4 * 0.01)
