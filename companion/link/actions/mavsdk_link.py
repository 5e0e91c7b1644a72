"""Actions by MAVSDK (4.1: a C++ library in this process, no server), over the port that we own.

MAVSDK has no socket: through its `raw://` connection it gets what we receive, but streams that no action goes
by, and what it wants sent goes out through our transport. It speaks as a component of its own beside ours
(`link.mavsdk_component_id`), with its own sequence numbers, so that neither the autopilot's answers nor its
loss count mix the two up. Its calls and their repeats cannot be stopped once begun: after `cancel` none of
its commands leaves our transport until those calls have ended; what may not wait goes out as our own.

It is never given a setpoint, and control is taken by our own mode command: once its offboard plugin runs,
its thread repeats the last setpoint at 20 Hz though the program that made it has stopped. No telemetry is
subscribed to either: its queues are unbounded, and the session hears everything already.
"""

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

from mavsdk import LogLevel, log_subscribe
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.exceptions import MavsdkError

from companion.base.clock import Clock
from companion.base.messages import Action
from companion.config import ConfigError, LinkConfig
from companion.link.actions.actions import PymavlinkActions
from companion.link.actions.dialogue import Denied, InDoubt, Refused, wanted
from companion.link.codec import has_command, holds_only, mavlink
from companion.link.session import Session
from companion.link.telemetry.autopilot_sensors import SENSOR_MESSAGES

T = TypeVar("T")

_DISCOVERY_S: Final = 3.0
_LOG_LEVELS: Final = {
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.DEBUG,  # what is news to MAVSDK is detail to us
    LogLevel.WARN: logging.WARNING,
    LogLevel.ERROR: logging.WARNING,
}
# how the vehicle moves and what its sensors measure: MAVSDK's action plugin reads none of them
_STREAMS: Final = SENSOR_MESSAGES | {
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
}
_UNSENT: Final = frozenset({"no system", "connection error", "invalid argument"})
_log = logging.getLogger(__name__)


