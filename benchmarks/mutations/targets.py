"""The sensors' drivers under spoilt inputs: registers and FIFO of the IMU, the lines of GPS and ultrasonic.

Each target is an endless iterator: a step gives one spoilt input to the driver, and raises what the driver
should not have raised. What comes out has to be finite.
"""

import copy
import dataclasses
import errno
import math
import random
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.mavlink.fuzzing import KINDS
from companion.base.geometry import GRAVITY_M_S2
from companion.config import (
    CONFIG_FOLDER,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    GpsConfig,
    ImuConfig,
    LinkConfig,
    RangeConfig,
    SenseConfig,
    VehicleConfig,
    load_config,
    load_model,
    read_yaml,
    validate,
)
from companion.link.codec import Codec, mavlink
from companion.link.session import Session
from companion.link.signing import LinkSigning
from companion.pad import load_pad
from companion.plan.speed.fuzzy_rules import load_rules
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.spike_filter import SpikeFilter
from companion.sense.range.ultrasonic import Ultrasonic, Us100
from sitl.devices.mpu9250 import Ak8963Device, Mpu9250Device
from sitl.devices.neo6m import nmea, ubx
from sitl.scenario.scenario import Scenario, load_airframe, load_scenario
from sitl.sensors.inertial import NO_IMU_ERRORS, ImuSensor
from sitl.sensors.sensors import MagErrors, MagSensor

STEP_S: Final = 0.01
NEW_AFTER: Final = 2000  # inputs; then the next kind of wiring or receiver, from its start
_WIRINGS: Final = (
    {"read": "fifo", "mag_path": "master"},
    {"read": "fifo", "mag_path": "bypass"},
    {"read": "registers", "poll_hz": 200, "mag_path": "master"},
    {"read": "registers", "poll_hz": 200, "mag_path": "bypass"},
)


class NotFiniteError(ArithmeticError):
    """What came out is no number, or infinite."""


def check_finite(*values: float) -> None:
    """Raise NotFiniteError unless all are finite."""
    if not all(map(math.isfinite, values)):
        raise NotFiniteError(f"{values}")


class SpoiltBus:
    """A chip behind a bus that garbles every `one_in`-th read, and fails now and then."""

    def __init__(self, device: Mpu9250Device, rng: random.Random) -> None:
        self._device, self._rng = device, rng
        self.one_in = 3
        self.spoilt = 0

    def read(self, address: int, register: int, length: int) -> bytes:
        """As many bytes as were asked for, of whatever kind."""
        data, rng = self._device.read(address, register, length), self._rng
        if rng.randrange(self.one_in):
            return data
        self.spoilt += 1
        kind = rng.randrange(6)
        if kind == 0:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        if kind == 1:
            return bytes((rng.choice((0x00, 0xFF)),)) * length
        if kind == 2:
            return rng.randbytes(length)
        return spoiled(rng, data)[:length].ljust(length, b"\xff")

    def write(self, address: int, register: int, value: int) -> None:
        """Write, or not."""
        if not self._rng.randrange(50):
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        self._device.write(address, register, value)


def imu(rng: random.Random) -> Iterator[None]:
    """The MPU9250 and its magnetometer over each wiring."""
    while True:
        for wiring in _WIRINGS:
            config = ImuConfig.model_validate(wiring)
            noise = np.random.default_rng(rng.randrange(2**32))
            sensor = ImuSensor(NO_IMU_ERRORS, noise, STEP_S, np.eye(3))
            device = Mpu9250Device(sensor, Ak8963Device(MagSensor(MagErrors(), noise, np.eye(3))))
            bus = SpoiltBus(device, rng)
            yield from _imu(device, Mpu9250(bus, config), bus, rng)


def _imu(device: Mpu9250Device, driver: Mpu9250, bus: SpoiltBus, rng: random.Random) -> Iterator[None]:
    now_s, spoilt = 0.0, 0
    rest = (0.0, 0.0, -GRAVITY_M_S2)
    for _ in range(20 * NEW_AFTER):
        now_s += STEP_S
        bus.one_in = 3 if driver.ready else 30  # else it would never come up
        device.step(now_s, rest, (0.0, 0.0, 0.0), (20.9, 0.6, 42.9), 0.0)
        try:
            samples, fields = driver.poll(partial(float, now_s))
        except SensorError:
            samples, fields = [], []
        for sample in samples:
            check_finite(sample.time_s, *sample.rate_body_rad_s, *sample.specific_force_body_m_s2)
        for field in fields:
            check_finite(field.time_s, *field.field_body_ut)
        for _ in range(bus.spoilt - spoilt):
            yield
        spoilt = bus.spoilt
        if spoilt >= NEW_AFTER:
            return


