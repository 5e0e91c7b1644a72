"""The autopilot's own IMU, magnetometer, GPS and rangefinder as our sensors, by its telemetry. Pure.

Each sample carries the instant of its measurement (`timesync`, less the settings' latencies), whatever
the link's delay. Of the messages that may carry the IMU the best one that comes is taken, in the order of
`IMU_MESSAGES`; a lesser one only while the better ones are silent. `watch` says in one line what is missing.

Axes: the autopilot's body axes, FRD; it has turned its boards' mounting out already. What is not finite,
saturated, empty or marked invalid gives no sample. Units by message:

    HIGHRES_IMU          m/s², rad/s, gauss; `fields_updated` says what is new in this message
    RAW_IMU, SCALED_IMU  milli-g, mrad/s, milligauss: as MAVLink has it for SCALED_IMU; ArduPilot's RAW_IMU
                         holds the same (GCS_Common.cpp, send_raw_imu), another autopilot's may be counts
    GPS_RAW_INT          1e-7 deg, mm over the mean sea, cm/s over ground and its course in 1e-2 deg: there
                         is no vertical speed in it
    DISTANCE_SENSOR      cm, along the sensor's axis

ArduPilot's HIGHRES_IMU has its field in thousandths of what the message says (4.6: 231687 "gauss" are
231.7 mG, in the recording as in the source): a field that is no planet's is read as that.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, scale
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import RangeConfig, SenseConfig
from companion.link.codec import Message, mavlink, message_number
from companion.link.timesync import BootClock, Instant

# ---------------------------------------------------------------- messages to samples

UNKNOWN_SPEED_M_S: Final = 50.0  # accuracy of what a fix does not report
_MILLI_G: Final = 1e-3 * GRAVITY_M_S2
_GAUSS_UT: Final = 100.0
_MILLIGAUSS_UT: Final = 0.1
_MICROGAUSS_UT: Final = 1e-4
_STRONGEST_GAUSS: Final = 100.0  # the earth's is 0.65 at most, a field in microgauss 200000 at least
_WEAKEST_UT: Final = 5.0  # a compass that is missing reads 0
_SATURATED: Final = 32767
_RATE_BITS, _FORCE_BITS, _FIELD_BITS = 0b111_000, 0b111, 0b111_000_000
_TEMPERATURE_BIT: Final = 1 << 12
_UNKNOWN_U8, _UNKNOWN_U16 = 0xFF, 0xFFFF
_RANGE_ERROR_M: Final = 2.5  # of a receiver that reports its dilution alone
_DEFAULT_DILUTION: Final = 4.0
_DEFAULT_SPEED_ACCURACY_M_S: Final = 0.5
_SIGNAL_INVALID: Final = 1  # 0 is "unknown": PX4's simulator and older autopilots never fill it in
_LARGEST_VARIANCE_CM2: Final = 36  # MAVLink: a standard deviation of 6 cm at most


def stamp_s(message: Message) -> float:
    """When the autopilot says it measured, s since its boot."""
    microseconds = getattr(message, "time_usec", None)
    return float(message.time_boot_ms * 1e-3 if microseconds is None else microseconds * 1e-6)


def imu_sample(message: Message, time_s: float, interval_s: float | None = None) -> ImuSample | None:
    """Gyroscope and accelerometer of HIGHRES_IMU, RAW_IMU or SCALED_IMU, measured at time_s.

    `interval_s` after the sample before, by the autopilot's clock.
    """
    if not _is_the_first(message):
        return None
    rate = (float(message.xgyro), float(message.ygyro), float(message.zgyro))
    force = (float(message.xacc), float(message.yacc), float(message.zacc))
    if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU:
        fields = message.fields_updated
        fresh = fields & _RATE_BITS == _RATE_BITS and fields & _FORCE_BITS == _FORCE_BITS
        if not fresh or not _finite(rate + force):
            return None
        has_temperature = fields & _TEMPERATURE_BIT and math.isfinite(message.temperature)
        return ImuSample(
            time_s, rate, force, float(message.temperature) if has_temperature else 0.0, interval_s
        )
    if max(map(abs, rate + force)) >= _SATURATED:
        return None
    return ImuSample(
        time_s, scale(rate, 1e-3), scale(force, _MILLI_G), message.temperature * 0.01, interval_s
    )


def mag_sample(message: Message, time_s: float) -> MagSample | None:
    """Magnetometer of HIGHRES_IMU (if its bits are set), RAW_IMU or SCALED_IMU, measured at time_s."""
    highres = message.get_msgId() == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
    if highres and message.fields_updated & _FIELD_BITS != _FIELD_BITS:
        return None
    field = (float(message.xmag), float(message.ymag), float(message.zmag))
    if not _is_the_first(message) or not _finite(field):
        return None
    largest, unit_ut = max(map(abs, field)), _MILLIGAUSS_UT
    if highres:
        unit_ut = _GAUSS_UT if largest < _STRONGEST_GAUSS else _MICROGAUSS_UT
    elif largest >= _SATURATED:
        return None
    if largest * unit_ut < _WEAKEST_UT:
        return None
    return MagSample(time_s, scale(field, unit_ut))


def gps_fix(message: Message, time_s: float) -> GpsFix | None:
    """GPS_RAW_INT of a fix in three dimensions, valid at time_s."""
    if message.fix_type < mavlink.GPS_FIX_TYPE_3D_FIX or (message.lat == 0 and message.lon == 0):
        return None
    velocity, speed_accuracy = _velocity(message)
    return GpsFix(
        time_s=time_s,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.alt * 1e-3,
        velocity_ned_m_s=velocity,
        horizontal_accuracy_m=_accuracy_m(message.h_acc, message.eph),
        vertical_accuracy_m=_accuracy_m(message.v_acc, message.epv),
        speed_accuracy_m_s=speed_accuracy,
        satellites=0 if message.satellites_visible == _UNKNOWN_U8 else message.satellites_visible,
        vertical_speed_accuracy_m_s=UNKNOWN_SPEED_M_S,
    )


def range_sample(message: Message, time_s: float, bounds: RangeConfig) -> RangeSample | None:
    """DISTANCE_SENSOR that looks down, within the sensor's own bounds and those given.

    At `min_distance` it may be nearer: many sensors report that for anything nearer.
    """
    distance_cm, distance_m = message.current_distance, message.current_distance * 0.01
    refused = (
        not looks_down(message),
        message.signal_quality == _SIGNAL_INVALID,
        _LARGEST_VARIANCE_CM2 < message.covariance < _UNKNOWN_U8,
        not message.min_distance < distance_cm <= message.max_distance,
        not bounds.measures(distance_m),
    )
    return None if any(refused) else RangeSample(time_s, distance_m)


def looks_down(message: Message) -> bool:
    """Whether a DISTANCE_SENSOR points at the ground."""
    return bool(message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270)


def _is_the_first(message: Message) -> bool:
    """Whether it is of the autopilot's first IMU; SCALED_IMU does (its `id` is pymavlink's, no field)."""
    return bool(message.get_msgId() == mavlink.MAVLINK_MSG_ID_SCALED_IMU or message.id == 0)


def _velocity(message: Message) -> tuple[Vector3, float]:
    """Velocity over ground (NED, down as 0) and its accuracy; without a course it may point anywhere."""
    if message.vel == _UNKNOWN_U16:
        return ZERO3, UNKNOWN_SPEED_M_S
    speed, given = message.vel * 0.01, message.vel_acc * 1e-3
    accuracy = given if given > 0.0 else _DEFAULT_SPEED_ACCURACY_M_S
    if message.cog == _UNKNOWN_U16:
        return ZERO3, accuracy if speed <= accuracy else UNKNOWN_SPEED_M_S
    course = math.radians(message.cog * 0.01)
    return (speed * math.cos(course), speed * math.sin(course), 0.0), accuracy


def _accuracy_m(reported_mm: int, dilution_e2: int) -> float:
    """What the receiver says, else what its dilution of precision makes of a usual range error."""
    if reported_mm > 0:
        return reported_mm * 1e-3
    dilution = _DEFAULT_DILUTION if dilution_e2 in (0, _UNKNOWN_U16) else dilution_e2 * 0.01
    return _RANGE_ERROR_M * dilution


def _finite(values: Iterable[float]) -> bool:
    return all(map(math.isfinite, values))


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
            self._climbs.append((stamp_s(message), message.vz))
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
        sample = imu_sample(message, time_s, self._since_used_s(instant))
        if sample is not None:
            self._unused_s = 0.0
        self._use("imu", sample, now_s)
        if (field := mag_sample(message, time_s)) is not None:
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
            fix = gps_fix(message, instant.time_s - latency_s)
            if fix is not None:
                fix = self._with_climb(fix, stamp_s(message) - latency_s)
            self._use("gps", fix, now_s)

    def _hear_range(self, message: Message, now_s: float) -> None:
        if not (self._config.range_by_telemetry and looks_down(message)):
            return
        if self._range_id is None or now_s - self._heard_s.get(_RANGE, -math.inf) > SILENCE_S:
            self._range_id = message.id
        if message.id != self._range_id:
            return  # a second one is mounted elsewhere
        self._heard_s[_RANGE] = now_s
        if (instant := self._instant("range", message, now_s)) is not None:
            self._use("range", range_sample(message, instant.time_s, self._config.range), now_s)

    def _instant(self, stream: str, message: Message, now_s: float) -> Instant | None:
        instant = self._clock.instant(stream, stamp_s(message), now_s)
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
