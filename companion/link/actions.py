"""What a mission asks of the autopilot besides setpoints: the interface, and how our own session does it.

PX4 and ArduPilot differ in nearly every one. Heights are over home; both autopilots get altitudes over the
sea where they go somewhere. Nothing here sends setpoints: they come from the control loop alone, so that they
stop when it stops.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Final, Protocol

from companion.clock import Clock
from companion.config import LinkConfig
from companion.geometry import Vector3
from companion.link.codec import mavlink
from companion.link.commands import NO_ANSWER, Command, request_message
from companion.link.modes import CONTROL_MODE, HOLD_MODE, LAND_MODE, mode_parameters
from companion.link.session import Session
from companion.messages import Action, ActionKind, ActionResult, Manner

_POLL_S: Final = 0.01
_CONFIRM_S: Final = 2.5  # some autopilots tell a new mode only in the next heartbeat, at 1 Hz
_WORDS_S: Final = 0.2  # a refusal's reason comes as a text of its own, before or after it
_FORCE: Final = 21196.0  # param2 of MAV_CMD_COMPONENT_ARM_DISARM: whatever the checks say


class Refused(Exception):  # noqa: N818 - it reads as what happened
    """An action came to nothing; the text says why."""


class VehicleActions(Protocol):
    """Asks the autopilot or the ground station for something and tells how it went."""

    async def start(self) -> None:
        """Make ready; before the first `receive`."""

    def receive(self, data: bytes) -> None:
        """Hand on what the transport received, which may be more than one implementation's business."""

    async def perform(self, action: Action) -> ActionResult:
        """Do one thing; wait for the answer, not for the vehicle to be there. A refusal is a result."""

    async def close(self) -> None:
        """Give everything back."""


