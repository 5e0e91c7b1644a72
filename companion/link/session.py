"""The conversation with the autopilot, sans I/O: bytes in, bytes out, time as an argument.

`receive` takes what came; `tick` returns what is due (call it after every `receive` and at 20 Hz or more):
heartbeats, clock synchronisation, rate requests, commands and their repeats. Only one autopilot is accepted:
component 1 of `config.system_id`, or the first one received when that is 0.
"""

import math
from collections import deque
from dataclasses import replace
from typing import Final

from companion.base.geometry import Quaternion
from companion.base.messages import (
    AutopilotSetup,
    AutopilotState,
    LandedState,
    LandingTargetPose,
    LinkHealth,
    Setpoint,
)
from companion.config import LinkConfig, OrdersConfig, SenseConfig
from companion.link import codec
from companion.link.autopilot_setup import SetupReader
from companion.link.beacon import SYSTEM_BEACON_MESSAGES, BeaconListener
from companion.link.codec import (
    AUTOPILOT_COMPONENT,
    Codec,
    Message,
    Severity,
    is_twins_heartbeat,
    mavlink,
    status_texts,
)
from companion.link.commands import (
    CommandQueue,
    ParameterRequest,
    ParameterRequests,
    Pending,
    VehicleCommand,
    request_message,
    set_message_interval,
)
from companion.link.orders import ORDER_MESSAGES, OrderListener
from companion.link.signing import LinkSigning
from companion.link.streams import (
    HEARD,
    POSE_RATES_HZ,
    TelemetryRates,
    pose_rates_hz,
    telemetry_rates_hz,
)
from companion.link.telemetry.autopilot_sensors import SENSOR_MESSAGES, Sample, TelemetrySensors
from companion.link.telemetry.poses import HeadingOffset, PoseHistory
from companion.link.telemetry.telemetry import StatusTexts, add_text, update_state, without_old
from companion.link.timesync import BootClock, TimeSync, clock_ns

# ---------------------------------------------------------------- others on the link
# A second companion with another component id is a component of the vehicle's like any other, until it sends
# setpoints. (A router passes those on to the autopilot alone: then only the autopilot's mode tells.)

SETPOINT_MESSAGES: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    }
)


def with_twin(
    state: AutopilotState, message: Message, us: tuple[int, int], process: int, now_s: float
) -> AutopilotState | None:
    """The state with what this message tells of them; None: it is no such message."""
    if is_twins_heartbeat(message, us, process):
        return replace(state, twin_time_s=now_s)
    if message.get_msgId() not in SETPOINT_MESSAGES:
        return None
    sender = message.get_srcSystem(), message.get_srcComponent()
    ours = sender == us or message.target_system not in {0, us[0]}
    return state if ours else replace(state, rival=sender, rival_time_s=now_s)


# ---------------------------------------------------------------- texts to people
# What was told into a silent link is sent again when it is heard: the texts that matter most come from the
# silence itself.

SILENT_S: Final = 1.5  # a link that carries heartbeats alone, one a second, is up
UNHEARD: Final = 5  # so few are sent again: setpoints wait behind them


class Notices:
    """Makes the messages; `heard` is called with every message of the autopilot's."""

    def __init__(self) -> None:
        self._told = 0
        # since the autopilot was last heard: it shows only later that the link is silent
        self._unheard: deque[tuple[str, Severity]] = deque(maxlen=UNHEARD)

    def tell(self, text: str, severity: Severity) -> list[Message]:
        """A text now."""
        if severity != "info" and (text, severity) not in self._unheard:
            self._unheard.append((text, severity))
        return self._messages(text, severity)

    def heard(self, silent_s: float) -> list[Message]:
        """What is sent again, now that the autopilot is heard after so long; infinite: for the first time."""
        unheard = list(self._unheard)
        self._unheard.clear()
        if not SILENT_S < silent_s < math.inf:
            return []
        return [message for told in unheard for message in self._messages(*told)]

    def _messages(self, text: str, severity: Severity) -> list[Message]:
        self._told = self._told % 0xFFFF + 1
        return status_texts(text, severity, self._told)


