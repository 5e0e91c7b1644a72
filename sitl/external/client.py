"""A MAVLink client of an external vehicle: its system id, arming state and true pose.

Sans I/O: bytes in with `receive`, bytes out with `transmit`, samples of its pose out with `take_samples`.
Component 26 (MAV_COMP_ID_USER2) of the vehicle's system; of no type that an autopilot waits for. It requests
the simulator's truth by MAV_CMD_SET_MESSAGE_INTERVAL, and again while the rate is too low. When none arrives
for a while, it reports that and uses the autopilot's estimates. A late truth still replaces
them, but not while armed nor after a flight, whose score would be lost: the two are metres apart.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Final

from companion.base.geometry import Vector3
from companion.link.codec import (
    AUTOPILOT_COMPONENT,
    Codec,
    Message,
    command_long,
    is_autopilot_heartbeat,
    mavlink,
)
from sitl.external.pose import (
    ATTITUDE,
    GLOBAL_POSITION,
    LOCAL_POSITION,
    LocalOrigin,
    Sample,
    estimate,
    hil_state,
    local_origin,
    place_of,
    sim_state,
)
from sitl.mavlink.sensor_telemetry import HIL_STATE, SIM_STATE

COMPONENT: Final = mavlink.MAV_COMP_ID_USER2
RATE_HZ: Final = 100.0  # requested rate of the truth, and of the estimates in its place
SLOWEST_HZ: Final = 40.0  # less of it makes the picture wrong by more than the lens does
PATIENCE_S: Final = 5.0  # without the truth, before the estimates are taken
SILENCE_S: Final = 5.0  # without a heartbeat: the vehicle is lost
POSE_SILENCE_S: Final = 1.0
_HEARTBEAT_S: Final = 1.0
_ASK_S: Final = 2.0
_SYNC_S: Final = 1.0
_OLDEST_STAMP_S: Final = 0.5
_TRIPS: Final = 10
_SLOW_WINDOWS: Final = 2
_NS: Final = 1e9

TRUTH: Final[dict[int, str]] = {SIM_STATE: "SIM_STATE", HIL_STATE: "HIL_STATE_QUATERNION"}
TRUTH_OF: Final = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: (SIM_STATE,), mavlink.MAV_AUTOPILOT_PX4: (HIL_STATE,)}
ESTIMATES: Final = "LOCAL_POSITION_NED and ATTITUDE_QUATERNION"
_ESTIMATE_RATES_HZ: Final = {LOCAL_POSITION: 50.0, GLOBAL_POSITION: 5.0}
_HOME: Final = mavlink.MAVLINK_MSG_ID_HOME_POSITION
_HEARTBEAT: Final = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_TIMESYNC: Final = mavlink.MAVLINK_MSG_ID_TIMESYNC
_DO_SET_INTERVAL: Final = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
_DO_REQUEST: Final = mavlink.MAV_CMD_REQUEST_MESSAGE


class StampClock:
    """The vehicle's clock against ours, by TIMESYNC: the answer of the shortest trip among the last ones."""

    def __init__(self) -> None:
        self._asked: deque[int] = deque(maxlen=4)
        self._trips: deque[tuple[float, float]] = deque(maxlen=_TRIPS)

    def ask(self, now_s: float) -> Message:
        sent_ns = max(1, round(now_s * _NS))
        self._asked.append(sent_ns)
        return mavlink.MAVLink_timesync_message(0, sent_ns)

    def hear(self, message: Message, now_s: float) -> None:
        if message.tc1 == 0 or message.ts1 not in self._asked:
            return
        self._asked.remove(message.ts1)
        sent_s = message.ts1 / _NS
        self._trips.append((now_s - sent_s, message.tc1 / _NS - 0.5 * (sent_s + now_s)))

    def time_s(self, stamp_us: int, now_s: float) -> float:
        """When a message was stamped on our clock; now when it has no stamp, or one that cannot be."""
        if stamp_us == 0 or not self._trips:
            return now_s
        time_s = stamp_us * 1e-6 - min(self._trips)[1]
        return time_s if now_s - _OLDEST_STAMP_S < time_s <= now_s else now_s


