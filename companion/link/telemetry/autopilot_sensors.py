"""The autopilot's own IMU, magnetometer, GPS and rangefinder as our sensors, by its telemetry. Pure.

Each sample carries the instant of its measurement (`boot_clock`, less the settings' latencies), whatever
the link's delay. Of the messages that may carry the IMU the best one that comes is taken, in the order of
`IMU_MESSAGES`; a lesser one only while the better ones are silent. `watch` says in one line what is missing.
"""

import math
from collections import Counter, deque
from dataclasses import replace
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import SenseConfig
from companion.link.codec import Message, mavlink
from companion.link.dialect import message_number
from companion.link.telemetry import readings
from companion.link.timing.boot_clock import BootClock, Instant

Sample = ImuSample | MagSample | GpsFix | RangeSample

_HIGHRES: Final = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
_RAW: Final = mavlink.MAVLINK_MSG_ID_RAW_IMU
_SCALED: Final = mavlink.MAVLINK_MSG_ID_SCALED_IMU
_GPS: Final = mavlink.MAVLINK_MSG_ID_GPS_RAW_INT
_RANGE: Final = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
_POSITION: Final = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
SENSOR_MESSAGES: Final = frozenset({_HIGHRES, _RAW, _SCALED, _GPS, _RANGE, _POSITION})
# best first
IMU_MESSAGES: Final = {
    kind: tuple(message_number(name) for name in profile.imu_messages) for kind, profile in PROFILES.items()
}
_NAMES: Final = {number: mavlink.mavlink_map[number].msgname for number in SENSOR_MESSAGES}

SWITCH_S: Final = 0.5  # a better message is silent for so long: take the next best
IMU_SILENCE_S: Final = 0.5  # without the IMU for longer there is no estimate
SILENCE_S: Final = 2.0  # a stream that has said nothing usable for so long is a problem
PATIENCE_S: Final = 6.0  # after the first heartbeat: rates are asked for, and asked for again
# the autopilot's own climb rate, which GPS_RAW_INT has not: what it may be off by, and by how much its time
# may miss the fix's
CLIMB_ACCURACY_M_S: Final = 1.0
CLIMB_AGE_S: Final = 0.1
_CLIMBS_HZ: Final = 30.0
_CLIMBS_KEPT: Final = 40
SLOWEST_IMU_HZ: Final = 45.0  # 50 Hz less what a stream may be off
_WINDOW_S: Final = 2.0