_STAMPED: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    }
)
_HEARTBEAT_S: Final = 1.0
_TIMESYNC_S: Final = 0.2
_TIMESYNC_QUICK_S: Final = 0.1  # at the start, and where samples are stamped by it: as often as PX4 asks us
_TIMESYNC_START_COUNT: Final = 10
_QUESTIONS: Final = 5  # while it goes by a setpoint: with one of them lost, a loss is known in that time
_HOME_S: Final = 2.0


class Session:
    """One autopilot, one link.

    With `sense` the autopilot's own sensors are asked for and read (`onboard`, `take_samples`).
    """

    def __init__(
        self,
        config: LinkConfig,
        sense: SenseConfig | None = None,
        *,
        reads_setup: bool = False,
        follows_pose: bool = False,
        signing: LinkSigning | None = None,
        orders: OrdersConfig | None = None,
        process: int = 0,
    ) -> None:
        """`process` (32 bits) tells this one's heartbeats from those of another with the same ids.

        `follows_pose`: the autopilot's own position and attitude are asked for and kept in `poses`.

        `reads_setup`: the parameters on which our loop depends are asked for as soon as it is received.

        With `signing` all is signed, and nothing is taken that is not.
        """
        self.state = AutopilotState(time_s=-math.inf)
        self.beacons = BeaconListener(config)
        self.heading_offset = HeadingOffset()
        self.timesync = TimeSync()
        self._boot_clock = BootClock(self.timesync)
        self.onboard = None if sense is None else TelemetrySensors(sense, self._boot_clock)
        self.texts_heard = 0
        self.heartbeats = 0
        self.stranger: int | None = None
        self._config = config
        self._system_id = config.system_id
        self.orders = OrderListener(orders or OrdersConfig(), config.component_id, config.ground_system_id)
        heard = (
            HEARD
            | SETPOINT_MESSAGES
            | self.orders.messages
            | (frozenset() if sense is None else SENSOR_MESSAGES)
            | (frozenset(POSE_RATES_HZ) if follows_pose else frozenset())
            | (frozenset() if config.beacon_system_id is None else SYSTEM_BEACON_MESSAGES)
        )
        self._codec = Codec(config.system_id or 1, config.component_id, wanted=heard)
        if signing is not None:
            self._codec.sign(signing)
        self._commands = CommandQueue(config.command_timeout_s, config.command_tries)
        self._parameters = ParameterRequests(config.command_timeout_s, config.command_tries)
        self.reads_setup = reads_setup
        self.poses = PoseHistory() if follows_pose else None
        self._process = process
        self._setup = SetupReader(self._parameters)
        self.rates = TelemetryRates()
        self._texts = StatusTexts()
        self._replies: list[Message] = []
        self._heartbeat_heard_s = -math.inf
        self.heard_s = -math.inf  # when anything of the autopilot's came
        self._heartbeat_due_s = -math.inf
        self._timesync_due_s = -math.inf
        self._home_due_s, self._home_is_old = -math.inf, True
        self._syncs_sent = 0
        self._notices = Notices()

    @property
    def setup(self) -> AutopilotSetup | None:
        """What its parameters say of how it obeys; None until they have been read."""
        return self._setup.setup

    def renew_setup(self) -> None:
        """Ask for the parameters behind `setup` afresh."""
        self._setup.renew()

    @property
    def loss_is_fresh(self) -> bool:
        """Whether what `setup` says of lost setpoints is as fresh as the last `renew_setup`."""
        return not self.reads_setup or self._setup.loss_is_fresh

    @property
    def system_id(self) -> int:
        """The vehicle's system id, which is ours too; 0 while none has been received and none is set."""
        return self._system_id

    @property
    def heartbeat_timeout_s(self) -> float:
        """After so long without a heartbeat the link counts as lost."""
        return self._config.heartbeat_timeout_s

    def correct_clock(self, late_s: float) -> None:
        """The stamps' times are so late (s), since what we hear is slower than what we say; moves slowly."""
        self._boot_clock.late_s = late_s

    def silent_s(self, now_s: float) -> float:
        """For how long (s) nothing has been received, or nothing has shown that it receives us."""
        unanswered_s = now_s - self.state.round_trip_time_s - 2.0 * self._asks_every_s
        return max(now_s - self.heard_s, unanswered_s if math.isfinite(unanswered_s) else 0.0)

    def health(self, now_s: float) -> LinkHealth:
        """Whether the autopilot still goes by what is sent to it."""
        keeps_s = (self.setup or AutopilotSetup()).keeps_setpoint_s
        return LinkHealth(self.silent_s(now_s), keeps_s, self.heartbeat_timeout_s)

    @property
    def _asks_every_s(self) -> float:
        """How often it is asked for the time, which shows that it hears us."""
        setup = self._setup.setup
        return _TIMESYNC_S if setup is None else min(_TIMESYNC_S, setup.keeps_setpoint_s / _QUESTIONS)

    @property
    def counters(self) -> codec.CodecCounters:
        """What the codec has counted."""
        return self._codec.counters

    # ------------------------------------------------------------ in

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes that arrived now."""
        self._codec.advance(now_s)
        refused, us = self.counters.refused, (self._codec.system_id, self._codec.component_id)
        for message in self._codec.decode(data):
            message_id = message.get_msgId()
            if message_id == mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET:
                self.beacons.hear(message, now_s)
            elif self.beacons.is_beacons(message):
                self.beacons.hear_system(message, now_s)
            elif message_id == mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
                self._hear_answer(message, us, now_s)
            elif message_id in ORDER_MESSAGES:
                self.orders.hear_command(message, self._codec.system_id, now_s)
            elif (told := with_twin(self.state, message, us, self._process, now_s)) is not None:
                self.state = told
            elif self._is_our_autopilot(message):
                self._hear_autopilot(message, message_id, now_s)
        if self.counters.refused != refused:
            self.state = replace(self.state, refused_frames=self.counters.refused)

    def _is_our_autopilot(self, message: Message) -> bool:
        """Whether to accept it; the first autopilot is adopted when no system id is set."""
        if message.get_srcComponent() != AUTOPILOT_COMPONENT or not self._is_of_our_system(message):
            return False
        # a link that is up is not given up in flight for a frame of the other version
        mavlink_1 = not self.state.connected and codec.is_mavlink_1(message)
        if mavlink_1 != self.state.mavlink_1:
            self.state = replace(self.state, mavlink_1=mavlink_1)
        return not mavlink_1

    def _is_of_our_system(self, message: Message) -> bool:
        system_id = message.get_srcSystem()
        if system_id == self._system_id:
            return True
        if not codec.is_autopilot_heartbeat(message):
            return False
        if self._system_id == 0:
            self._system_id = self._codec.system_id = system_id
            return True
        self.stranger = system_id
        return False

    def _hear_answer(self, message: Message, us: tuple[int, int], now_s: float) -> None:
        """COMMAND_ACK: a gimbal or a ground station may not answer in the autopilot's place."""
        grounds = message.get_srcSystem() == self._config.ground_system_id != self._system_id
        if message.get_srcComponent() != AUTOPILOT_COMPONENT and not grounds:
            return
        ended = self._commands.acknowledged(message, us, now_s)
        if grounds and ended is not None and ended.accepted:
            self.beacons.accepted(message.get_srcComponent(), now_s)

    def _hear_autopilot(self, message: Message, message_id: int, now_s: float) -> None:
        self.rates.heard(message_id)
        self.orders.heard(now_s)
        self._replies += self._notices.heard(now_s - self.heard_s)
        self.heard_s = now_s
        if self.poses is not None and message_id == mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
            measured_s = self._measured_s(message, message_id, now_s)
            if measured_s is not None:
                self.poses.take_position(measured_s, (message.x, message.y, message.z))
        if message_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
            for text in self._texts.receive(message):
                self.state = add_text(self.state, text, now_s)
                self.texts_heard += 1
        elif message_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            self._hear_timesync(message, now_s)
        elif message_id == mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
            self._parameters.heard(message, self.state.autopilot_kind)
        elif self.orders.hear_autopilot(message, message_id, now_s):
            return
        elif message_id in SENSOR_MESSAGES:
            if self.onboard is not None:
                self.onboard.hear(message, now_s)
        else:
            self._hear_state(message, message_id, now_s)

    def _hear_state(self, message: Message, message_id: int, now_s: float) -> None:
        measured_s = self._measured_s(message, message_id, now_s)
        if measured_s is None:
            return
        before, self.state = self.state, update_state(self.state, message, measured_s)
        if message_id == mavlink.MAVLINK_MSG_ID_HOME_POSITION and self.state is not before:
            self._home_is_old = False
        if self.poses is not None and self.state.attitude is not None:
            self.poses.take_attitude(self.state.attitude_time_s, self.state.attitude)
        if self.state.armed and not before.armed:
            self._home_due_s, self._home_is_old = now_s, True  # arming sets home again
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self.orders.hear_heartbeat(self.state, message.system_status, now_s)
            self._heartbeat_heard_s = now_s
            self.heartbeats += 1
            if self.reads_setup:
                self._setup.begin(self.state.autopilot_kind, self._system_id)
            self.rates.want(telemetry_rates_hz(self.state.autopilot_kind) | self.orders.rates_hz)
            if self.poses is not None:
                self.rates.want(pose_rates_hz(self.state.autopilot_kind))
            if self.onboard is not None:
                self.onboard.heartbeat(self.state.autopilot_kind, now_s)
                self.rates.want(self.onboard.rates_hz())

    def take_samples(self) -> list[Sample]:
        """What the autopilot's own sensors have measured since the last call."""
        return [] if self.onboard is None else self.onboard.take()

    def _hear_timesync(self, message: Message, now_s: float) -> None:
        if message.tc1 == 0:
            self._replies.append(codec.timesync(clock_ns(now_s), message.ts1))
        else:
            if self.timesync.answered(message.tc1, message.ts1, now_s):
                late_s = self.timesync.round_trip_s
                self.state = replace(self.state, round_trip_s=late_s, round_trip_time_s=now_s)
            if self._syncs_sent >= _TIMESYNC_START_COUNT and not self.timesync.settled:
                # the autopilot has restarted, or answers were lost: find the offset quickly again
                self._syncs_sent, self._timesync_due_s = 0, now_s

    def _measured_s(self, message: Message, message_id: int, now_s: float) -> float | None:
        """Our time at which the message's values were measured; None: long ago, or no time at all.

        While the autopilot's clock is unknown it is the time of arrival.
        """
        if message_id not in _STAMPED:
            return now_s
        measured_s = self._boot_clock.time_s(message.time_boot_ms * 1e-3, now_s)
        return now_s if measured_s is None and not self._boot_clock.settled else measured_s

    # ------------------------------------------------------------ out

    def tick(self, now_s: float) -> bytes:
        """What is due to be sent now, as bytes; often empty."""
        self._codec.advance(now_s)
        self._watch_connection(now_s)
        self.state = without_old(self.state, now_s)
        messages, self._replies = [*self._replies, *self.orders.answers()], []
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + _HEARTBEAT_S
            messages.append(codec.heartbeat(self._process))
        if self.state.connected:
            self._synchronise(messages, now_s)
            self._ask(now_s)
            messages += self._parameters.to_send(now_s, self._system_id)
        messages += self._commands.to_send(now_s)
        return b"".join(self._codec.encode(message) for message in messages)

    def align(self, attitude: Quaternion, time_s: float) -> None:
        """Take our own attitude, often: setpoints are turned into the autopilot's heading by it."""
        state = self.state
        if state.attitude is not None:
            self.heading_offset.update(state.attitude, state.attitude_time_s, attitude, time_s)

    def send_setpoint(self, setpoint: Setpoint, now_s: float) -> bytes:
        """A setpoint in our NED as bytes, turned into the autopilot's heading as far as that is known."""
        rotated = self.heading_offset.rotate(setpoint)
        return self._codec.encode(codec.setpoint_message(rotated, now_s, self._codec.system_id))

    def send_landing_target(self, target: LandingTargetPose) -> bytes:
        """A landing target as bytes, with its exposure by the clock that we tell of in TIMESYNC."""
        return self._codec.encode(codec.landing_target_message(target, clock_ns(target.time_s) // 1000))

    def send_notice(self, text: str, severity: Severity) -> bytes:
        """A text for the ground station's and the autopilot's log, as bytes."""
        return b"".join(self._codec.encode(message) for message in self._notices.tell(text, severity))

    def encode(self, message: Message) -> bytes:
        """A message of ours, signed where the link is."""
        return self._codec.encode(message)

    def command(self, command: VehicleCommand) -> Pending:
        """Start a command; `tick` sends it, `Pending.outcome` gives its end."""
        return self._commands.submit(command)

    def read_parameter(self, name: str) -> ParameterRequest:
        """Ask for a parameter; `tick` sends it while the autopilot is connected."""
        return self._parameters.submit(ParameterRequest(name))

    def set_parameter(self, name: str, value: float) -> ParameterRequest:
        """Set an ArduPilot's integer parameter, likewise."""
        return self._parameters.submit(ParameterRequest(name, wanted=value))

    def withdraw(self, pending: Pending | ParameterRequest) -> None:
        """Stop repeating what is no longer waited for."""
        if isinstance(pending, ParameterRequest):
            self._parameters.withdraw(pending)
        else:
            self._commands.withdraw(pending)

    def _watch_connection(self, now_s: float) -> None:
        """Forget, at a loss, all that may have changed unseen; mode and armed stay as last received.

        They hold nothing without `connected`; "disarmed" or another mode made up here would be news of a
        landing or of a pilot.
        """
        lost = now_s - self._heartbeat_heard_s > self._config.heartbeat_timeout_s
        if self.state.connected and lost:
            self.state = replace(
                self.state,
                time_s=now_s,
                connected=False,
                ready_to_arm=False,
                ekf_ready=None,
                landed=LandedState.UNDEFINED,
                round_trip_s=None,
            )
            self.timesync.forget()
            self.rates.forget()
            self._syncs_sent = 0
            self._home_due_s, self._home_is_old = now_s, True

    def _synchronise(self, messages: list[Message], now_s: float) -> None:
        """Ask for the time: quickly at first, and where the autopilot's samples are used."""
        if now_s < self._timesync_due_s:
            return
        quick = self._syncs_sent < _TIMESYNC_START_COUNT or self.onboard is not None
        usual_s = self._asks_every_s
        self._timesync_due_s = now_s + (min(_TIMESYNC_QUICK_S, usual_s) if quick else usual_s)
        self._syncs_sent += 1
        messages.append(codec.timesync(0, self.timesync.ask(now_s)))

    def _ask(self, now_s: float) -> None:
        """Rates that are not honoured, home until it comes and again after arming, with it the version."""
        for message_id, rate_hz in self.rates.to_ask(now_s):
            self._command_once(set_message_interval(message_id, rate_hz, self._system_id))
        if now_s >= self._home_due_s:
            self._home_due_s = now_s + _HOME_S if self._home_is_old else math.inf
            self._command_once(request_message(mavlink.MAVLINK_MSG_ID_HOME_POSITION, self._system_id))
            if self.state.version is None:
                self._command_once(request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self._system_id))

    def _command_once(self, command: VehicleCommand) -> None:
        """Not again while the same one still waits for its answer."""
        if not self._commands.is_under_way(command):
            self._commands.submit(command)
