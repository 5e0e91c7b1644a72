"""Actions by MAVSDK against the fake autopilot over an in-memory pair, in real time: it has its own clock."""

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import Action, ActionKind
from companion.config import ConfigError, LinkConfig
from companion.link.actions import mavsdk_link
from companion.link.actions.actions import PymavlinkActions
from companion.link.actions.mavsdk_link import MavsdkActions
from companion.link.codec import mavlink
from companion.link.session import Session
from companion.link.transport import memory_pair
from tests.unit.link.actions.action_flight import autopilot_of
from tests.unit.link.fake_autopilot import FakeAutopilot

AUTOPILOT_KINDS: list[AutopilotKind] = ["px4", "ardupilot"]


@asynccontextmanager
async def connected(
    autopilot: FakeAutopilot, config: LinkConfig | None = None, kind: type[Any] = MavsdkActions
) -> AsyncIterator[Any]:
    """The actions and our session on one line to the autopilot, once its first telemetry is here."""
    clock, settings = Clock(), config or LinkConfig()
    ours, theirs = memory_pair(0.001)
    session = Session(settings)
    actions = kind(session, ours.write, clock, settings, attitude_setpoints=False)
    await actions.start()

    known = asyncio.Event()

    async def companion() -> None:
        while True:
            data = await ours.read()
            session.receive(data, clock.now_s())
            actions.receive(data)
            ours.write(session.tick(clock.now_s()))
            if session.state.home is not None:
                known.set()

    async def listen() -> None:
        while True:
            theirs.write(autopilot.receive(await theirs.read(), clock.now_s()))

    async def tell() -> None:
        while True:
            theirs.write(autopilot.tick(clock.now_s()))
            await asyncio.sleep(0.01)

    tasks = [asyncio.ensure_future(each()) for each in (companion, listen, tell)]
    try:
        await asyncio.wait_for(known.wait(), 10.0)
        yield actions
    finally:
        await actions.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def heard(autopilot: FakeAutopilot, number: int) -> None:
    for _ in range(1000):
        if autopilot.commands(number):
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"command {number} was not heard")


def threads_of_this_process() -> set[str]:
    return {task.name for task in Path("/proc/self/task").iterdir()}


FLIGHT = (
    Action(ActionKind.ARM),
    Action(ActionKind.TAKE_OFF, height_m=7.0),
    Action(ActionKind.GO_TO, position=(47.0001, 8.0, 7.0)),
    Action(ActionKind.HOLD),
    Action(ActionKind.TAKE_CONTROL),
    Action(ActionKind.LAND),
)


async def accepted(actions: Any, action: Action) -> None:
    result = await asyncio.wait_for(actions.perform(action), 10.0)
    assert (action.kind, result.accepted, result.text) == (action.kind, True, "")


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
async def test_a_whole_flight_is_accepted(autopilot_kind: AutopilotKind) -> None:
    autopilot = autopilot_of(autopilot_kind)
    async with connected(autopilot) as actions:
        for action in FLIGHT:
            await accepted(actions, action)
    assert autopilot.armed
    by = {m.command: m.get_srcComponent() for m in autopilot.heard if m.get_type().startswith("COMMAND_")}
    assert by[mavlink.MAV_CMD_NAV_TAKEOFF] == by[mavlink.MAV_CMD_DO_REPOSITION] == 192
    assert by[mavlink.MAV_CMD_SET_MESSAGE_INTERVAL] in {191, 192}


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
async def test_flights_in_virtual_time_have_the_same_effect_on_the_autopilot(
    autopilot_kind: AutopilotKind,
) -> None:
    """`--fast` performs actions by our own messages, since MAVSDK has threads and a clock of its own."""

    async def effects(kind: type[Any]) -> list[tuple[str, bool]]:
        autopilot = autopilot_of(autopilot_kind)
        states = []
        async with connected(autopilot, kind=kind) as actions:
            for action in FLIGHT:
                await accepted(actions, action)
                await asyncio.sleep(0.1)
                states.append((autopilot.mode, autopilot.armed))
        return states

    assert await effects(MavsdkActions) == await effects(PymavlinkActions)


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
async def test_after_taking_control_mavsdk_sends_no_setpoint(autopilot_kind: AutopilotKind) -> None:
    autopilot = autopilot_of(autopilot_kind)
    async with connected(autopilot) as actions:
        result = await asyncio.wait_for(actions.perform(Action(ActionKind.TAKE_CONTROL)), 10.0)
        await asyncio.sleep(0.3)
        assert result.accepted
    assert autopilot.mode == ("OFFBOARD" if autopilot_kind == "px4" else "GUIDED")
    [command] = autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)
    assert command.get_srcComponent() == 191
    assert autopilot.setpoints() == []


async def test_px4_takes_off_to_the_height_asked_for() -> None:
    autopilot = autopilot_of("px4")
    async with connected(autopilot) as actions:
        await asyncio.wait_for(actions.perform(Action(ActionKind.TAKE_OFF, height_m=6.5)), 10.0)
    assert autopilot.parameters["MIS_TAKEOFF_ALT"] == 6.5


