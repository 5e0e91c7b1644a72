"""The link, looked at: heartbeat, signing, losses, telemetry, the autopilot's sensors and its parameters.

The app's own session asks for what it asks for in flight (heartbeats, the time, telemetry rates), and for
parameters to read. Nothing is set, no mode and no command is sent.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing
from dataclasses import dataclass, field
from typing import Final

from companion.base.clock import Clock, start_unix_s
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import CompanionConfig, ConfigError, LinkConfig, SenseConfig, VehicleConfig
from companion.link.session import Session
from companion.link.signing import signing_of
from companion.link.transport import Transport, open_transport
from companion.tools.preflight import telemetry
from companion.tools.preflight.findings import NO_HINT, Finding, FindingGroup
from companion.tools.preflight.parameters import (
    GROUP,
    Output,
    ParameterReadings,
    Wanted,
    judge_parameters,
    parameter_names,
    with_change,
)
from companion.tools.preflight.telemetry import FrameCounter, Heard

HEARTBEAT_PATIENCE_S: Final = 6.0
# rates are asked for at the first heartbeat, and what does not come is asked for again
SETTLING_S: Final = 3.0
LOOK_S: Final = 5.0
TICK_S: Final = 0.05
WATCH_S: Final = 1.0
_GROUP: Final = FindingGroup("link")
# by the kind of `link.connection`: what is looked at where not one byte comes
SILENCE_HINTS: Final = {
    "serial": "power, TX and RX crossed, the port's name, link.connection",
    "udpin": (
        "nothing sends to this port: the autopilot, mavlink-router or the simulator has to be told this "
        "machine's address and the port; from another machine not 127.0.0.1 but 0.0.0.0; a firewall"
    ),
    "udp": "nobody answers at this address: is it the autopilot's; a firewall; if it calls us: udpin:",
    "tcp": "what took the call says nothing: is it the autopilot's or mavlink-router's port?",
}
_NO_HEARTBEAT: Final = "no autopilot on the link"


async def check_link(config: CompanionConfig, vehicle: VehicleConfig | None) -> list[Finding]:
    """All findings about the autopilot; `vehicle` is None when its file cannot be read."""
    connection = config.link.connection
    try:
        sense = config.sense if config.sense.source == "autopilot" else None
        follows_pose = config.control.output == "landing_target"
        async with listening(config.link, sense, follows_pose=follows_pose) as listener:
            if not await listener.until(lambda: listener.session.state.connected, HEARTBEAT_PATIENCE_S):
                return [_silence(listener, connection), *_without_autopilot(_NO_HEARTBEAT)]
            heard = await listener.look(config.control.output)
    except ConfigError as error:
        hint = (
            "see link.connection and link.signing_key; does another program, or the service, have the port?"
        )
        return [_GROUP.fail("heartbeat", str(error), hint), *_without_autopilot("the link is not open")]
    except OSError as error:
        return [
            _GROUP.fail("heartbeat", f"{connection}: {error}", SILENCE_HINTS[connection.partition(":")[0]]),
            *_without_autopilot("the link was lost"),
        ]
    found = telemetry.judge(heard, config)
    kind = heard.state.autopilot_kind
    if kind is None or vehicle is None:
        why = "no PX4 or ArduPilot multirotor" if kind is None else "the vehicle's file is not usable"
        return [*found, FindingGroup(GROUP).skip("parameters", why)]
    read = heard.parameters
    wanted = Wanted.of(config, vehicle, kind, read.system_id)
    judged = judge_parameters(kind, read.values, wanted)
    return [*found, *(with_change(finding, read, wanted) for finding in judged)]


def without_link(why: str, hint: str) -> list[Finding]:
    """The findings when the link is not to be opened."""
    return [_GROUP.skip("heartbeat", why, hint), *_without_autopilot(why, hint)]


def _without_autopilot(why: str, hint: str = NO_HINT) -> list[Finding]:
    return [
        FindingGroup("telemetry").skip("rates", why, hint),
        FindingGroup(GROUP).skip("parameters", why, hint),
    ]


def _silence(listener: LinkListener, connection: str) -> Finding:
    """What a link without the autopilot's heartbeat has instead."""
    session, kind = listener.session, connection.partition(":")[0]
    counters, lead = session.counters, f"{connection}: no heartbeat within {HEARTBEAT_PATIENCE_S:g} s, "
    detail, hint = f"{lead}not one byte", SILENCE_HINTS[kind]
    if session.state.mavlink_1:
        detail = f"{connection}: the autopilot sends MAVLink 1; expected MAVLink 2"
        hint = "ArduPilot: SERIALx_PROTOCOL 2 of this port; PX4: MAV_PROTO_VER 0 or 2"
    elif session.stranger is not None:
        detail = f"{lead}but system {session.stranger}'s"
        hint = "set link.system_id to the vehicle's, or to 0"
    elif counters.refused:
        detail = f"{lead}but {counters.refused} frames without our signature"
        hint = "the autopilot signs with another key, or not at all: see link.signing_key"
    elif counters.decoded + counters.passed_over:
        detail = f"{lead}but other MAVLink"
        hint = "is this line the autopilot's? see SERIALx_PROTOCOL, MAV_x_CONFIG"
    elif counters.skipped_bytes:
        detail = f"{lead}but {counters.skipped_bytes} bytes that are no MAVLink 2"
        baud = "the baud rate, in link.connection and in the autopilot; " if kind == "serial" else ""
        hint = f"{baud}MAV_PROTO_VER, SERIALx_PROTOCOL 2"
    return _GROUP.fail("heartbeat", detail, hint)