# ---------------------------------------------------------------- GPS


def _gps_messages(rng: random.Random, k: int) -> list[bytes]:
    """One epoch as UBX and as NMEA, and an acknowledgement."""
    week_ms = (1000 * k + rng.randrange(3)) % 604_800_000
    head = week_ms.to_bytes(4, "little")
    time = f"{k // 3600 % 24:02d}{k // 60 % 60:02d}{k % 60:02d}.00"
    return [
        ubx(0x01, 0x02, head + rng.randbytes(24)),
        ubx(0x01, 0x03, head + bytes((3, 0xDD)) + bytes(10)),
        ubx(0x01, 0x04, head + rng.randbytes(14)),
        ubx(0x01, 0x06, head + bytes(4) + b"\x00\x00\x03\xdd" + rng.randbytes(40)),
        ubx(0x01, 0x12, head + rng.randbytes(32)),
        ubx(0x05, rng.randrange(2), bytes((6, rng.randrange(64)))),
        nmea(f"GPRMC,{time},A,4724.00000,N,00832.00000,E,0.5,120.0,011123,,,A"),
        nmea(f"GPGGA,{time},4724.00000,N,00832.00000,E,1,08,1.0,400.0,M,48.0,M,,"),
        nmea("GPGSA,A,3,01,02,03,04,05,06,07,08,,,,,1.8,1.0,1.5"),
    ]


def _again_whole(rng: random.Random, message: bytes) -> bytes:
    """A message with its content spoilt, and a check sum that fits."""
    if message[:1] == b"$":
        fields = message[1 : message.index(b"*")].split(b",")
        at = rng.randrange(len(fields))
        match rng.randrange(4):
            case 0:
                del fields[at:]
            case 1:
                odd = (b"", b"inf", b"nan", b"-1", b"9" * 40, b"1e400", b"A", b"\x00", b"240000.00", b"99")
                fields[at] = rng.choice(odd)
            case 2:
                fields[at] = spoiled(rng, fields[at])
            case _:
                fields.insert(at, fields[at])
        body = b",".join(fields)
        total = 0
        for value in body:
            total ^= value
        return b"$" + body + b"*%02X\r\n" % total
    payload = message[6:-2]
    return ubx(message[2], message[3], spoiled(rng, payload)[: rng.choice((len(payload), 255))])


def gps(rng: random.Random) -> Iterator[None]:
    """UBX and NMEA, spoilt on the line or by the receiver itself, in pieces of any length."""
    while True:
        kinds = rng.choice((range(6), range(6, 9), range(9)))
        receiver, now_s, k = Neo6m(GpsConfig()), 0.0, 0
        while k < NEW_AFTER:
            messages = _gps_messages(rng, k)
            stream = b""
            for kind in kinds:
                spoil = rng.random() < 0.3
                k += spoil
                message = messages[kind]
                if spoil:
                    message = (_again_whole if rng.random() < 0.7 else spoiled)(rng, message)
                stream += message
                if spoil:
                    yield
            while stream:
                size = rng.randint(1, 80)
                now_s += size / 960.0
                _take_fixes(receiver, stream[:size], now_s)
                stream = stream[size:]
            receiver.pending(now_s)


def _take_fixes(receiver: Neo6m, data: bytes, now_s: float) -> None:
    for fix in receiver.feed(data, now_s):
        check_finite(fix.time_s, fix.latitude_deg, fix.longitude_deg, fix.altitude_m, *fix.velocity_ned_m_s)


# ---------------------------------------------------------------- ultrasonic


def ultrasonic(rng: random.Random) -> Iterator[None]:
    """Both protocols, and the gate behind them."""
    while True:
        config = RangeConfig()
        drivers: tuple[Any, ...] = (Ultrasonic(config), Us100(config))
        gate, now_s = SpikeFilter(config), 0.0
        for _ in range(NEW_AFTER):
            now_s += rng.choice((0.0, 0.001, 0.05, 1.0))
            high, low = rng.randrange(20), rng.randrange(256)
            frame = bytes((0xFF, high, low, (0xFF + high + low) & 0xFF))
            for driver, data in zip(drivers, (frame, frame[1:3]), strict=True):
                driver.pending(now_s)
                for sample in driver.feed(spoiled(rng, data), now_s):
                    check_finite(sample.time_s, sample.distance_m)
                    gate.step(sample)
                driver.watch(now_s)
            yield


