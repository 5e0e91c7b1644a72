"""What a mission asks of the autopilot besides setpoints, and how our own session does it.

PX4 and ArduPilot differ in nearly every one. Heights are over home; both autopilots get altitudes over the
sea where they go somewhere. Nothing here sends setpoints: they come from the control loop alone, so that they
stop when it stops.
"""

import asyncio
import math
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, Final

from companion.base.autopilots import PROFILES
from companion.base.clock import Clock
from companion.base.geometry import Vector3
from companion.base.messages import Action, ActionKind, ActionResult, AutopilotSetup
from companion.config import LinkConfig
from companion.link.actions.dialogue import Denied, Dialogue, Refused, wanted
from companion.link.autopilot_setup import UNREAD, loss_refusal, thrust_refusal
from companion.link.codec import mavlink
from companion.link.commands import GUIDED_OPTIONS, THRUST_IS_THRUST, WITHDRAWN, request_message
from companion.link.session import Session

_WORDS_S: Final = 0.2  # a refusal's reason comes as a text of its own, before or after it
_SILENT_S: Final = 0.5  # attitudes come many times a second
_SETUP_S: Final = 5.0  # each of its parameters is asked for four times, half a second apart
_LOOK_S: Final = 0.05
_RISEN_SHARE: Final = 0.7  # autopilots brake early
_FORCE: Final = 21196.0  # param2 of MAV_CMD_COMPONENT_ARM_DISARM: whatever the checks say


# of an action, and the mode in which it was asked for
Handler = Callable[[Action, str], Coroutine[Any, Any, None]]


