"""Vision only, in the whole app: what it sends by the byte, and the autopilot's own landing on it."""

import itertools
import math
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Phase
from companion.link.codec import mavlink
from tests.scenario.standing_by import StoryField, stand_by

OUTPUT: dict[str, Any] = {"control": {"output": "landing_target"}}
# asking and telling; whatever is not here moves a vehicle, or may
HARMLESS = {"HEARTBEAT", "TIMESYNC", "STATUSTEXT", "COMMAND_ACK", "LANDING_TARGET"}
ASKING = {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}


def sent(field: StoryField, kind: str) -> list[Any]:
    return [m for m in field._tapped.sent if m.get_type() == kind]


def is_harmless(message: Any) -> bool:
    if message.get_type() == "COMMAND_LONG":
        return message.command in ASKING
    return message.get_type() in HARMLESS


def scenario(kind: AutopilotKind) -> dict[str, Any]:
    """A pad beside home, so that it is in view over it."""
    meet = {"point_ned_m": [0.9, -0.6], "time_s": 0.0, "spread_m": 0.0}
    return {"autopilot": kind, "pad": {"motion": {"kind": "static", "meet": meet}}}


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_the_pilots_landing_ends_on_the_pad_and_the_app_flies_nothing(kind: AutopilotKind) -> None:
    async def story(field: StoryField) -> None:
        autopilot = field.vehicle.simulation.autopilot
        if kind == "ardupilot":
            for name, value in {"PLND_ENABLED": 1.0, "PLND_LAG": 0.1}.items():
                assert autopilot.parameters.set(name, value)
            autopilot.reboot()
        await field.ready()
        assert not sent(field, "LANDING_TARGET")  # the vehicle stands beside the pad
        await field.take_off(6.0)
        await field.until(lambda: len(sent(field, "LANDING_TARGET")) > 30, 10.0, "targets")
        assert field.app.not_ready(field.clock.now_s()) == []
        # neither by the link nor at the desk does an order make it fly
        field.order()
        await field.until(lambda: bool(field.acks(mavlink.MAV_CMD_NAV_LAND)), 5.0, "an answer")
        assert field.acks(mavlink.MAV_CMD_NAV_LAND) == [mavlink.MAV_RESULT_DENIED]
        assert any("vision only" in text for text in field.texts())
        if kind == "ardupilot":
            field.pilot(mavlink.MAV_CMD_NAV_LAND)
        else:
            field.pilot(23)  # NAV_PRECLAND
        await field.until(lambda: not field.autopilot.armed, 60.0, "disarmed")
        touchdown = field.vehicle.simulation.world.watch.touchdown
        assert touchdown is not None
        assert touchdown.lateral_error_m < 0.15
        assert field.app.phase is Phase.STANDBY
        assert all(is_harmless(m) for m in field._tapped.sent)
        _check_targets(sent(field, "LANDING_TARGET"), kind)

    stand_by(story, scenario(kind), settings=OUTPUT)


def _check_targets(targets: list[Any], kind: AutopilotKind) -> None:
    stamps_s = [m.time_usec * 1e-6 for m in targets]
    assert all(later - sooner > 0.0 for sooner, later in itertools.pairwise(stamps_s))
    for m in targets:
        assert m.position_valid == 1
        assert math.isfinite(m.x + m.y + m.z)
        if kind == "ardupilot":
            assert m.frame == mavlink.MAV_FRAME_BODY_FRD
            assert math.sqrt(m.x**2 + m.y**2 + m.z**2) == pytest.approx(m.distance, rel=1e-5)
        else:
            assert m.frame == mavlink.MAV_FRAME_LOCAL_NED


def test_a_camera_that_sees_nothing_is_silence() -> None:
    async def story(field: StoryField) -> None:
        await field.ready()
        await field.take_off(6.0)
        await field.until(lambda: len(sent(field, "LANDING_TARGET")) > 30, 10.0, "targets")
        field.vehicle.wants_frames = False
        await _pause(field, 0.5)
        count = len(sent(field, "LANDING_TARGET"))
        await _pause(field, 4.0)
        assert len(sent(field, "LANDING_TARGET")) == count
        field.vehicle.wants_frames = True
        await field.until(lambda: len(sent(field, "LANDING_TARGET")) > count + 10, 10.0, "targets again")

    stand_by(story, scenario("ardupilot"), settings=OUTPUT)


async def _pause(field: StoryField, duration_s: float) -> None:
    until_s = field.clock.now_s() + duration_s
    await field.until(lambda: field.clock.now_s() >= until_s, duration_s + 1.0, "time")