@dataclass(eq=False)
class LinkListener:
    """The open link, tended by tasks of its own, and what has been heard on it."""

    session: Session
    transport: Transport
    clock: Clock
    works: tuple[asyncio.Task[None], ...] = ()
    samples: Counter[type] = field(default_factory=Counter)
    line: FrameCounter = field(default_factory=FrameCounter)
    problem: str | None = None

    async def receive(self) -> None:
        while True:
            data, now_s = await self.transport.read(), self.clock.now_s()
            self.session.receive(data, now_s)
            self.line.feed(data)
            self.samples.update(type(sample) for sample in self.session.take_samples())

    async def tick(self) -> None:
        while True:
            if due := self.session.tick(self.clock.now_s()):
                self.transport.write(due)
            await asyncio.sleep(TICK_S)

    async def watch(self) -> None:
        """Keep the telemetry sensors' own judgement up to date."""
        while self.session.onboard is not None:
            self.problem = self.session.onboard.watch(self.clock.now_s())
            await asyncio.sleep(WATCH_S)

    async def until(self, holds: Callable[[], bool], patience_s: float) -> bool:
        """Wait until something holds, or so long; whether it does."""
        until_s = self.clock.now_s() + patience_s
        while not holds() and self.clock.now_s() < until_s:  # noqa: ASYNC110 - the session tells nobody
            await asyncio.sleep(TICK_S)
        return holds()

    async def look(self, output: Output) -> Heard:
        """Count for a while what comes, and read the parameters meanwhile that this output depends on."""
        kind = self.session.state.autopilot_kind
        names = () if kind is None else parameter_names(kind, output)
        asked = [self.session.read_parameter(name) for name in names]
        await asyncio.sleep(SETTLING_S)
        before, sampled = self.line.messages.copy(), self.samples.copy()
        began_s = self.clock.now_s()
        await asyncio.sleep(LOOK_S)
        elapsed_s = self.clock.now_s() - began_s
        return Heard(
            state=self.session.state,
            refused=self.session.counters.refused,
            line=self.line,
            clock_settled=self.session.timesync.settled,
            rates_hz={
                number: (count - before[number]) / elapsed_s for number, count in self.line.messages.items()
            },
            samples_hz={
                kind: (self.samples[kind] - sampled[kind]) / elapsed_s
                for kind in (ImuSample, MagSample, GpsFix, RangeSample)
            },
            sensors_problem=self.problem,
            parameters=ParameterReadings(
                self.session.system_id,
                {request.name: request.value for request in asked},
                {request.name: request.mav_type for request in asked if request.mav_type is not None},
            ),
        )


@asynccontextmanager
async def listening(
    link: LinkConfig, sense: SenseConfig | None, *, follows_pose: bool
) -> AsyncIterator[LinkListener]:
    """The link, open and tended; a link that is lost raises OSError at the end of what goes on with it."""
    signing = signing_of(link, start_unix_s(virtual=True))
    session = Session(link, sense, signing=signing, follows_pose=follows_pose)
    with closing(await open_transport(link.connection, link.system_id, signing)) as transport:
        listener = LinkListener(session, transport, Clock())
        works = (listener.receive, listener.tick, listener.watch)
        listener.works = tuple(asyncio.create_task(work()) for work in works)
        try:
            yield listener
        finally:
            for work in listener.works:
                work.cancel()
            ends = await asyncio.gather(*listener.works, return_exceptions=True)
            for end in ends:
                if isinstance(end, OSError):
                    raise end