class PymavlinkActions:
    """Asks the autopilot or the ground station for something, as MAVLink commands of our own session.

    `send` takes the bytes to the transport; `attitude_setpoints` shows that the setpoints will be attitude
    and thrust, for which an ArduPilot must be set up. Runs on any loop, in virtual time too.
    """

    def __init__(
        self,
        session: Session,
        send: Callable[[bytes], None],
        clock: Clock,
        config: LinkConfig,
        *,
        attitude_setpoints: bool,
    ) -> None:
        self.dialogue = Dialogue(session, send, clock)
        self._session, self._clock = session, clock
        self._config = config
        self._attitude_setpoints = attitude_setpoints
        self._under_way: list[asyncio.Task[ActionResult]] = []
        self._handlers: dict[ActionKind, Handler] = {
            ActionKind.ARM: self._arm,
            ActionKind.TAKE_OFF: self._take_off,
            ActionKind.GO_TO: self._go_to,
            ActionKind.TAKE_CONTROL: self.take_control,
            ActionKind.HOLD_IF_OBEYED: self.hold_if_obeyed,
            ActionKind.LEAVE_OFFBOARD: self.leave_offboard,
            ActionKind.HOLD: self.hold,
            ActionKind.LAND: self.land,
            ActionKind.DISARM: self.disarm,
            ActionKind.REQUEST_PAD_POSITION: self.request_pad_position,
        }

    async def start(self) -> None:
        """Make ready, before the first `receive`; here nothing."""

    def receive(self, data: bytes) -> None:
        """Hand on what the transport received; the session hears it already."""

    async def close(self) -> None:
        """Give everything back; here nothing."""

    @property
    def mode(self) -> str:
        """The autopilot's, as it was last heard."""
        return self._session.state.mode

    async def perform(self, action: Action, asked_in: str | None = None) -> ActionResult:
        """Do one thing; wait for the answer, not for the vehicle to be there. Whatever fails, it is a result.

        `asked_in`: the mode in which it was asked for, if that was not just now: a change since then counts.
        """
        since, left_before = self.mode if asked_in is None else asked_in, self.dialogue.left
        work = asyncio.create_task(self._result(self._handlers[action.kind], action, since))
        self._under_way.append(work)
        try:
            await asyncio.wait((work,))
        finally:
            self._under_way.remove(work)
            work.cancel()  # when it is we who are cancelled; nothing once it is done
        failure = None if work.cancelled() else work.exception()
        if work.cancelled() or failure is not None:
            text = WITHDRAWN if failure is None else f"{type(failure).__name__}: {failure}"
            in_doubt = True if self.dialogue.left > left_before else None
            return ActionResult(self._clock.now_s(), action.kind, False, text, in_doubt)
        return work.result()

    def cancel(self) -> None:
        """The purpose of all that is under way is void, as when a pilot has taken over.

        From this call on nothing of it is sent or repeated, and each `perform` under way returns
        "withdrawn" at the loop's next turns. What is asked for afterwards need not wait for any of it.
        """
        self.dialogue.withdraw()
        for work in self._under_way:
            work.cancel()

    async def _result(self, handler: Handler, action: Action, asked_in: str) -> ActionResult:
        """How a handler ends; a refusal carries the autopilot's text of that time."""
        session, clock = self._session, self._clock
        heard_before = session.texts_heard
        try:
            await handler(action, asked_in)
        except Refused as refusal:
            await clock.sleep_until(clock.now_s() + _WORDS_S)
            count = session.texts_heard - heard_before
            words = session.state.texts[-count:] if count > 0 else ()
            text = "; ".join((str(refusal), *words))
            return ActionResult(clock.now_s(), action.kind, False, text, refusal.in_doubt)
        return ActionResult(clock.now_s(), action.kind, accepted=True)

    # ------------------------------------------------------------ the actions

    async def _arm(self, action: Action, asked_in: str) -> None:
        """Arm it, but not a vehicle that shows to be armed before it has answered.

        A pilot may have armed it, and then it accepts an ARM all the same. Its answer leaves before the
        heartbeat that shows it armed: where the answer was lost, nobody can tell who has armed it.
        """
        await self.require_setup()  # on the ground is the better place to hear that control will be refused
        await self.ready_to_arm()
        await self.dialogue.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0), void=self.unless_armed)
        await self.dialogue.confirm(lambda: self._session.state.armed, "armed")

    async def ready_to_arm(self) -> None:
        """Put it into the mode in which it is to be armed, if any.

        Raises:
            Refused: it is not in it, or is armed already. Whatever became of the mode, no ARM has left.
        """
        profile = self.dialogue.profile()
        if profile.takes_off_under_control:
            try:
                await self.dialogue.set_mode(profile.control_mode, self.unless_armed)
            except Refused as refusal:
                raise Refused(str(refusal)) from refusal
        wanted(self.unless_armed)

    async def _take_off(self, action: Action, asked_in: str) -> None:
        profile = self.dialogue.profile()
        if profile.takes_off_under_control:
            await self.dialogue.set_mode(profile.control_mode)
        ground_m = 0.0 if profile.takes_off_from_home else self._ground_altitude_m()
        unused = (profile.unused_parameter,) * 6
        await self.dialogue.command(mavlink.MAV_CMD_NAV_TAKEOFF, (*unused, ground_m + action.height_m))

    async def _go_to(self, action: Action, asked_in: str) -> None:
        latitude_deg, longitude_deg, altitude_m = self.destination(action)
        unused = self.dialogue.profile().unused_parameter
        heading_rad = unused if action.heading_rad is None else action.heading_rad
        change_mode = float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
        await self.dialogue.command(
            mavlink.MAV_CMD_DO_REPOSITION,
            (-1.0, change_mode, 0.0, heading_rad),
            (latitude_deg, longitude_deg, altitude_m),
        )

    async def take_control(self, action: Action, asked_in: str) -> None:
        """OFFBOARD or GUIDED, not asked for again once another mode was chosen meanwhile.

        PX4 refuses unless setpoints have been coming already. Its parameters are read anew meanwhile: an
        autopilot learns some of them as it flies.
        """
        self._session.renew_setup()
        await self.require_setup()
        profile = self.dialogue.profile()
        mode, void = profile.control_mode, self.unless_taken(asked_in, profile.after_take_off)
        await self.dialogue.set_mode(mode, void)
        await self.dialogue.confirm(lambda: self._session.state.offboard, mode, void)

    async def hold_if_obeyed(self, action: Action, asked_in: str) -> None:
        """Hold, out of the mode that obeys setpoints alone, which may have been asked for just before.

        A heartbeat may show that mode only now. In any other there is nothing to return.
        """
        control_mode = self.dialogue.profile().control_mode
        with suppress(Refused):
            untaken = self.unless_taken(asked_in)
            await self.dialogue.confirm(lambda: self._session.state.offboard, control_mode, untaken)
        wanted(self._silence)  # what has fallen silent shows nothing
        if self._session.state.offboard:
            await self.hold(action, control_mode)

    async def leave_offboard(self, action: Action, asked_in: str) -> None:
        """Hold instead of OFFBOARD while disarmed; not sent once anybody chose another mode or has armed."""
        hold_mode = self.dialogue.profile().hold_mode

        def void() -> str:
            state = self._session.state
            return "armed again" if state.armed else "" if state.offboard else f"it is in {state.mode}"

        if not self._session.state.offboard:
            return
        try:
            await self.dialogue.set_mode(hold_mode, void)
        except Refused:
            if self._session.state.offboard:
                raise
        await self.dialogue.confirm(lambda: not self._session.state.offboard, hold_mode, void)

    async def hold(self, action: Action, asked_in: str) -> None:
        """Stop and stay, by the autopilot's own mode; not sent (again) once another has been chosen.

        With a `height_m` the autopilot first rises to there by itself, where it can.
        """
        mode = self.dialogue.profile().hold_mode
        void = self.unless_taken(asked_in, mode)
        if action.height_m != 0.0:
            await self._rise(action.height_m, void)
        await self.dialogue.set_mode(mode, void)

    async def _rise(self, height_m: float, void: Callable[[], str]) -> None:
        """Go straight up, and wait for most of it; an autopilot that does not is to hold all the same."""
        here, home = self._session.state.global_position, self._session.state.home
        if here is None or home is None or home[2] + height_m <= here[2]:
            return
        position = (here[0], here[1], home[2] + height_m)
        wanted_m = here[2] + _RISEN_SHARE * (position[2] - here[2])
        change_mode = float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
        parameters = (-1.0, change_mode, 0.0, self.dialogue.profile().unused_parameter)

        def risen() -> bool:
            now = self._session.state.global_position
            return now is None or now[2] >= wanted_m

        with suppress(Refused):
            await self.dialogue.command(mavlink.MAV_CMD_DO_REPOSITION, parameters, position, void)
            await self.dialogue.confirm(risen, "higher", void)

    async def land(self, action: Action, asked_in: str) -> None:
        """Come down where it is, by the autopilot's own mode; as `hold`."""
        mode = self.dialogue.profile().land_mode
        await self.dialogue.set_mode(mode, self.unless_taken(asked_in, mode))

    def unless_armed(self) -> str:
        """Says that it is armed."""
        return "armed before it has answered" if self._session.state.armed else ""

    def unless_taken(self, *ours: str) -> Callable[[], str]:
        """What says that somebody else, a pilot or a failsafe, has changed to none of our modes.

        The mode that obeys setpoints is among them: it may have been asked for just before.
        """
        control_modes = (profile.control_mode for profile in PROFILES.values())
        expected = {*control_modes, *ours}

        def void() -> str:
            now = self._session.state.mode
            return "" if now in expected else f"the mode was changed to {now}"

        return void

    async def disarm(self, action: Action, asked_in: str) -> None:
        """Plainly first; by force where that is refused, the action asks for it and the settings allow it.

        It is for where the vehicle stood when it was asked for. When the autopilot falls silent or changes
        its mode by itself, a failsafe may have taken it up: then nothing more is sent.
        """
        void = self.unless_taken_up(asked_in)
        try:
            await self.dialogue.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, 0.0), void=void)
        except Denied:
            if not (action.force and self._config.force_disarm):
                raise
            await self.dialogue.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, _FORCE), void=void)
        await self.dialogue.confirm(lambda: not self._session.state.armed, "disarmed")

    def unless_taken_up(self, asked_in: str) -> Callable[[], str]:
        """What says that somebody may have taken the vehicle up: LAND, asked for just before, does not."""
        modes = {asked_in, self.dialogue.profile().land_mode}

        def void() -> str:
            state = self._session.state
            if state.armed and state.mode not in modes:
                return f"the autopilot has changed to {state.mode}"
            return self._silence()

        return void

    def _silence(self) -> str:
        """Says that nothing more comes from the autopilot."""
        silent_s = self.dialogue.now_s() - self._session.state.attitude_time_s
        return f"no attitude received for {silent_s:.1f} s" if _SILENT_S < silent_s < math.inf else ""

    async def request_pad_position(self, action: Action, asked_in: str) -> None:
        """Ask the ground station for a FOLLOW_TARGET, which follows its acceptance."""
        command = request_message(
            mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET, self._config.ground_system_id, target_component=0
        )
        outcome = await self.dialogue.outcome(self._session.command(command))
        if outcome != "accepted":
            raise Refused(f"the ground station's answer: {outcome}{self._session.beacons.hint()}")

    async def require_setup(self) -> None:
        """See to it that the autopilot's parameters let us fly it.

        Raises:
            Refused: they do not, and may not be or were not changed.
        """
        setup, kind = await self._setup(), self.dialogue.autopilot_kind()
        if setup is not None and (why := loss_refusal(setup, kind)):
            self._session.renew_setup()  # corrected, it is known by the next request
            raise Refused(why)
        await self._require_thrust()

    async def _setup(self) -> AutopilotSetup | None:
        """What its parameters say, of lost setpoints as freshly as it was asked for; None: nobody reads them.

        Raises:
            Refused: neither read nor given up in time.
        """
        by_s, session = self.dialogue.now_s() + _SETUP_S, self._session
        while session.reads_setup and (session.setup is None or not session.loss_is_fresh):
            now_s = self.dialogue.now_s()
            if now_s >= by_s:
                raise Refused(UNREAD)
            await self._clock.sleep_until(now_s + _LOOK_S)
        return session.setup

    async def _require_thrust(self) -> None:
        """See to it that an attitude setpoint's thrust is thrust: to ArduPilot it is a climb rate by default.

        Raises:
            Refused: it is a climb rate, and may not be or was not changed; or it is not reported.
        """
        if not self._attitude_setpoints or not self.dialogue.profile().thrust_may_be_climb_rate:
            return
        options = await self.dialogue.parameter(self._session.read_parameter(GUIDED_OPTIONS))
        if options & THRUST_IS_THRUST:
            return
        if self._config.set_parameters:
            wanted = options | THRUST_IS_THRUST
            options = await self.dialogue.parameter(self._session.set_parameter(GUIDED_OPTIONS, wanted))
        if why := thrust_refusal(options, may_set=False):
            raise Refused(why)

    # ------------------------------------------------------------ where

    def home(self) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m AMSL) of home.

        Raises:
            Refused: the autopilot has not reported it.
        """
        if self._session.state.home is None:
            raise Refused("the autopilot has not reported its home position")
        return self._session.state.home

    def _ground_altitude_m(self) -> float:
        """Altitude (m AMSL) where it stands: its present one, fresher than home, which arming resets."""
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
