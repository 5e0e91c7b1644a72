"""`companion detect --send`: what each picture shows, as a landing target to the autopilot on the link.

For the desk: to see that the autopilot takes it. A picture counts as taken now, by a camera that looks down
from the vehicle's reference point; PX4 is told of the place by its own pose, which it has to have.
"""

import asyncio
from collections.abc import Coroutine, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from threading import Thread
from typing import Any, Final

from companion.base.autopilots import PROFILES
from companion.base.errors import ConfigError
from companion.base.geometry import Quaternion, Vector3
from companion.base.messages import PadSighting
from companion.config import CompanionConfig
from companion.control.landing_target import SeenPad, landing_target
from companion.pad import Pad
from companion.tools.preflight.autopilot import LinkListener, listening

PATIENCE_S: Final = 6.0
POSE_PATIENCE_S: Final = 1.0


class TargetLink:
    """The link to the autopilot, tended on a loop of its own; asks for rates, and sends targets alone."""

    def __init__(self, config: CompanionConfig) -> None:
        self._link, self._loop, self._opened = config.link, asyncio.new_event_loop(), AsyncExitStack()
        self._listener: LinkListener

    @contextmanager
    def opened(self) -> Iterator["TargetLink"]:
        """Open, with an autopilot on it; closed at the end."""
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
        self._do(self._send(sighting, pad))

    def _do(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result()

    async def _open(self) -> None:
        link = listening(self._link, None, follows_pose=True)
        listener = self._listener = await self._opened.enter_async_context(link)
        if not await listener.until(lambda: listener.session.state.autopilot_kind is not None, PATIENCE_S):
            raise ConfigError(f"--send: {self._link.connection}: no PX4 or ArduPilot within {PATIENCE_S:g} s")

    async def _close(self) -> None:
        with suppress(OSError):  # a link that was lost is reported by what was to be sent
            await self._opened.aclose()

    async def _send(self, sighting: PadSighting, pad: Pad) -> None:
        listener, session = self._listener, self._listener.session
        time_s, kind, poses = listener.clock.now_s(), session.state.autopilot_kind, session.poses
        own_pose: tuple[Vector3, Quaternion] | None = None
        assert kind is not None
        assert poses is not None
        if any(work.done() and work.exception() for work in listener.works):
            raise ConfigError(f"--send: {self._link.connection}: the link was lost")
        if PROFILES[kind].target_frame == "local_ned":
            await listener.until(lambda: poses.at(time_s) is not None, POSE_PATIENCE_S)
            pose = poses.at(time_s)
            if pose is None:
                raise ConfigError("--send: PX4 does not tell where it is (LOCAL_POSITION_NED, ATTITUDE)")
            own_pose = (pose.position_ned_m, pose.attitude)
        seen = SeenPad(time_s, sighting.pad_position_body_m, sighting.body_from_pad)
        target = landing_target(seen, (pad.width_m, pad.length_m), own_pose)
        listener.transport.write(session.send_landing_target(target))