class VehicleClient:
    """Watches one vehicle: the first autopilot received."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        """`tell` gets each problem in one line, once while it lasts."""
        self.armed = False
        self.flown = False  # set by the judge of the flight; the source stays then
        self.home: Vector3 | None = None
        self.source: str | None = None
        self.beats = 0
        self._tell = tell
        self._system: int | None = None
        self._autopilot = mavlink.MAV_AUTOPILOT_GENERIC
        self._clock = StampClock()
        self._handlers = self._all_handlers()
        self._codec = Codec(1, COMPONENT, wanted=self._handlers)
        self._samples: list[Sample] = []
        self._found_s = self._beat_s = self._truth_s = self._pose_s = -math.inf
        self._heartbeat_due_s = self._sync_due_s = self._ask_due_s = -math.inf
        self._counts: dict[int, int] = {}
        self._on_estimates = False
        self._attitude: Message | None = None
        self._ahead_s = math.nan  # the simulator's clock minus ours
        self._anchor: LocalOrigin | None = None
        self._global: Message | None = None
        self._lost = self._blind = self._kept = False
        self._slow_windows = 0

    @property
    def system_id(self) -> int:
        """The vehicle's; 1 before it is known."""
        return self._system or 1

    def take_samples(self) -> list[Sample]:
        """The poses since the last call, all of `source`."""
        samples, self._samples = self._samples, []
        return samples

    # ------------------------------------------------------------ in

    def receive(self, data: bytes, now_s: float) -> None:
        for message in self._codec.decode(data):
            if message.get_srcComponent() != AUTOPILOT_COMPONENT:
                continue
            number = message.get_msgId()
            if self._system is None and not is_autopilot_heartbeat(message):
                continue
            if self._system not in (None, message.get_srcSystem()):
                continue
            self._counts[number] = self._counts.get(number, 0) + 1
            self._handlers[number](message, now_s)

    def _all_handlers(self) -> dict[int, Callable[[Message, float], None]]:
        return {
            _HEARTBEAT: self._on_heartbeat,
            _TIMESYNC: self._clock.hear,
            _HOME: self._on_home,
            SIM_STATE: lambda m, now_s: self._on_truth(SIM_STATE, sim_state(m, now_s), now_s),
            HIL_STATE: lambda m, now_s: self._on_truth(
                HIL_STATE, hil_state(m, self._clock.time_s(m.time_usec, now_s)), now_s
            ),
            ATTITUDE: self._on_attitude,
            GLOBAL_POSITION: self._on_global,
            LOCAL_POSITION: self._on_local,
        }

    def _on_heartbeat(self, message: Message, now_s: float) -> None:
        if not is_autopilot_heartbeat(message):
            return
        if self._system is None:
            self._system = self._codec.system_id = message.get_srcSystem()
            self._autopilot = message.autopilot
            self._found_s = now_s
        if self._lost:
            self._lost = False
            self._ask_due_s = now_s
            self._tell(f"vehicle {self._system}: received again")
        self._beat_s = now_s
        self.beats += 1
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _on_home(self, message: Message, now_s: float) -> None:
        self.home = place_of(message.latitude, message.longitude, message.altitude) or self.home

    def _on_truth(self, number: int, sample: Sample | None, now_s: float) -> None:
        if sample is None:
            return
        self._truth_s = now_s
        if self._on_estimates and not self._give_up_estimates(TRUTH[number]):
            return
        self._take(sample, TRUTH[number], now_s)

    def _give_up_estimates(self, truth: str) -> bool:
        """Whether it may be: another origin in flight would be a jump, and after it the score be lost."""
        if self.armed or self.flown:
            if not self._kept:
                why = "has flown" if self.flown else "is armed"
                self._tell(f"{truth} comes after all, but the vehicle {why}: keeping to the estimates")
            self._kept = True
            return False
        self._on_estimates = self._kept = False
        self._samples.clear()
        self._tell(f"{truth} comes after all: the pose is the simulator's truth")
        return True

    def _take(self, sample: Sample, source: str, now_s: float) -> None:
        self.source, self._pose_s = source, now_s
        self._samples.append(sample._replace(simulated_s=now_s + self._ahead_s))

    def _on_attitude(self, message: Message, now_s: float) -> None:
        self._attitude = message
        self._ahead_s = message.time_boot_ms * 1e-3 - now_s

    def _on_global(self, message: Message, now_s: float) -> None:
        self._global = message

    def _on_local(self, message: Message, now_s: float) -> None:
        """An estimate; its local frame is tied to the globe once, where both are known."""
        if not self._on_estimates or self._attitude is None:
            return
        if self._anchor is None and self._global is not None:
            self._anchor = local_origin(message, self._global)
        if self._anchor is None:
            return
        sample = estimate(message, self._attitude, self._anchor, now_s)
        if sample is not None:
            self._take(sample, ESTIMATES, now_s)

    # ------------------------------------------------------------ out

    def encode(self, message: Message) -> bytes:
        return self._codec.encode(message)

    def transmit(self, now_s: float) -> bytes:
        """All that is due: heartbeat, clock questions, requests. Call it often: it watches silence too."""
        self._watch(now_s)
        messages: list[Message] = []
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + _HEARTBEAT_S
            messages.append(_own_heartbeat())
        if self._system is not None and now_s >= self._sync_due_s:
            self._sync_due_s = now_s + _SYNC_S
            messages.append(self._clock.ask(now_s))
        if self._system is not None and now_s >= self._ask_due_s:
            self._ask_due_s = now_s + _ASK_S
            messages += self._requests()
        return b"".join([self._codec.encode(message) for message in messages])

    def _requests(self) -> list[Message]:
        """Request messages that arrived too rarely since the last time."""
        # neither truth has a stamp: ATTITUDE_QUATERNION, of the same rate, shows the simulator's clock
        wanted = dict.fromkeys((*TRUTH_OF.get(self._autopilot, tuple(TRUTH)), ATTITUDE), RATE_HZ)
        if self._on_estimates:
            wanted |= _ESTIMATE_RATES_HZ
        counts, self._counts = self._counts, {}
        self._watch_rate(max(counts.get(number, 0) for number in TRUTH))
        requests = [
            command_long(_DO_SET_INTERVAL, (number, 1e6 / rate_hz, 0, 0, 0, 0, 0), self.system_id)
            for number, rate_hz in wanted.items()
            if counts.get(number, 0) < 0.6 * rate_hz * _ASK_S
        ]
        if self.home is None:
            requests.append(command_long(_DO_REQUEST, (_HOME, 0, 0, 0, 0, 0, 0), self.system_id))
        return requests

    def _watch_rate(self, count: int) -> None:
        rate_hz = count / _ASK_S
        slow = 0.0 < rate_hz < SLOWEST_HZ and self._pose_s - self._found_s > 2.0 * _ASK_S
        # twice in a row: one that begins or ends within the window is no slow one
        self._slow_windows = self._slow_windows + 1 if slow else 0
        if self._slow_windows == _SLOW_WINDOWS:
            self._tell(f"{self.source} comes at {rate_hz:.0f} Hz only; expected {SLOWEST_HZ:g} Hz or more")

    def _watch(self, now_s: float) -> None:
        """Report time-outs, and give up the truth when it never arrived."""
        if self._system is None:
            return
        if not self._lost and now_s - self._beat_s > SILENCE_S:
            self._lost = True
            self._tell(f"vehicle {self._system}: no heartbeat for {SILENCE_S:g} s; waiting for it")
        if self._lost:
            return
        blind = self.source is not None and now_s - self._pose_s > POSE_SILENCE_S
        if blind and not self._blind:
            self._tell(f"no {self.source} for {POSE_SILENCE_S:g} s; the camera waits for it")
        self._blind = blind
        never = self._truth_s == -math.inf and now_s - self._found_s > PATIENCE_S
        if never and not self._on_estimates:
            self._on_estimates = True
            self._ask_due_s = now_s
            names = " or ".join(TRUTH[n] for n in TRUTH_OF.get(self._autopilot, tuple(TRUTH)))
            self._tell(
                f"WARNING: no {names} within {PATIENCE_S:g} s, so no truth: taking the autopilot's estimates "
                f"({ESTIMATES}); pictures and score err as they do"
            )


def _own_heartbeat() -> Message:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