# ---------------------------------------------------------------- mutating
# Ways to spoil bytes, text and trees of settings; all from the generator that is handed in.

_BYTES: Final = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)
_LONGEST_REPEAT: Final = 40
_HUGE: Final = 1e300
# what a person, an editor or a disk makes of a settings file
_WORDS: Final = (
    *("nan", ".nan", ".inf", "-.inf", "1e400", "-1", "0", "1e-320", "true", "no", "~", "null", "''"),
    *("[]", "{}", "[1, 2]", "{a: 1}", "- x", "!!python/object:os.system {}", "&a [*a]", "&b {b: *b}"),
    *("2026-01-01", "0x1F", "1_000", "12:30:45", "9" * 60, "\t", ": ", "\n", "\x00", "\ufeff", "\u2028", "é"),
    *("? [a, b]", "!!binary x", "!!set {a}", "<<: 1", "---\n", "...\n", "%YAML 3.0\n", "@", "`", "|", ">"),
)
_VALUES: Final[tuple[Any, ...]] = (
    *(None, True, False, 0, -1, 1, 1e308, -1e308, float("nan"), float("inf"), 10**400, "", "x", "nan", "1"),
    *([], {}, [1], [[1]], {"a": 1}, [None] * 4, "é\x00", b"x", (1, 2), {1: 2}, {None: 1}, [{}], "x" * 300),
)


def spoiled(rng: random.Random, data: bytes) -> bytes:
    """Bytes with one to four changes: bits, bytes, pieces lost, doubled, put in or cut off."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        _BYTE_CHANGES[rng.randrange(len(_BYTE_CHANGES))](rng, out)
    return bytes(out)


def _flip(rng: random.Random, out: bytearray) -> None:
    if out:
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)


def _set(rng: random.Random, out: bytearray) -> None:
    if out:
        out[rng.randrange(len(out))] = rng.choice(_BYTES)


def _cut(rng: random.Random, out: bytearray) -> None:
    start, end = _piece(rng, out)
    del out[start:end]


def _double(rng: random.Random, out: bytearray) -> None:
    start, end = _piece(rng, out)
    out[start:start] = out[start:end]


def _insert(rng: random.Random, out: bytearray) -> None:
    at = rng.randint(0, len(out))
    out[at:at] = rng.randbytes(rng.randint(1, 20))


def _repeat(rng: random.Random, out: bytearray) -> None:
    at = rng.randint(0, len(out))
    out[at:at] = bytes((rng.choice(_BYTES),)) * rng.randint(1, _LONGEST_REPEAT)


def _truncate(rng: random.Random, out: bytearray) -> None:
    del out[rng.randint(0, len(out)) :]


def _piece(rng: random.Random, out: bytearray) -> tuple[int, int]:
    start = rng.randint(0, len(out))
    return start, min(len(out), start + rng.randint(1, 20))


_BYTE_CHANGES: Final[tuple[Callable[[random.Random, bytearray], None], ...]] = (
    *(_flip, _flip, _set, _set, _cut, _double, _insert, _repeat, _truncate),
)


def spoiled_text(rng: random.Random, text: str) -> bytes:
    """A settings file's text with words and lines changed; now and then bytes that are no text."""
    if rng.random() < 0.2:
        return spoiled(rng, text.encode())
    lines = text.split("\n")
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(lines))
        match rng.randrange(6):
            case 0:
                lines.insert(at, lines[rng.randrange(len(lines))])
            case 1 if len(lines) > 1:
                del lines[at]
            case 2:
                lines[at] = " " * rng.randint(0, 6) + lines[at].strip()
            case 3:
                lines[at] = lines[at].partition(":")[0] + ": " + rng.choice(_WORDS)
            case 4:
                cut = rng.randint(0, len(lines[at]))
                lines[at] = lines[at][:cut] + rng.choice(_WORDS) + lines[at][cut:]
            case _:
                lines[at] = rng.choice(_WORDS)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def spoiled_tree(rng: random.Random, tree: Any) -> Any:
    """A tree of settings with one to three of its values or keys others."""
    spoilt = copy.deepcopy(tree)
    for _ in range(rng.randint(1, 3)):
        holder, key = _place(rng, spoilt)
        if holder is None:
            return rng.choice(_VALUES)
        match rng.randrange(4):
            case 0 if isinstance(holder, dict):
                holder[rng.choice(("x", "", 1, None, True, 1.5, (1, 2)))] = holder.pop(key)
            case 1:
                holder[key] = [copy.deepcopy(holder[key])] * rng.randint(0, 3)
            case 2 if isinstance(holder[key], int | float) and abs(holder[key]) < _HUGE:
                holder[key] = holder[key] * rng.choice((-1, 0, 10, 1e6, 1e-6, 0.5, 2))
            case _:
                holder[key] = copy.deepcopy(rng.choice(_VALUES))
    return spoilt


