"""Who else commands our vehicle: setpoints of another component, whoever it is, are noticed."""

from typing import Any

import pytest

from companion.config import LinkConfig
from companion.link.codec import Codec, mavlink
from companion.link.session import Session

US = (1, 191)


def attitude_target(system_id: int = 1) -> Any:
    return mavlink.MAVLink_set_attitude_target_message(
        0, system_id, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5
    )


def position_target(system_id: int = 1) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(0, system_id, 1, 1, 0, *[0.0] * 11)


def rival(sender: tuple[int, int], message: Any) -> tuple[int, int] | None:
    session = Session(LinkConfig())
    session.receive(Codec(*sender).encode(message), 5.0)
    assert (session.state.rival is None) == (session.state.rival_time_s < 0.0)
    return session.state.rival


@pytest.mark.parametrize("sender", [(1, 150), (1, 192), (255, 190), (7, 1)])
@pytest.mark.parametrize("made", [attitude_target, position_target])
def test_setpoints_of_anybody_else_for_our_vehicle_are_noticed(sender: tuple[int, int], made: Any) -> None:
    assert rival(sender, made()) == sender
    assert rival(sender, made(0)) == sender  # to all


@pytest.mark.parametrize("made", [attitude_target, position_target])
def test_an_echo_of_ours_and_those_for_another_vehicle_are_not(made: Any) -> None:
    assert rival(US, made()) is None
    assert rival((7, 150), made(7)) is None
