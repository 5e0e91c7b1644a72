"""Packed messages of an autopilot's sensors, and a TelemetrySensors whose clock has settled."""

import math
from typing import Any

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import AutopilotSensorsConfig, SenseConfig
from companion.link.codec import Codec, Message, mavlink
from companion.link.telemetry.autopilot_sensors import TelemetrySensors
from companion.link.timesync import BootClock, TimeSync

OFFSET_S = 50.0  # the autopilot's clock is ahead of ours by this
START_S = 100.0


def packed(message: Message) -> Message:
    """The message as it comes over the line: in the types and trimmed zeros of MAVLink 2."""
    [received] = Codec(1).decode(Codec(1, 1).encode(message))
    return received


def highres(boot_s: float, **changes: Any) -> Message:
    """HIGHRES_IMU at rest and level."""
    fields = {
        "xacc": 0.0, "yacc": 0.0, "zacc": -9.8, "xgyro": 0.0, "ygyro": 0.0, "zgyro": 0.0,
        "xmag": 0.209, "ymag": 0.006, "zmag": 0.429, "abs_pressure": 965.0, "diff_pressure": 0.0,
        "pressure_alt": 0.0, "temperature": 31.0, "fields_updated": 0b1_0001_1111_1111, "id": 0,
    }  # fmt: skip
    return packed(mavlink.MAVLink_highres_imu_message(round(boot_s * 1e6), **{**fields, **changes}))


def raw(boot_s: float, *values: int, identity: int = 0) -> Message:
    """RAW_IMU; by default at rest and level."""
    nine = values or (0, 0, -1000, 0, 0, 0, 209, 6, 429)
    return packed(mavlink.MAVLink_raw_imu_message(round(boot_s * 1e6), *nine, identity, 3100))


def scaled(boot_s: float, *values: int) -> Message:
    """SCALED_IMU; by default at rest and level."""
    nine = values or (0, 0, -1000, 0, 0, 0, 209, 6, 429)
    return packed(mavlink.MAVLink_scaled_imu_message(round(boot_s * 1e3) % 2**32, *nine, 3100))


def gps(boot_s: float, **changes: Any) -> Message:
    """GPS_RAW_INT of a fix."""
    fields = {
        "fix_type": 3, "lat": 470000000, "lon": 80000000, "alt": 400_000, "eph": 100, "epv": 170, "vel": 0,
        "cog": 0, "satellites_visible": 9, "h_acc": 2500, "v_acc": 3800, "vel_acc": 300,
    }  # fmt: skip
    return packed(mavlink.MAVLink_gps_raw_int_message(round(boot_s * 1e6), **{**fields, **changes}))


def distance(boot_s: float, **changes: Any) -> Message:
    """DISTANCE_SENSOR that looks down at 1.50 m."""
    fields = {
        "min_distance": 20, "max_distance": 400, "current_distance": 150, "type": 1, "id": 0,
        "orientation": 25, "covariance": 0, "signal_quality": 0,
    }  # fmt: skip
    return packed(
        mavlink.MAVLink_distance_sensor_message(round(boot_s * 1e3) % 2**32, **{**fields, **changes})
    )


class ReadAutopilot:
    """OnboardSensors of an autopilot; `now_s` is our clock."""

    def __init__(self, autopilot_kind: AutopilotKind = "px4", settled: bool = True, **settings: Any) -> None:
        self.now_s = START_S
        self.timesync = TimeSync()
        exact = {"imu_latency_s": 0.0, "gps_latency_s": 0.0}
        config = SenseConfig(source="autopilot", autopilot=AutopilotSensorsConfig(**{**exact, **settings}))
        self.sensors = TelemetrySensors(config, BootClock(self.timesync))
        self.offset_s = OFFSET_S
        if settled:
            self.synchronise()
        self.sensors.heartbeat(autopilot_kind, self.now_s)

    def synchronise(self, answers: int = 10, trip_s: float = 0.004) -> None:
        """Have TIMESYNC answered so many times."""
        for _ in range(answers):
            asked_s = self.now_s
            self.now_s += trip_s
            tc1_ns = round((asked_s + 0.5 * trip_s + self.offset_s) * 1e9)
            self.timesync.answered(tc1_ns, self.timesync.ask(asked_s), self.now_s)

    @property
    def boot_s(self) -> float:
        """The autopilot's clock now."""
        return self.now_s + self.offset_s

    def hear(self, *messages: Message) -> list[ImuSample | MagSample | GpsFix | RangeSample]:
        """Have messages arrive now; what is made of them."""
        for message in messages:
            self.sensors.hear(message, self.now_s)
        return self.sensors.take()

    def imu(self, *messages: Message) -> list[ImuSample]:
        """The IMU samples among what is made of messages."""
        return [sample for sample in self.hear(*messages) if isinstance(sample, ImuSample)]

    def run(self, duration_s: float, message: Any, rate_hz: float = 100.0) -> None:
        """A stream of `message(boot_s)` and heartbeats."""
        for step in range(round(duration_s * rate_hz)):
            self.now_s += 1.0 / rate_hz
            if step % math.ceil(rate_hz) == 0:
                self.sensors.heartbeat("px4" if message is highres else "ardupilot", self.now_s)
            self.sensors.hear(message(self.boot_s), self.now_s)
            self.sensors.watch(self.now_s)