def _place(rng: random.Random, tree: Any) -> tuple[Any, Any]:
    """A value somewhere in a tree: what holds it, and under which key."""
    holder, key, here = None, None, tree
    while isinstance(here, dict | list) and here and (holder is None or rng.random() < 0.7):
        holder = here
        key = rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
        here = here[key]
    return holder, key


# ---------------------------------------------------------------- files
# Settings and scenario files, spoilt as text and as trees: each loads, or ends in one line.

_LONGEST_LINE: Final = 1500  # all kinds of fault by name are 1200
Loader = Callable[[Path], Any]
_LOADERS: Final[tuple[tuple[str, Loader], ...]] = (
    ("companion.yaml", load_config),
    ("scenarios/*.yaml", load_scenario),
    ("vehicles/*.yaml", lambda path: load_model(VehicleConfig, path)),
    ("cameras/*.yaml", lambda path: load_model(CameraConfig, path)),
    ("pads/*.yaml", load_pad),
    ("fuzzy/*.yaml", load_rules),
    ("airframes/*.yaml", load_airframe),
)


def texts(rng: random.Random) -> Iterator[None]:
    """Every shipped file with its text spoilt."""
    files = [(path, load) for pattern, load in _LOADERS for path in sorted(CONFIG_FOLDER.glob(pattern))]
    read = [(path.read_text(encoding="utf-8"), load) for path, load in files]
    with tempfile.TemporaryDirectory(prefix="bench-mutations-") as folder:
        path = Path(folder) / "spoilt.yaml"
        while True:
            text, load = rng.choice(read)
            path.write_bytes(spoiled_text(rng, text))
            _load(partial(load, path))
            yield


def trees(rng: random.Random) -> Iterator[None]:
    """Settings and scenarios with every value written out, some of them others."""
    whole = CompanionConfig().model_dump(mode="json")
    plain = [(CompanionConfig, whole), (CompanionConfig, read_yaml(CONFIG_FOLDER / "companion.yaml"))]
    models: list[tuple[type[Any], dict[str, Any]]] = [*plain]
    for path in sorted((CONFIG_FOLDER / "scenarios").glob("*.yaml")):
        models.append((Scenario, read_yaml(path)))
        models.append((Scenario, load_scenario(path).model_dump(mode="json", by_alias=True)))
    while True:
        model, tree = rng.choice(models)
        spoilt = spoiled_tree(rng, tree)
        _load(partial(validate, model, spoilt, "spoilt.yaml"))
        yield


def _load(load: Callable[[], Any]) -> None:
    try:
        load()
    except ConfigError as error:
        words = str(error)
        assert "\n" not in words, f"more than one line: {words!r}"
        assert len(words) <= _LONGEST_LINE, f"{len(words)} characters: {words[:200]!r}"


# ---------------------------------------------------------------- link
# The app's end of the link under spoilt MAVLink: of an autopilot, a ground station, a stranger.

_LEVEL: Final = [1.0, 0.0, 0.0, 0.0]
_TEXT: Final = b"a text that fills one message and goes on in others"[:50]
_CUT: Final = 300  # bytes that come at once, at most


