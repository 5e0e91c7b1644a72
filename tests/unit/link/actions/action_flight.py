"""Actions against a fake autopilot, in virtual time."""

import asyncio
from collections.abc import Awaitable, Callable

from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import Clock
from companion.base.messages import Action, ActionResult
from companion.config import LinkConfig
from companion.link.actions.actions import PymavlinkActions
from companion.link.session import Session
from companion.link.transport import Transport, memory_pair
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.virtual_time import in_virtual_time

Answer = Callable[[bytes, float], bytes]


async def simulate(autopilot: FakeAutopilot, end: Transport, ground: Answer | None = None) -> None:
    clock = Clock()

    async def listen() -> None:
        while True:
            data = await end.read()
            end.write(autopilot.receive(data, clock.now_s()))
            if ground is not None:
                end.write(ground(data, clock.now_s()))

    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(listen())
        while True:
            end.write(autopilot.tick(clock.now_s()))
            await asyncio.sleep(0.01)


@in_virtual_time
async def fly(
    autopilot: FakeAutopilot,
    story: Callable[[PymavlinkActions, Session], Awaitable[list[ActionResult]]],
    config: LinkConfig | None = None,
    ground: Answer | None = None,
    attitude_setpoints: bool = False,
) -> list[ActionResult]:
    """Connect, let the telemetry settle, and run a story of actions."""
    clock, settings = Clock(), config or LinkConfig()
    ours, theirs = memory_pair()
    session = Session(settings)
    actions = PymavlinkActions(session, ours.write, clock, settings, attitude_setpoints=attitude_setpoints)

    async def listen() -> None:
        while True:
            session.receive(await ours.read(), clock.now_s())
            ours.write(session.tick(clock.now_s()))

    tasks = [asyncio.ensure_future(listen()), asyncio.ensure_future(simulate(autopilot, theirs, ground))]
    await asyncio.sleep(1.5)
    try:
        return await story(actions, session)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def perform(
    autopilot: FakeAutopilot,
    *asked: Action,
    config: LinkConfig | None = None,
    ground: Answer | None = None,
    attitude_setpoints: bool = False,
) -> list[ActionResult]:
    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        return [await actions.perform(action) for action in asked]

    return fly(autopilot, story, config, ground, attitude_setpoints)


def meanwhile(
    autopilot: FakeAutopilot,
    asked: Action,
    after_s: float,
    happens: Callable[[PymavlinkActions, Session], object],
    config: LinkConfig | None = None,
) -> ActionResult:
    """Begin an action, let something happen while it is under way, and wait for its end."""

    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        asking = asyncio.ensure_future(actions.perform(asked))
        await asyncio.sleep(after_s)
        happens(actions, session)
        return [await asking]

    [result] = fly(autopilot, story, config)
    return result


def show(autopilot: FakeAutopilot, session: Session) -> None:
    """The autopilot's next heartbeat comes at once."""
    session.receive(autopilot.codec.encode(autopilot.message(0, 0.0)), Clock().now_s())


def autopilot_of(autopilot_kind: AutopilotKind) -> FakeAutopilot:
    return FakeAutopilot(
        autopilot_kind=autopilot_kind, mode="AUTO.LOITER" if autopilot_kind == "px4" else "STABILIZE"
    )


def cancel_after(
    autopilot: FakeAutopilot, wait_s: float, *asked: Action, attitude_setpoints: bool = False
) -> list[ActionResult]:
    """Begin the first, cancel it, perform the rest at once, and wait for repeats that must not come."""

    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        loop = asyncio.get_running_loop()
        first = asyncio.ensure_future(actions.perform(asked[0]))
        await asyncio.sleep(wait_s)
        cancelled_s = loop.time()
        actions.cancel()
        results = [await first]
        assert loop.time() == cancelled_s
        results += [await actions.perform(action) for action in asked[1:]]
        assert loop.time() - cancelled_s < 0.6
        await asyncio.sleep(3.0)
        return results

    return fly(autopilot, story, attitude_setpoints=attitude_setpoints)
