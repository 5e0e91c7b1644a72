"""A companion that stands by: asked, it lands the vehicle where it flies, again and again; never unasked."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import Phase
from companion.link.codec import Codec, mavlink
from tests.scenario.flying import FEW_PICTURES
from tests.scenario.standing_by import Story, StoryField, stand_by

IN_PROGRESS, ACCEPTED = mavlink.MAV_RESULT_IN_PROGRESS, mavlink.MAV_RESULT_ACCEPTED
LAND = mavlink.MAV_CMD_NAV_LAND


def play(story: Story, changes: dict[str, Any] | None = None, **options: Any) -> None:
    stand_by(story, {**FEW_PICTURES, **(changes or {})}, **options)


def test_two_landings_in_one_run_each_with_a_log_of_its_own(tmp_path: Path) -> None:
    async def story(field: StoryField) -> None:
        await field.ready()
        for number in (1, 2):
            await field.take_off()
            assert field.setpoints() == 0 or number == 2
            field.order()
            await field.landed()
            assert field.acks(LAND) == [IN_PROGRESS, ACCEPTED] * number
            await asyncio.sleep(5.0)
            # frames have come all along
            assert not any("no frame" in text for text in field.notices)
        assert field.app.missions.order is None

    play(story, record=tmp_path)
    folders = sorted(path.name for path in tmp_path.iterdir())
    assert folders == ["flight-0001", "flight-0002"]
    first = tmp_path / "flight-0001" / "flight.mcap"
    assert first.stat().st_size > 100_000
    assert (tmp_path / "flight-0001" / "flight.tlog").stat().st_size > 10_000


def test_in_standby_it_asks_for_nothing_and_refuses_what_cannot_be() -> None:
    async def story(field: StoryField) -> None:
        field.order()
        await asyncio.sleep(0.5)
        assert field.acks(LAND) == [mavlink.MAV_RESULT_TEMPORARILY_REJECTED]
        assert sum("refused" in text for text in field.notices) == 1
        await field.ready()
        field.order(mavlink.MAV_CMD_USER_1, 2.0)
        await asyncio.sleep(0.5)
        assert field.acks(mavlink.MAV_CMD_USER_1) == [mavlink.MAV_RESULT_DENIED]
        assert any("may_arm is false" in text for text in field.notices)
        await field.take_off()
        await asyncio.sleep(20.0)
        assert (field.commands(), field.setpoints()) == ([], 0)
        # somebody else's order is none
        stranger = Codec(77, 190)
        field.to_companion(
            mavlink.MAVLink_command_long_message(1, 191, LAND, 0, 0, 0, 0, 0, 0, 0, 0), stranger
        )
        await asyncio.sleep(1.0)
        assert field.app.phase is Phase.STANDBY

    play(story)


def test_a_pilot_takes_over_a_stop_holds_and_each_time_it_stands_by_again() -> None:
    async def story(field: StoryField) -> None:
        await field.ready()
        await field.take_off()
        field.order()
        await field.phase(Phase.DESCEND)
        field.pilot_mode("POSCTL")
        await field.phase(Phase.ABORT, 3.0)
        await field.phase(Phase.STANDBY, 20.0)
        assert field.acks(LAND) == [IN_PROGRESS, mavlink.MAV_RESULT_FAILED]
        assert field.autopilot.mode == "POSCTL"
        sent = field.setpoints()
        await asyncio.sleep(5.0)
        assert field.setpoints() == sent
        field.order()
        await field.phase(Phase.DESCEND)
        field.order(mavlink.MAV_CMD_USER_1, 0.0)
        await field.phase(Phase.STANDBY, 20.0)
        assert field.acks(LAND)[2:] == [IN_PROGRESS, 6]  # MAV_RESULT_CANCELLED
        assert field.acks(mavlink.MAV_CMD_USER_1) == [IN_PROGRESS, ACCEPTED]
        assert field.autopilot.mode == "AUTO.LOITER"
        field.order()
        await field.landed()

    play(story)


def test_restarted_in_flight_it_asks_for_nothing_and_follows_the_next_order() -> None:
    async def story(field: StoryField) -> None:
        await field.ready()
        await field.take_off()
        field.order()
        await field.phase(Phase.DESCEND)
        await field.restart()
        sent = field.setpoints(), field.commands()
        await field.until(lambda: field.autopilot.mode == "AUTO.LOITER", 5.0, "the autopilot's failsafe")
        field.vehicle.wants_frames = False  # rendering takes most of the time
        await field.until(field.aligned, 40.0, "aligned in the air")
        field.vehicle.wants_frames = True
        assert field.app.phase is Phase.STANDBY
        assert (field.setpoints(), field.commands()) == sent
        field.order()
        await field.landed()

    play(story)


def test_refused_control_leaves_the_vehicle_in_its_mode() -> None:
    async def story(field: StoryField) -> None:
        await field.ready()
        await field.take_off()
        mode = field.autopilot.mode
        field.order()
        await field.phase(Phase.ABORT)
        await field.phase(Phase.STANDBY, 20.0)
        assert field.autopilot.mode == mode
        assert set(field.commands()) == {mavlink.MAV_CMD_DO_SET_MODE}
        assert field.acks(LAND) == [IN_PROGRESS, mavlink.MAV_RESULT_FAILED]

    play(story, {"faults": [{"kind": "autopilot_refuses", "what": "offboard", "start_s": 0.0}]})


def test_the_whole_flight_where_it_is_allowed_and_again() -> None:
    async def story(field: StoryField) -> None:
        for number in (1, 2):
            await field.ready()
            field.order(mavlink.MAV_CMD_USER_1, 2.0)
            await field.landed(180.0)
            assert field.acks(mavlink.MAV_CMD_USER_1) == [IN_PROGRESS, ACCEPTED] * number
            # in OFFBOARD it would not get ready for the next
            assert (field.autopilot.mode, field.autopilot.ready_to_arm) == ("AUTO.LOITER", True)

    play(story, settings={"plan": {"mission": {"may_arm": True}}})


def test_an_ardupilot_that_its_pilot_puts_into_guided_is_landed() -> None:
    async def story(field: StoryField) -> None:
        await field.ready()
        await field.take_off()
        assert field.app.phase is Phase.STANDBY  # GUIDED was entered on the ground
        field.pilot_mode("LOITER")
        await asyncio.sleep(2.0)
        assert field.setpoints() == 0
        field.pilot_mode("GUIDED")
        await field.landed()

    play(story, {"autopilot": "ardupilot"}, settings={"orders": {"flight_mode": "GUIDED"}})


@pytest.mark.parametrize(
    ("ordered", "said"), [(False, "nothing requested"), (True, "hold requested")], ids=["theirs", "ours"]
)
def test_a_control_task_that_fails_says_so_and_brakes_only_what_is_ours(ordered: bool, said: str) -> None:
    fields = list[StoryField]()

    async def fail(_now_s: float, _late_s: float) -> None:
        raise ValueError("no such index")

    async def story(field: StoryField) -> None:
        fields.append(field)
        await field.ready()
        await field.take_off()
        assert field.autopilot.offboard  # in GUIDED, by its pilot
        if ordered:
            field.order()
            await field.phase(Phase.APPROACH)
        field.forget()
        field.app._control_step = fail  # type: ignore[assignment, method-assign]
        await asyncio.sleep(10.0)

    with pytest.raises(ExceptionGroup):
        play(story, {"autopilot": "ardupilot"})
    text = f"control failed: ValueError: no such index; {said}"
    assert fields[0].notices[-1] == text
    assert text in fields[0].texts()
    assert fields[0].commands() == ([mavlink.MAV_CMD_DO_SET_MODE] if ordered else [])
