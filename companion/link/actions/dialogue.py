"""Asking the autopilot or the ground station for something and waiting for the answer.

On top of the session, which sends, repeats and receives: here are the waiting, the refusals in words, and the
end of the waiting when what was asked for is void.
"""

from collections.abc import Callable
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES, AutopilotMake, mode_parameters
from companion.base.clock import Clock
from companion.base.geometry import Vector3
from companion.link.codec import mavlink
from companion.link.commands import (
    NO_ANSWER,
    WITHDRAWN,
    ParameterRequest,
    Pending,
    VehicleCommand,
    request_message,
)
from companion.link.session import Session

_POLL_S: Final = 0.01
_CONFIRM_S: Final = 2.5  # some autopilots report a new mode only in the next heartbeat, at 1 Hz


class Refused(Exception):  # noqa: N818 - it reads as what happened
    """An action came to nothing; the text says why. `in_doubt` as in `ActionResult`."""

    in_doubt: bool | None = None


class Denied(Refused):
    """The autopilot's own answer says so."""

    in_doubt = False


class InDoubt(Refused):
    """It left, and was not denied, so that it may have been carried out or not."""

    in_doubt = True


def _wanted_still() -> str:
    return ""


def wanted(void: Callable[[], str], *, left: bool = False) -> None:
    """See to it that something is wanted still.

    Raises:
        Refused: `void` says why it is not; in doubt if it has `left`.
    """
    if why := void():
        raise (InDoubt if left else Refused)(why)


class Dialogue:
    """Questions to the other end of the link. `void` functions say why an answer is not wanted any more."""

    def __init__(self, session: Session, send: Callable[[bytes], None], clock: Clock) -> None:
        self._session = session
        self._send = send
        self._clock = clock
        self._waited_for: list[Pending | ParameterRequest] = []
        self.left = 0  # how many have left so far

    def withdraw(self) -> None:
        """Send nothing more of all that is waited for."""
        for pending in self._waited_for:
            self._session.withdraw(pending)

    def now_s(self) -> float:
        return self._clock.now_s()

    def autopilot_kind(self) -> AutopilotKind:
        """The kind of the autopilot.

        Raises:
            Refused: none is connected, or an unknown one.
        """
        state = self._session.state
        if not state.connected:
            raise Refused("no autopilot on the link")
        if state.autopilot_kind is None:
            raise Refused("no PX4 or ArduPilot multirotor")
        return state.autopilot_kind

    def profile(self) -> AutopilotMake:
        """The autopilot's profile.

        Raises:
            Refused: none is connected, or an unknown one.
        """
        return PROFILES[self.autopilot_kind()]

    async def set_mode(self, mode: str, void: Callable[[], str] = _wanted_still) -> None:
        """Change the flight mode, unless `void` says meanwhile why it is not wanted any more.

        Raises:
            Refused: the autopilot does not, or it is void.
        """
        parameters = mode_parameters(self.autopilot_kind(), mode)
        await self.command(mavlink.MAV_CMD_DO_SET_MODE, (*parameters, 0.0, 0.0, 0.0, 0.0), void=void)
        self.ask_for_heartbeat()

    async def command(
        self,
        number: int,
        parameters: tuple[float, ...],
        position: Vector3 | None = None,
        void: Callable[[], str] = _wanted_still,
    ) -> None:
        """Send a command to the autopilot and wait for its answer.

        Raises:
            InDoubt: it does not answer, or it is void or withdrawn before it has.
            Denied: it answers something else than "accepted".
            Refused: it is void before it leaves.
        """
        unused = self.profile().unused_parameter
        if position is None:
            parameters = (*parameters, *(unused,) * (7 - len(parameters)))
        command = VehicleCommand(number, parameters, position, target_system=self._session.system_id)
        outcome = await self.outcome(self._session.command(command), void=void)
        if outcome == NO_ANSWER:
            raise InDoubt("the autopilot does not answer")
        if outcome == WITHDRAWN:
            raise InDoubt(outcome)
        if outcome != "accepted":
            raise Denied(outcome)

    async def confirm(
        self, holds: Callable[[], bool], what: str, void: Callable[[], str] = _wanted_still
    ) -> None:
        """Wait until the autopilot's own state shows what it has accepted.

        Raises:
            InDoubt: it does not in time, or it is void.
        """
        until_s = self._clock.now_s() + _CONFIRM_S
        if not holds():
            self.ask_for_heartbeat()
        while not holds():
            wanted(void, left=True)
            if self._clock.now_s() >= until_s:
                raise InDoubt(f"accepted, but not {what}")
            await self._clock.sleep_until(self._clock.now_s() + _POLL_S)

    def ask_for_heartbeat(self) -> None:
        """Have the new mode reported now instead of within a second; nothing is lost when it is not."""
        self._session.command(request_message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, self._session.system_id))
        self._send(self._session.tick(self._clock.now_s()))

    async def parameter(self, request: ParameterRequest) -> int:
        """The autopilot's newest answer for an integer parameter.

        Raises:
            Refused: it said nothing.
        """
        await self.outcome(request)
        if request.value is None:
            raise Refused(f"the autopilot does not report its {request.name}")
        return round(request.value)

    async def outcome(
        self,
        pending: Pending | ParameterRequest,
        void: Callable[[], str] = _wanted_still,
    ) -> str:
        """How it ended.

        Raises:
            Refused: it is void; in doubt if it has left.
        """
        self._waited_for.append(pending)
        try:
            while pending.outcome is None:
                wanted(void, left=pending.tries > 0)
                now_s = self._clock.now_s()
                self._send(self._session.tick(now_s))
                if pending.outcome is None:
                    await self._clock.sleep_until(now_s + _POLL_S)
        finally:
            self.left += pending.tries > 0
            self._waited_for.remove(pending)
            self._session.withdraw(pending)
        return pending.outcome or NO_ANSWER