class TelemetrySensors:
    """Takes the messages of one autopilot; `take` gives the samples since the last call."""

    def __init__(self, config: SenseConfig, clock: BootClock) -> None:
        self._config = config
        self._clock = clock
        self._autopilot_kind: AutopilotKind | None = None
        self._connected_s = self._heartbeat_s = -math.inf
        self._samples: list[Sample] = []
        self._climbs: deque[tuple[float, float]] = deque(maxlen=_CLIMBS_KEPT)  # autopilot's s, down m/s
        self._imu_message: int | None = None
        self._unused_s = 0.0
        self._range_id: int | None = None
        self._heard_s: dict[int, float] = {}
        self._used_s: dict[str, float] = {}
        self._window_s, self._window_count, self._imu_rate_hz = -math.inf, 0, math.inf
        self.refused: Counter[str] = Counter()

    def rates_hz(self) -> dict[int, float]:
        """Which messages to ask for, at which rates; nothing before the autopilot is known."""
        if self._autopilot_kind is None:
            return {}
        config = self._config.autopilot
        imu = IMU_MESSAGES[self._autopilot_kind][0]
        rates = {imu: config.imu_rate_hz, _GPS: config.gps_rate_hz, _POSITION: _CLIMBS_HZ}
        if self._config.range_by_telemetry:
            rates[_RANGE] = config.range_rate_hz
        return rates

    def take(self) -> list[Sample]:
        """The samples since the last call, in the order of their arrival."""
        samples, self._samples = self._samples, []
        return samples

    # ------------------------------------------------------------ in

    def heartbeat(self, autopilot_kind: AutopilotKind | None, now_s: float) -> None:
        """The autopilot is there, and of that kind."""
        if now_s - self._heartbeat_s > PATIENCE_S:
            self._connected_s = now_s
        self._autopilot_kind, self._heartbeat_s = autopilot_kind, now_s

    def hear(self, message: Message, now_s: float) -> None:
        """Take one of SENSOR_MESSAGES that came now."""
        number = message.get_msgId()
        if self._autopilot_kind is None:
            return
        if number == _GPS:
            self._hear_gps(message, now_s)
        elif number == _RANGE:
            self._hear_range(message, now_s)
        elif number == _POSITION:  # its vertical velocity, for a fix of that time
            self._climbs.append((readings.stamp_s(message), message.vz))
        elif self._is_best(number, now_s):
            self._hear_imu(message, now_s)

    def _with_climb(self, fix: GpsFix, stamp_s: float) -> GpsFix:
        """A fix with the vertical velocity of its time (by the autopilot's clock), if that is known."""
        near = min(self._climbs, key=lambda climb: abs(climb[0] - stamp_s), default=None)
        if near is None or abs(near[0] - stamp_s) > CLIMB_AGE_S or not math.isfinite(near[1]):
            return fix
        north, east, _ = fix.velocity_ned_m_s
        return replace(
            fix, velocity_ned_m_s=(north, east, near[1]), vertical_speed_accuracy_m_s=CLIMB_ACCURACY_M_S
        )

    def _is_best(self, number: int, now_s: float) -> bool:
        """Whether the IMU is to be taken from this kind of message."""
        assert self._autopilot_kind is not None
        order = IMU_MESSAGES[self._autopilot_kind]
        if number not in order:
            return False
        self._heard_s[number] = now_s
        better = order[: order.index(number)]
        if any(now_s - self._heard_s.get(other, -math.inf) < SWITCH_S for other in better):
            return False
        self._imu_message = number
        return True

    def _hear_imu(self, message: Message, now_s: float) -> None:
        assert self._autopilot_kind is not None
        if (instant := self._instant("imu", message, now_s)) is None:
            return
        set_s = self._config.autopilot.imu_latency_s
        latency_s = PROFILES[self._autopilot_kind].imu_latency_s if set_s is None else set_s
        time_s = instant.time_s - latency_s
        sample = readings.imu_sample(message, time_s, self._since_used_s(instant))
        if sample is not None:
            self._unused_s = 0.0
        self._use("imu", sample, now_s)
        if (field := readings.mag_sample(message, time_s)) is not None:
            self._use("mag", field, now_s)

    def _since_used_s(self, instant: Instant) -> float | None:
        """By the autopilot's clock since the last sample that was good; None when that is not known."""
        if instant.interval_s is None:
            self._unused_s = 0.0
            return None
        self._unused_s += instant.interval_s
        return self._unused_s

    def _hear_gps(self, message: Message, now_s: float) -> None:
        self._heard_s[_GPS] = now_s
        if message.fix_type < mavlink.GPS_FIX_TYPE_3D_FIX:
            return  # nothing wrong: it waits for satellites, and so does the mission
        if (instant := self._instant("gps", message, now_s)) is not None:
            latency_s = self._config.autopilot.gps_latency_s
            fix = readings.gps_fix(message, instant.time_s - latency_s)
            if fix is not None:
                fix = self._with_climb(fix, readings.stamp_s(message) - latency_s)
            self._use("gps", fix, now_s)

    def _hear_range(self, message: Message, now_s: float) -> None:
        if not (self._config.range_by_telemetry and readings.looks_down(message)):
            return
        if self._range_id is None or now_s - self._heard_s.get(_RANGE, -math.inf) > SILENCE_S:
            self._range_id = message.id
        if message.id != self._range_id:
            return  # a second one is mounted elsewhere
        self._heard_s[_RANGE] = now_s
        if (instant := self._instant("range", message, now_s)) is not None:
            bounds = self._config.range
            sample = readings.range_sample(message, instant.time_s, bounds.minimum_m, bounds.maximum_m)
            self._use("range", sample, now_s)

    def _instant(self, stream: str, message: Message, now_s: float) -> Instant | None:
        instant = self._clock.instant(stream, readings.stamp_s(message), now_s)
        if instant is None:
            self.refused[f"{stream}_stamp"] += 1
        return instant

    def _use(self, stream: str, sample: Sample | None, now_s: float) -> None:
        if sample is None:
            self.refused[f"{stream}_values"] += 1
            return
        self._used_s[stream] = now_s
        self._window_count += stream == "imu"
        self._samples.append(sample)

    # ------------------------------------------------------------ what is wrong

    def watch(self, now_s: float) -> str | None:
        """What is missing and what was expected, in one line; None when all is well. Call it at 1 Hz or so.

        A silent link is reported elsewhere: without heartbeats nothing is said here.
        """
        self._measure_rate(now_s)
        autopilot_kind = self._autopilot_kind
        if (
            autopilot_kind is None
            or not self._connected_s + PATIENCE_S <= now_s <= self._heartbeat_s + PATIENCE_S
        ):
            return None
        found = (
            self._clock_problem() or self._imu_problem(autopilot_kind, now_s) or self._others_problem(now_s)
        )
        return None if found is None else f"autopilot's sensors: {found}"

    def _measure_rate(self, now_s: float) -> None:
        elapsed_s = now_s - self._window_s
        if elapsed_s >= _WINDOW_S:
            self._imu_rate_hz = self._window_count / elapsed_s
            self._window_s, self._window_count = now_s, 0

    def _clock_problem(self) -> str | None:
        if self._clock.settled:
            return None
        return "no answer to TIMESYNC: samples have no time"

    def _imu_problem(self, autopilot_kind: AutopilotKind, now_s: float) -> str | None:
        advice = PROFILES[autopilot_kind].stream_advice
        if self._missing("imu", now_s, IMU_SILENCE_S):
            heard = [
                n
                for n in IMU_MESSAGES[autopilot_kind]
                if now_s - self._heard_s.get(n, -math.inf) < IMU_SILENCE_S
            ]
            if heard:
                return f"{_NAMES[heard[0]]} received but unusable: {self._most_refused('imu')}"
            rate_hz, name = self._config.autopilot.imu_rate_hz, _NAMES[IMU_MESSAGES[autopilot_kind][0]]
            return f"no {name} received; expected {rate_hz:g} Hz ({advice})"
        if self._imu_rate_hz < SLOWEST_IMU_HZ:
            name = _NAMES[self._imu_message or IMU_MESSAGES[autopilot_kind][0]]
            # a rate that wavers is one problem, not one a second
            rounded_hz = 5 * round(self._imu_rate_hz / 5)
            return f"{name} at about {rounded_hz} Hz; expected 50 Hz or more ({advice})"
        return None

    def _others_problem(self, now_s: float) -> str | None:
        if self._missing("mag", now_s, SILENCE_S):
            return "no magnetic field in the IMU's messages; expected the autopilot's compass"
        for number in self.rates_hz():
            if number in (_GPS, _RANGE) and now_s - self._heard_s.get(number, -math.inf) > SILENCE_S:
                what = " of a rangefinder that looks down" if number == _RANGE else ""
                return f"no {_NAMES[number]}{what} received; expected {self.rates_hz()[number]:g} Hz"
        return None

    def _missing(self, stream: str, now_s: float, timeout_s: float) -> bool:
        return now_s - self._used_s.get(stream, -math.inf) > timeout_s

    def _most_refused(self, stream: str) -> str:
        stamps, values = self.refused[f"{stream}_stamp"], self.refused[f"{stream}_values"]
        if stamps >= values:
            return "expected increasing stamps of TIMESYNC's clock"
        return "expected finite values of gyroscope and accelerometer"