class PymavlinkActions:
    """Actions as MAVLink commands of our own session.

    `send` takes the bytes to the transport. Runs on any loop, in virtual time too.
    """

    def __init__(
        self, session: Session, send: Callable[[bytes], None], clock: Clock, config: LinkConfig
    ) -> None:
        self._session = session
        self._send = send
        self._clock = clock
        self._config = config
        self._handlers: dict[ActionKind, Callable[[Action], Awaitable[None]]] = {
            ActionKind.ARM: self._arm,
            ActionKind.TAKE_OFF: self._take_off,
            ActionKind.GO_TO: self._go_to,
            ActionKind.TAKE_CONTROL: self.take_control,
            ActionKind.HOLD: self.hold,
            ActionKind.LAND: self.land,
            ActionKind.DISARM: self.disarm,
            ActionKind.REQUEST_PAD_POSITION: self.request_pad_position,
        }

    async def start(self) -> None:
        """Nothing to make ready."""

    def receive(self, data: bytes) -> None:
        """Nothing: the session hears everything already."""

    async def close(self) -> None:
        """Nothing to give back."""

    async def perform(self, action: Action) -> ActionResult:
        """See `VehicleActions`."""
        return await perform_with(self._handlers[action.kind], action, self._session, self._clock)

    # ------------------------------------------------------------ the actions

    async def _arm(self, action: Action) -> None:
        if self.manner() == "ardupilot":
            await self.set_mode("GUIDED")  # it takes off in this mode only
        await self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0))
        await self.confirm(lambda: self._session.state.armed, "armed")

    async def _take_off(self, action: Action) -> None:
        unused = self._unused()
        if self.manner() == "ardupilot":
            await self.set_mode("GUIDED")
            height_m = action.height_m  # ArduPilot counts from home
        else:
            height_m = self._ground_altitude_m() + action.height_m
        await self.command(mavlink.MAV_CMD_NAV_TAKEOFF, (unused,) * 6 + (height_m,))

    async def _go_to(self, action: Action) -> None:
        latitude_deg, longitude_deg, altitude_m = self.destination(action)
        heading_rad = self._unused() if action.heading_rad is None else action.heading_rad
        change_mode = float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
        await self.command(
            mavlink.MAV_CMD_DO_REPOSITION,
            (-1.0, change_mode, 0.0, heading_rad),
            (latitude_deg, longitude_deg, altitude_m),
        )

    async def take_control(self, action: Action) -> None:
        """OFFBOARD or GUIDED. PX4 refuses unless setpoints have been coming already."""
        await self.set_mode(CONTROL_MODE[self.manner()])
        await self.confirm(lambda: self._session.state.offboard, CONTROL_MODE[self.manner()])

    async def hold(self, action: Action) -> None:
        """Stop and stay, by the autopilot's own mode."""
        await self.set_mode(HOLD_MODE[self.manner()])

    async def land(self, action: Action) -> None:
        """Come down where it is, by the autopilot's own mode."""
        await self.set_mode(LAND_MODE[self.manner()])

    async def disarm(self, action: Action) -> None:
        """Plainly first; by force only where the action asks for it and the settings allow it."""
        try:
            await self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, 0.0))
        except Refused:
            if not (action.force and self._config.force_disarm):
                raise
            await self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, _FORCE))
        await self.confirm(lambda: not self._session.state.armed, "disarmed")

    async def request_pad_position(self, action: Action) -> None:
        """Ask the ground station for a FOLLOW_TARGET; the message itself is an answer too."""
        before = self._session.beacon
        command = request_message(
            mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET, self._config.ground_system_id, target_component=0
        )
        outcome = await self._outcome(command, lambda: self._session.beacon is not before)
        if outcome != "accepted":
            raise Refused(f"the ground station's answer: {outcome}")

    # ------------------------------------------------------------ what they are made of

    def manner(self) -> Manner:
        """Whose manners the autopilot has.

        Raises:
            Refused: none is connected, or an unknown one.
        """
        state = self._session.state
        if not state.connected:
            raise Refused("no autopilot is heard")
        if state.manner is None:
            raise Refused("the autopilot is neither PX4 nor ArduPilot")
        return state.manner

    def home(self) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m AMSL) of home.

        Raises:
            Refused: the autopilot has not told it.
        """
        if self._session.state.home is None:
            raise Refused("the autopilot has not told its home position")
        return self._session.state.home

    def _ground_altitude_m(self) -> float:
        """Altitude (m AMSL) where it stands: its present one, fresher than home, which arming sets anew."""
        present = self._session.state.global_position
        return self.home()[2] if present is None else present[2]

    def destination(self, action: Action) -> Vector3:
        """Where to go: latitude (deg), longitude (deg), altitude (m AMSL).

        Raises:
            Refused: home is not known, or the action has no position.
        """
        if action.position is None:
            raise Refused("the action has no position")
        latitude_deg, longitude_deg, height_m = action.position
        return (latitude_deg, longitude_deg, self.home()[2] + height_m)

    async def set_mode(self, mode: str) -> None:
        """Change the flight mode.

        Raises:
            Refused: the autopilot does not.
        """
        parameters = mode_parameters(self.manner(), mode)
        await self.command(mavlink.MAV_CMD_DO_SET_MODE, (*parameters, 0.0, 0.0, 0.0, 0.0))
        self.ask_for_heartbeat()

    async def command(
        self, number: int, parameters: tuple[float, ...], position: Vector3 | None = None
    ) -> None:
        """Send a command to the autopilot and wait for its answer.

        Raises:
            Refused: it does not answer, or not "accepted".
        """
        self.manner()
        if position is None:
            parameters = (*parameters, *(self._unused(),) * (7 - len(parameters)))
        command = Command(number, parameters, position, target_system=self._session.system_id)
        outcome = await self._outcome(command)
        if outcome != "accepted":
            raise Refused("the autopilot does not answer" if outcome == NO_ANSWER else outcome)

    async def confirm(self, holds: Callable[[], bool], what: str) -> None:
        """Wait until the autopilot's own state shows what it has accepted.

        Raises:
            Refused: it does not in time.
        """
        until_s = self._clock.now_s() + _CONFIRM_S
        if not holds():
            self.ask_for_heartbeat()
        while not holds():
            if self._clock.now_s() >= until_s:
                raise Refused(f"accepted, but not {what}")
            await self._clock.sleep_until(self._clock.now_s() + _POLL_S)

    def ask_for_heartbeat(self) -> None:
        """Have the new mode told now instead of within a second; nothing is lost when it is not."""
        self._session.command(request_message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, self._session.system_id))
        self._send(self._session.tick(self._clock.now_s()))

    async def _outcome(self, command: Command, settled: Callable[[], bool] = lambda: False) -> str:
        """How the command ended; "accepted" too when what it asks for is `settled` without an answer."""
        pending = self._session.command(command)
        try:
            while pending.outcome is None:
                if settled():
                    return "accepted"
                now_s = self._clock.now_s()
                self._send(self._session.tick(now_s))
                if pending.outcome is None:
                    await self._clock.sleep_until(now_s + _POLL_S)
        finally:
            self._session.withdraw(pending)
        return pending.outcome or NO_ANSWER

    def _unused(self) -> float:
        """A parameter without a value: NaN for PX4; ArduPilot takes NaN for a number and wants 0."""
        return 0.0 if self._session.state.manner == "ardupilot" else math.nan


async def perform_with(
    handler: Callable[[Action], Awaitable[None]], action: Action, session: Session, clock: Clock
) -> ActionResult:
    """Run a handler and tell how it went; a refusal carries the autopilot's words of that time."""
    heard_before = session.texts_heard
    try:
        await handler(action)
    except Refused as refusal:
        await clock.sleep_until(clock.now_s() + _WORDS_S)
        count = session.texts_heard - heard_before
        words = session.state.texts[-count:] if count > 0 else ()
        text = "; ".join((str(refusal), *words))
        return ActionResult(clock.now_s(), action.kind, accepted=False, text=text)
    return ActionResult(clock.now_s(), action.kind, accepted=True)
