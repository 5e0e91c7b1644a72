"""`companion detect --send`: what each picture shows, as a landing target to the autopilot on the link.

For the desk: to see that the autopilot takes it. A picture counts as taken now, by a camera that looks down
from the vehicle's reference point; PX4 is told of the place by its own pose, which it has to have.
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Any, Final

from companion.base.autopilots import PROFILES
from companion.base.clock import Clock, start_unix_s
from companion.base.errors import ConfigError
from companion.base.geometry import Quaternion, Vector3
from companion.base.messages import PadSighting
from companion.config import CompanionConfig
from companion.control.landing_target import SeenPad, landing_target
from companion.link.session import Session
from companion.link.signing import signing_of
from companion.link.transport import Transport, open_transport
from companion.pad import Pad

PATIENCE_S: Final = 6.0
POSE_PATIENCE_S: Final = 1.0
TICK_S: Final = 0.02


class TargetLink:
    """The link to the autopilot, tended on a loop of its own; asks for rates, and sends targets alone."""

    def __init__(self, config: CompanionConfig) -> None:
        self._config, self._loop = config, asyncio.new_event_loop()
        self._session: Session
        self._transport: Transport | None = None
        self._works: list[asyncio.Task[None]] = []

    @contextmanager
    def opened(self) -> Iterator["TargetLink"]:
        """Open, with an autopilot on it; closed at the end.

        Raises:
            ConfigError: the link cannot be opened, or no PX4 or ArduPilot is on it.
        """
        thread = Thread(target=self._loop.run_forever, daemon=True, name="target link")
        thread.start()
        try:
            self._do(self._open())
            yield self
        finally:
            self._do(self._close())
            self._loop.call_soon_threadsafe(self._loop.stop)
            thread.join()
            self._loop.close()

    def send(self, sighting: PadSighting, pad: Pad) -> None:
        """Send one, stamped now.

        Raises:
            ConfigError: PX4 does not tell where it is, or the link was lost.
        """
        self._do(self._send(sighting, pad))

    def _do(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result()

    async def _open(self) -> None:
        link, self._clock = self._config.link, Clock()
        signing = signing_of(link, start_unix_s(virtual=True))
        self._session = Session(link, signing=signing, follows_pose=True)
        self._transport = transport = await open_transport(link.connection, link.system_id, signing)
        self._works = [self._loop.create_task(work(transport)) for work in (self._receive, self._tick)]
        if not await self._until(lambda: self._session.state.autopilot_kind is not None, PATIENCE_S):
            raise ConfigError(f"--send: {link.connection}: no PX4 or ArduPilot within {PATIENCE_S:g} s")

    async def _close(self) -> None:
        for work in self._works:
            work.cancel()
        await asyncio.gather(*self._works, return_exceptions=True)
        if self._transport is not None:
            self._transport.close()

    async def _until(self, holds: Callable[[], bool], patience_s: float) -> bool:
        until_s = self._clock.now_s() + patience_s
        while not holds() and self._clock.now_s() < until_s:  # noqa: ASYNC110 - the session tells nobody
            await asyncio.sleep(TICK_S)
        return holds()

    async def _receive(self, transport: Transport) -> None:
        while True:
            self._session.receive(await transport.read(), self._clock.now_s())

    async def _tick(self, transport: Transport) -> None:
        while True:
            transport.write(self._session.tick(self._clock.now_s()))
            await asyncio.sleep(TICK_S)

    async def _send(self, sighting: PadSighting, pad: Pad) -> None:
        time_s, kind, poses = self._clock.now_s(), self._session.state.autopilot_kind, self._session.poses
        own_pose: tuple[Vector3, Quaternion] | None = None
        assert kind is not None
        assert poses is not None
        assert self._transport is not None
        if any(work.done() for work in self._works):
            raise ConfigError(f"--send: {self._config.link.connection}: the link was lost")
        if PROFILES[kind].target_frame == "local_ned":
            await self._until(lambda: poses.at(time_s) is not None, POSE_PATIENCE_S)
            pose = poses.at(time_s)
            if pose is None:
                raise ConfigError("--send: PX4 does not tell where it is (LOCAL_POSITION_NED, ATTITUDE)")
            own_pose = (pose.position_ned_m, pose.attitude)
        seen = SeenPad(time_s, sighting.pad_position_body_m, sighting.body_from_pad)
        target = landing_target(seen, (pad.width_m, pad.length_m), own_pose)
        self._transport.write(self._session.send_landing_target(target))