class MavsdkActions(PymavlinkActions):
    """Actions by MAVSDK, in real time only: it has a clock and threads of its own. What it lacks is ours."""

    def __init__(
        self,
        session: Session,
        send: Callable[[bytes], None],
        clock: Clock,
        config: LinkConfig,
        *,
        attitude_setpoints: bool,
    ) -> None:
        if clock.virtual:
            raise ConfigError("link.actions: mavsdk cannot run in virtual time; expected pymavlink")
        super().__init__(session, send, clock, config, attitude_setpoints=attitude_setpoints)
        self._send = send
        self._mavsdk: Any = None
        self._action: Any = None
        self._calls: set[asyncio.Future[Any]] = set()
        self._withdrawn_calls: set[asyncio.Future[Any]] = set()

    async def start(self) -> None:
        """Start MAVSDK; it finds the autopilot by what `receive` hands on."""
        _log_lines.hush()
        configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
        configuration.system_id = self._session.system_id or 1
        configuration.component_id = self._config.mavsdk_component_id
        self._mavsdk = Mavsdk(configuration)
        configuration.destroy()
        loop = asyncio.get_running_loop()

        def send_from_its_thread(data: bytes) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended before we were closed
                loop.call_soon_threadsafe(self._pass_out, data)

        # the subscriber first, of which MAVSDK warns: a connection without one fails to send, and its threads
        # say so whenever they come to it; the raw bytes are not passed through by the asyncio wrapper
        self._mavsdk._mavsdk.subscribe_raw_bytes_to_be_sent(send_from_its_thread)
        _log_lines.pass_on()
        await self._mavsdk.add_any_connection("raw://")

    def receive(self, data: bytes) -> None:
        """Hand on what the transport received, unless no action goes by it: most of what a vehicle says."""
        if self._mavsdk is not None and not holds_only(data, _STREAMS):
            self._mavsdk._mavsdk.pass_received_raw_bytes(data)

    def cancel(self) -> None:
        self._withdrawn_calls |= self._calls
        super().cancel()

    async def close(self) -> None:
        """Wait for the calls under way (MAVSDK gives up by itself), then end its threads."""
        while self._calls:
            await asyncio.wait(self._calls)
        mavsdk, action = self._mavsdk, self._action
        # from here on nothing may reach it: bytes handed to an instance under destruction crash the process
        self._mavsdk = self._action = None
        if mavsdk is not None:
            _log_lines.hush()  # it takes its subscriber away before the connection, as in `start`
        if action is not None:
            action.destroy()
        if mavsdk is not None:
            # it joins threads of its own that may be calling us just now
            try:
                await asyncio.to_thread(mavsdk.destroy)
            finally:
                _log_lines.pass_on()

    # ------------------------------------------------------------ the actions

    async def _arm(self, action: Action, asked_in: str) -> None:
        await self._connect()
        await self.require_setup()
        await self.ready_to_arm()
        await self._try(self._action.arm())
        await self.dialogue.confirm(lambda: self._session.state.armed, "armed")

    async def _take_off(self, action: Action, asked_in: str) -> None:
        await self._connect()
        await self._try(self._action.set_takeoff_altitude(action.height_m))
        await self._try(self._action.takeoff())

    async def _go_to(self, action: Action, asked_in: str) -> None:
        await self._connect()
        latitude_deg, longitude_deg, altitude_m = self.destination(action)
        heading_deg = math.nan if action.heading_rad is None else math.degrees(action.heading_rad)
        await self._try(self._action.goto_location(latitude_deg, longitude_deg, altitude_m, heading_deg))

    async def hold(self, action: Action, asked_in: str) -> None:
        """By MAVSDK; should it fail, by ours: stopping must not hang on one library. To rise is ours.

        Not where another mode was chosen meanwhile, by a pilot or a failsafe: of that ours refuses.
        """
        if action.height_m != 0.0:
            return await super().hold(action, asked_in)
        try:
            await self._connect()
            wanted(self.unless_taken(asked_in, self.dialogue.profile().hold_mode))
            await self._try(self._action.hold())
            self.dialogue.ask_for_heartbeat()
        except Refused:
            await super().hold(action, asked_in)

    async def land(self, action: Action, asked_in: str) -> None:
        """As `hold`."""
        try:
            await self._connect()
            wanted(self.unless_taken(asked_in, self.dialogue.profile().land_mode))
            await self._try(self._action.land())
            self.dialogue.ask_for_heartbeat()
        except Refused:
            await super().land(action, asked_in)

    async def disarm(self, action: Action, asked_in: str) -> None:
        """By MAVSDK, which refuses in the air; then by ours, which may force it where asked and allowed."""
        try:
            await self._connect()
            wanted(self.unless_taken_up(asked_in))
            await self._try(self._action.disarm())
            await self.dialogue.confirm(lambda: not self._session.state.armed, "disarmed")
        except Refused:
            await super().disarm(action, asked_in)

    # ------------------------------------------------------------ MAVSDK

    async def _connect(self) -> None:
        """Make the plugin once MAVSDK has found the autopilot.

        Raises:
            Refused: it has not, or it is still busy with what was withdrawn.
        """
        if self._mavsdk is None:
            raise Refused("MAVSDK is not running")
        if self._withdrawn_calls:
            raise Refused("MAVSDK is still busy with what was withdrawn")
        self.dialogue.autopilot_kind()
        if self._action is not None:
            return
        system = await self._call(self._mavsdk.first_autopilot(_DISCOVERY_S))
        if system is None or self._mavsdk is None:
            raise Refused("MAVSDK has found no autopilot")
        if self._action is None:
            self._action = ActionAsync(system)

    async def _try(self, call: Coroutine[Any, Any, T]) -> T:
        """The outcome of a call.

        Raises:
            InDoubt: MAVSDK has had no answer.
            Refused: it has sent nothing.
            Denied: any other error of MAVSDK's: the autopilot's answer.
        """
        self.dialogue.left += 1
        try:
            return await self._call(call)
        except MavsdkError as error:
            words = _words(error)
            kind = InDoubt if words == "timeout" else Refused if words in _UNSENT else Denied
            raise kind(words) from error

    async def _call(self, call: Coroutine[Any, Any, T]) -> T:
        """Run a call to its end even when we are cancelled: its thread cannot be stopped, only waited for."""
        future = asyncio.ensure_future(call)
        self._calls.add(future)
        future.add_done_callback(self._forget_call)
        return await asyncio.shield(future)

    def _forget_call(self, future: asyncio.Future[Any]) -> None:
        self._calls.discard(future)
        self._withdrawn_calls.discard(future)
        if not future.cancelled():
            future.exception()  # looked at here, in case it is no longer waited for

    def _pass_out(self, data: bytes) -> None:
        if self._mavsdk is None or (self._withdrawn_calls and has_command(data)):
            return
        self._send(data)


def _words(error: MavsdkError) -> str:
    """The result's name in words: "command denied"."""
    result = getattr(error, "result", None)
    return str(error) if result is None else str(result.name).lower().replace("_", " ")


class _LogLines:
    """MAVSDK's log lines, which go to our log instead of the terminal, or nowhere for a while.

    It is subscribed once and never again: another subscription would free the one before, which MAVSDK's
    threads may be calling just then, and that crashes the process.
    """

    def __init__(self) -> None:
        self._hushed = self._subscribed = False

    def hush(self) -> None:
        """Drop what is said from now on."""
        self._hushed = True
        if not self._subscribed:
            self._subscribed = True
            log_subscribe(self._take)

    def pass_on(self) -> None:
        """Let our log have what is said from now on."""
        self._hushed = False

    def _take(self, level: LogLevel, message: str, file: str | None, line: int) -> bool:
        if not self._hushed:
            _log.log(_LOG_LEVELS[level], "mavsdk: %s", message)
        return True


_log_lines = _LogLines()