def _telemetry(now_s: float, kind: str) -> list[Any]:
    """Legal messages of every kind that the session hears."""
    ms, us = int(now_s * 1000.0), int(now_s * 1e6)
    autopilot = mavlink.MAV_AUTOPILOT_PX4 if kind == "px4" else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    return [
        mavlink.MAVLink_heartbeat_message(2, autopilot, 217, 0x00060000, 4, 3),
        mavlink.MAVLink_sys_status_message(1 << 28, 1 << 28, 1 << 28, 0, 12000, 100, 80, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_extended_sys_state_message(0, 2),
        mavlink.MAVLink_attitude_message(ms, 0.1, 0.1, 1.0, 0.0, 0.0, 0.0),
        mavlink.MAVLink_attitude_quaternion_message(ms, *_LEVEL, 0.0, 0.0, 0.0),
        mavlink.MAVLink_local_position_ned_message(ms, 0.0, 0.0, -5.0, 0.1, 0.1, 0.1),
        mavlink.MAVLink_global_position_int_message(ms, 470000000, 80000000, 400000, 5000, 0, 0, 0, 0),
        mavlink.MAVLink_home_position_message(
            470000000, 80000000, 400000, 0.0, 0.0, 0.0, _LEVEL, 0.0, 0.0, 0.0
        ),
        mavlink.MAVLink_ekf_status_report_message(0x33F, 0.1, 0.1, 0.1, 0.1, 0.1),
        mavlink.MAVLink_statustext_message(4, _TEXT, 7, 0),
        mavlink.MAVLink_command_ack_message(400, 0, 0, 0, 1, 191),
        mavlink.MAVLink_timesync_message(us * 1000, us * 1000),
        mavlink.MAVLink_timesync_message(0, us * 1000),
        mavlink.MAVLink_param_value_message(b"MPC_XY_CRUISE", 5.0, 9, 900, 3),
        mavlink.MAVLink_highres_imu_message(
            us, 0.1, 0.1, -9.8, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 960.0, 0.0, 400.0, 30.0, 0xFFFF
        ),
        mavlink.MAVLink_raw_imu_message(us, 10, 10, -1000, 1, 1, 1, 200, 0, 400),
        mavlink.MAVLink_scaled_imu_message(ms, 10, 10, -1000, 1, 1, 1, 200, 0, 400),
        mavlink.MAVLink_gps_raw_int_message(
            us, 3, 470000000, 80000000, 400000, 100, 100, 50, 18000, 12, 400000, 1000, 1000, 100
        ),
        mavlink.MAVLink_distance_sensor_message(ms, 5, 800, 120, 0, 0, 25, 0),
        mavlink.MAVLink_follow_target_message(
            ms, 3, 470000000, 80000000, 400.0, [0.0] * 3, [0.0] * 3, _LEVEL, [0.0] * 3, [1.0] * 3, 0
        ),
    ]  # fmt: skip


def link(rng: random.Random) -> Iterator[None]:
    """Sessions of each make, with and without sensors by telemetry and a key."""
    noise = np.random.default_rng(rng.randrange(2**32))
    while True:
        for kind in ("px4", "ardupilot"):
            for secret in (None, bytes(32)):
                sense = None if rng.random() < 0.5 else SenseConfig()
                signing = None if secret is None else LinkSigning(secret, 1)
                session = Session(LinkConfig(), sense, reads_setup=True, signing=signing)
                yield from _session(session, kind, secret, rng, noise)


def _session(
    session: Session, kind: str, secret: bytes | None, rng: random.Random, noise: np.random.Generator
) -> Iterator[None]:
    senders = (Codec(1, 1), Codec(1, 1), Codec(1, 100), Codec(255, 190), Codec(2, 1))
    if secret is not None:
        senders[0].sign(LinkSigning(secret, 1))
    now_s, line = 100.0, b""
    for _ in range(NEW_AFTER):
        now_s += rng.choice((0.001, 0.01, 0.05, 0.5))
        frame = rng.choice(senders).encode(rng.choice(_telemetry(now_s, kind)))
        line += frame if rng.random() < 0.2 else KINDS[rng.randrange(len(KINDS))](noise, frame)
        while line and (len(line) > _CUT or rng.random() < 0.8):
            size = rng.randint(1, _CUT)
            session.receive(line[:size], now_s)
            line = line[size:]
        session.tick(now_s)
        session.take_samples()
        _check(session)
        yield


def _check(session: Session) -> None:
    """What the app would fly by is finite, and within its own bounds."""
    state = session.state
    for item in dataclasses.fields(state):
        value = getattr(state, item.name)
        if isinstance(value, tuple) and value and isinstance(value[0], float):
            check_finite(*value)
    share = state.battery_share
    assert share is None or 0.0 <= share <= 1.0, f"battery_share {share}"
    beacon = session.beacons.beacon
    if beacon is not None:
        check_finite(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, *beacon.velocity_ned_m_s)
    assert len(state.texts) < 100, f"{len(state.texts)} texts are kept"