async def test_a_plain_disarming_is_mavsdks_and_is_seen_when_it_returns() -> None:
    autopilot = FakeAutopilot(armed=True)
    async with connected(autopilot) as actions:
        result = await asyncio.wait_for(actions.perform(Action(ActionKind.DISARM)), 10.0)
    [command] = autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    assert result.accepted
    assert command.get_srcComponent() == 192


async def test_holding_does_not_hang_on_mavsdk() -> None:
    autopilot = FakeAutopilot(mode="OFFBOARD")
    async with connected(autopilot) as actions:
        await actions.close()
        result = await asyncio.wait_for(actions.perform(Action(ActionKind.HOLD)), 10.0)
    assert result.accepted
    assert autopilot.mode == "AUTO.LOITER"


async def test_a_refusal_carries_the_autopilots_words() -> None:
    autopilot = FakeAutopilot(refuses={mavlink.MAV_CMD_COMPONENT_ARM_DISARM: "Arming denied: no GPS"})
    async with connected(autopilot) as actions:
        result = await asyncio.wait_for(actions.perform(Action(ActionKind.ARM)), 10.0)
    assert (result.accepted, result.text) == (False, "command denied; Arming denied: no GPS")


@pytest.mark.parametrize(("asked", "allowed"), [(True, True), (True, False), (False, True)])
async def test_an_autopilot_that_misses_the_touchdown_is_disarmed_by_force_where_asked_and_allowed(
    asked: bool, allowed: bool
) -> None:
    autopilot = FakeAutopilot(armed=True, believes_in_air=True)
    async with connected(autopilot, LinkConfig(force_disarm=allowed)) as actions:
        result = await asyncio.wait_for(actions.perform(Action(ActionKind.DISARM, force=asked)), 10.0)
    assert result.accepted is (asked and allowed)
    assert autopilot.armed is not (asked and allowed)


async def test_cancelling_stops_mavsdks_repeats_and_holding_waits_for_nothing() -> None:
    autopilot = FakeAutopilot(mode="OFFBOARD", deaf_to={mavlink.MAV_CMD_NAV_TAKEOFF: 99})
    async with connected(autopilot) as actions:
        task = asyncio.ensure_future(actions.perform(Action(ActionKind.TAKE_OFF, height_m=5.0)))
        await heard(autopilot, mavlink.MAV_CMD_NAV_TAKEOFF)
        actions.cancel()
        result = await asyncio.wait_for(task, 5.0)
        assert (result.accepted, result.text) == (False, "withdrawn")
        result = await asyncio.wait_for(actions.perform(Action(ActionKind.HOLD)), 5.0)
        assert result.accepted
        assert autopilot.mode == "AUTO.LOITER"
        await asyncio.sleep(1.5)
        assert len(autopilot.commands(mavlink.MAV_CMD_NAV_TAKEOFF)) == 1
    [command] = autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)
    assert command.get_srcComponent() == 191


async def test_mavsdk_is_asked_again_once_what_was_withdrawn_has_ended() -> None:
    autopilot = FakeAutopilot(deaf_to={mavlink.MAV_CMD_COMPONENT_ARM_DISARM: 1})
    async with connected(autopilot) as actions:
        task = asyncio.ensure_future(actions.perform(Action(ActionKind.ARM)))
        await heard(autopilot, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
        actions.cancel()
        await task
        assert not (busy := await actions.perform(Action(ActionKind.ARM))).accepted
        assert busy.text == "MAVSDK is still busy with what was withdrawn"
        async with asyncio.timeout(10.0):
            while not (await actions.perform(Action(ActionKind.ARM))).accepted:
                assert not autopilot.armed
    assert autopilot.armed


async def test_closing_leaves_no_thread_behind_even_amid_a_call() -> None:
    before = threads_of_this_process()
    autopilot = FakeAutopilot(deaf_to={mavlink.MAV_CMD_COMPONENT_ARM_DISARM: 99})
    async with connected(autopilot) as actions:
        task = asyncio.ensure_future(actions.perform(Action(ActionKind.ARM)))
        await asyncio.sleep(0.3)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    asyncio_workers = sum(thread.name.startswith("asyncio_") for thread in threading.enumerate())
    assert len(threads_of_this_process() - before) <= asyncio_workers
    await actions.close()
    result = await actions.perform(Action(ActionKind.ARM))
    assert (result.accepted, result.text) == (False, "MAVSDK is not running")


def test_virtual_time_is_refused_in_one_line() -> None:
    async def main() -> None:
        config = LinkConfig()
        MavsdkActions(Session(config), lambda data: None, Clock(), config, attitude_setpoints=False)

    with pytest.raises(ConfigError, match="virtual time; expected pymavlink"):
        run_in_virtual_time(main())


async def test_its_first_bytes_find_someone_to_send_them(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its threads say that sending failed whenever they come to it: nothing may fail, heard or not."""
    mavsdk_link._log_lines.hush()  # subscribed, whichever test runs first
    monkeypatch.setattr(mavsdk_link._log_lines, "hush", mavsdk_link._log_lines.pass_on)
    for _ in range(4):
        caplog.clear()  # while it closes, it takes its subscriber away first, and says so
        async with connected(autopilot_of("px4")):
            assert "mavsdk: Sending message failed" not in [record.getMessage() for record in caplog.records]
