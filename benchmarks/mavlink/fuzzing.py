"""Wrong MAVLink by the million, and a legal stream in between that has to get through.

A flown vehicle has three clients: one sends over UDP (a datagram a frame), one over TCP (the bytes cut
anywhere), one only listens. The two send garbage, and every so often a command and a TIMESYNC whose answers
are known. Everything comes from one seed. Garbage bears other names than the legal stream's. `orders`: most
of it is legal in form, and slower, so that the vehicle does something about it (`fuzz_orders`).
"""

import math
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.link.codec import mavlink
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.commands import FORCE_MAGIC, HANDLERS, LINK_HANDLERS
from sitl.mavlink.framing import FrameReader, Signing
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.network import VEHICLE, Network, Port
from sitl.scenario.scenario import BeaconSettings
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight

# ---------------------------------------------------------------- fuzz orders
# Orders that hang together and make no sense: what a vehicle may be told, in legal frames, with wild values.
#
# Missions half uploaded, jumps without end, homes upon homes, places and headings that are no numbers,
# sticks, landing targets, parameters; now and then an order to arm and fly, so that all of it meets a vehicle
# in the air. Legal frames reach the handlers that garbage hardly ever gets to.


# ---------------------------------------------------------------- garbage
# Wrong MAVLink of many kinds, made from legal messages: one function a kind.


LEGAL_EVERY: Final = 20  # one frame in so many
FRAMES_PER_TICK: Final = 20
ORDERS_PER_TICK: Final = 2
ORDERS_SHARE: Final = 0.8
TICK_S: Final = 0.01
LEGAL_SYSTEM: Final = 250


@dataclass
class FuzzingClient:
    """One client: what it has sent that is legal, and which answers have come."""

    packer: Any
    port: Port | None = None
    heard: bytearray = field(default_factory=bytearray)
    commands_sent: int = 0
    commands_answered: int = 0
    times_asked: set[int] = field(default_factory=set)
    times_told: set[int] = field(default_factory=set)
    heartbeats: int = 0

    def __post_init__(self) -> None:
        self._reader = FrameReader()

    def write(self, frames: Sequence[bytes]) -> None:
        """What the vehicle sends."""
        for frame in frames:
            self.heard += frame

    def listen(self) -> None:
        """Read what has come, from the vehicle alone."""
        for frame in self._reader.read(bytes(self.heard), 0.0):
            if (frame.system, frame.component) != VEHICLE:
                continue
            message = self.packer.decode(bytearray(frame.data))
            kind = message.get_type()
            if kind == "HEARTBEAT":
                self.heartbeats += 1
            elif kind == "TIMESYNC":
                self.times_told.add(message.ts1)
            elif kind == "COMMAND_ACK" and message.target_system == LEGAL_SYSTEM:
                mine = message.target_component == self.packer.srcComponent
                self.commands_answered += mine and message.command == mavlink.MAV_CMD_REQUEST_MESSAGE
        self.heard.clear()


@dataclass(frozen=True)
class FuzzResult:
    """What came of a run; lists are of the UDP and the TCP client."""

    kinds: Counter[str]
    flown_s: float
    commands: tuple[tuple[int, int], ...]  # sent, answered
    times: tuple[tuple[int, int], ...]  # asked, told
    heartbeats: int
    finite: bool
    refused: int

    @property
    def lost(self) -> int:
        """Legal frames without their answer."""
        return sum(sent - answered for sent, answered in (*self.commands, *self.times))

    @property
    def holds(self) -> bool:
        """Nothing legal lost, nothing answered twice, a heartbeat every second, a state of numbers."""
        exact = all(sent == answered for sent, answered in (*self.commands, *self.times))
        return exact and abs(self.heartbeats - self.flown_s) <= 1.5 and self.finite


class Fuzz:
    """A vehicle in flight under fire."""

    def __init__(
        self, autopilot_kind: AutopilotKind, seed: int, key: bytes | None = None, *, orders: bool = False
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.flight = AutopilotFlight(autopilot_kind)
        self.flight.take_off()
        self.flight.take_control()
        self.signing = Signing(autopilot_kind, key)
        sensors = SimulatedAutopilotSensors(
            np.random.default_rng(seed), TICK_S, home=HOME, field_ned_ut=(20.9, 0.6, 42.9), imu_filter=4
        )
        ground_station = GroundStation(
            BeaconSettings(position_std_m=1.0), np.random.default_rng(seed), HOME, signing=self.signing
        )
        self.network = Network(self.flight.autopilot, sensors, ground_station, self.signing, 1.7e9)
        self.udp, self.tcp, self.quiet = (self._client(n, key) for n in (1, 2, 3))
        self.udp.port = self.network.connect(self.udp.write, datagrams=True)
        self.tcp.port = self.network.connect(self.tcp.write, datagrams=False)
        self.network.connect(self.quiet.write, datagrams=True)
        self._stream = bytearray()
        self._overdue = 0  # bytes of it that were there at the last tick
        self._packer = mavlink.MAVLink(None, srcSystem=GARBAGE_SYSTEM, srcComponent=7)
        # whom ArduPilot lets fly by hand
        self._pilot = mavlink.MAVLink(None, srcSystem=255, srcComponent=7)
        self._templates = [bytes(message.pack(self._packer)) for message in templates()]
        self._orders = Orders(self.rng, self.flight.autopilot) if orders else None
        self._frames_per_tick = ORDERS_PER_TICK if orders else FRAMES_PER_TICK
        self._kinds: Counter[str] = Counter()

    def run(self, frames: int) -> FuzzResult:
        """Fire so many frames and see what is left."""
        began_s = self.flight.now_s
        for number in range(frames):
            legal = number % LEGAL_EVERY == LEGAL_EVERY - 1
            client = (self.udp, self.tcp)[int(self.rng.integers(2))]
            self._send(client, self._legal(client, number) if legal else self._garbage())
            if number % self._frames_per_tick == self._frames_per_tick - 1:
                self._tick()
        self._flush(len(self._stream))
        for _ in range(200):  # false beginnings at the stream's end are given up one by one
            self._tick()
        both = (self.udp, self.tcp)
        vehicle, estimate = self.flight.vehicle, self.flight.autopilot.estimate
        return FuzzResult(
            self._kinds,
            self.flight.now_s - began_s,
            tuple((client.commands_sent, client.commands_answered) for client in both),
            tuple((len(client.times_asked), len(client.times_asked & client.times_told)) for client in both),
            self.quiet.heartbeats,
            all(map(math.isfinite, (*vehicle.position, *vehicle.attitude, *estimate.position_ned_m))),
            self.signing.refused,
        )

    def _client(self, component: int, key: bytes | None) -> FuzzingClient:
        packer = mavlink.MAVLink(None, srcSystem=LEGAL_SYSTEM, srcComponent=component)
        if key is not None:
            packer.signing.secret_key, packer.signing.sign_outgoing = key, True
            packer.signing.timestamp = int((1.7e9 - 1_420_070_400) * 1e5)
            packer.signing.allow_unsigned_callback = None
        return FuzzingClient(packer)

    def _garbage(self) -> bytes:
        if self._orders is not None and self.rng.random() < ORDERS_SHARE:
            self._kinds["orders"] += 1
            return bytes(self._orders.next().pack(self._pilot if self.rng.random() < 0.5 else self._packer))
        make = KINDS[int(self.rng.integers(len(KINDS)))]
        self._kinds[make.__name__.replace("_", " ")] += 1
        return make(self.rng, self._templates[int(self.rng.integers(len(self._templates)))])

    def _legal(self, client: FuzzingClient, number: int) -> bytes:
        self._kinds["legal"] += 1
        if self.rng.random() < 0.5:
            client.commands_sent += 1
            parameters = (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, *(0.0,) * 6)
            message = mavlink.MAVLink_command_long_message(
                1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, *parameters
            )
        else:
            stamp = (1 << 40) + number
            client.times_asked.add(stamp)
            message = mavlink.MAVLink_timesync_message(0, stamp)
        return bytes(message.pack(client.packer))

    def _send(self, client: FuzzingClient, data: bytes) -> None:
        if client is self.tcp:
            self._stream += data
            self._flush(int(self.rng.integers(len(self._stream) + 1)))
        elif client.port is not None:
            self.network.receive(client.port, data, self.flight.now_s)

    def _flush(self, count: int) -> None:
        assert self.tcp.port is not None
        data = bytes(self._stream[:count])
        del self._stream[:count]
        self._overdue = max(0, self._overdue - count)
        self.network.receive(self.tcp.port, data, self.flight.now_s)

    def _tick(self) -> None:
        # cut anywhere, but no half of a frame is held back for long: that would be no frame, and rightly
        self._flush(self._overdue)
        self._overdue = len(self._stream)
        self.flight.run(TICK_S)
        self.network.transmit(self.flight.now_s, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for client in (self.udp, self.tcp, self.quiet):
            client.listen()


Rng = np.random.Generator
Message = Any  # pymavlink's classes are generated without types

FLOATS: Final = (
    0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, 90.0, 180.0, 30_000.0, 99_000.0,
    5.0, 50.0, 400.0, 410.0, 2.0, 3.0, -2.0, float(FORCE_MAGIC), 1e6,
)  # fmt: skip
WHOLE: Final = (0, 1, -1, 2**31 - 1, -(2**31), 470_000_000, 80_000_000, 470_001_000, 80_001_000)
NEAR: Final = (0, 470_000_000, 80_000_000, 470_001_000, 80_001_000)
STICKS: Final = (-32768, 32767, 0, 1000, -1000, 500)
CHANNELS: Final = (0, 1, 1000, 1500, 2000, 65534, 65535)
ITEMS: Final = (16, 17, 18, 19, 20, 21, 22, 82, 93, 112, 115, 177, 178, 179, 189)
FRAMES: Final = (0, 2, 3, 5, 6)
_ARM, _SET_MODE, _TAKE_OFF, _START = 400, 176, 22, 300


class Orders:
    """One who orders about: `next` is the next message, in sequences that go on from call to call."""

    def __init__(self, rng: Rng, autopilot: SimulatedAutopilot) -> None:
        self._rng = rng
        self._names = [name.encode() for name in autopilot.parameters]
        self._modes = [mode.custom_mode for mode in autopilot.profile.modes]
        self._is_px4 = autopilot.profile.name == "px4"
        self._waiting: list[Message] = []
        self._kinds: tuple[Callable[[], Message], ...] = (
            *(self._command,) * 3, *(self._command_int,) * 3, self._home, self._reposition, self._target,
            self._stick, self._channel, self._local, self._global, self._attitude, self._parameter,
            *(self._count,) * 2, *(self._item,) * 4, self._part, self._clear, self._current, self._request,
            self._mode, self._rate, self._text,
        )  # fmt: skip

    def next(self) -> Message:
        """The next message."""
        if not self._waiting:
            draw = self._rng.random()
            if draw < 0.04:
                self._waiting = self._fly()
            elif draw < 0.08:
                self._waiting = self._mission()
            else:
                return self._one(self._kinds)()
        return self._waiting.pop(0)

    # ------------------------------------------------------------ sequences

    def _fly(self) -> list[Message]:
        mode = (1, 4, 3) if self._is_px4 else (1, 4, 0)
        height = 410.0 if self._is_px4 else 10.0
        return [
            _long(_SET_MODE, *mode),
            _long(_ARM, 1, FORCE_MAGIC),
            _long(_TAKE_OFF, 0, 0, 0, 0, 0, 0, height),
        ]

    def _mission(self) -> list[Message]:
        """An upload, usually of what is taken, and the order to fly it."""
        count = int(self._rng.integers(1, 6))
        items = [self._item() for _ in range(count)]
        for number, item in enumerate(items):
            item.seq = number
            if self._rng.random() < 0.7:
                item.command = self._one((16, 16, 22, 177, 18, 178, 179))
            item.z = item.z if abs(item.z) <= 30_000.0 else 20.0
        begin = mavlink.MAVLink_mission_count_message(1, 1, count, 0)
        return [begin, *items, _long(_ARM, 1, FORCE_MAGIC), _long(_START)]

    # ------------------------------------------------------------ one function a kind

    def _command(self) -> Message:
        return _long(self._one((*HANDLERS, *LINK_HANDLERS)), *self._floats(7))

    def _command_int(self) -> Message:
        return mavlink.MAVLink_command_int_message(
            1, 1, self._one((0, 1, 3, 5, 6, 10, 255)), self._one((*HANDLERS, *LINK_HANDLERS)), 0, 0,
            *self._floats(4), self._one(WHOLE), self._one(WHOLE), *self._floats(1),
        )  # fmt: skip

    def _home(self) -> Message:
        return self._at(mavlink.MAV_CMD_DO_SET_HOME, (0.0,) * 4, (99_000.0, 29_000.0, -99_000.0, 10.0))

    def _reposition(self) -> Message:
        parameters = (-1.0, 1.0, 0.0, self._one((math.inf, -math.inf, math.nan, 3.4e38, 1.0)))
        return self._at(mavlink.MAV_CMD_DO_REPOSITION, parameters, (10.0, 30_000.0, math.nan))

    def _at(self, command: int, parameters: Sequence[float], heights: Sequence[float]) -> Message:
        return mavlink.MAVLink_command_int_message(
            1, 1, self._one((3, 6)), command, 0, 0, *parameters, 470_001_000, 80_001_000, self._one(heights)
        )

    def _target(self) -> Message:
        return mavlink.MAVLink_landing_target_message(
            0, 0, self._one((0, 1, 8, 12, 200)), *self._floats(8), self._floats(4), 2, self._one((0, 1, 2))
        )

    def _stick(self) -> Message:
        return mavlink.MAVLink_manual_control_message(1, *self._some(STICKS, 4), 65535)

    def _channel(self) -> Message:
        return mavlink.MAVLink_rc_channels_override_message(1, 1, *self._some(CHANNELS, 18))

    def _local(self) -> Message:
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, self._one((1, 7, 8, 9, 12)), self._below(4096), *self._floats(11)
        )

    def _global(self) -> Message:
        return mavlink.MAVLink_set_position_target_global_int_message(
            0,
            1,
            1,
            self._one((0, 3, 5, 6, 10, 11)),
            self._below(4096),
            *self._some(WHOLE, 2),
            *self._floats(9),
        )

    def _attitude(self) -> Message:
        attitude = self._one(([1.0, 0.0, 0.0, 0.0], [0.7071, 0.7071, 0.0, 0.0], self._floats(4)))
        return mavlink.MAVLink_set_attitude_target_message(
            0, 1, 1, self._below(256), attitude, *self._floats(3), self._one((0.5, 1.0, math.nan, math.inf))
        )

    def _parameter(self) -> Message:
        bits = struct.unpack("<f", struct.pack("<i", self._one((0, 1, 2, 100, -1))))[0]
        return mavlink.MAVLink_param_set_message(
            1, 1, self._one(self._names), self._one((*FLOATS, bits)), self._one((9, 6, 2, 4))
        )

    def _count(self) -> Message:
        return mavlink.MAVLink_mission_count_message(
            1, 1, self._one((0, 1, 2, 5, 5, 65535)), self._one((0, 0, 1))
        )

    def _item(self) -> Message:
        return mavlink.MAVLink_mission_item_int_message(
            1, 1, self._below(6), self._one(FRAMES), self._one(ITEMS), 0, 1, *self._floats(4),
            *self._some(NEAR, 2), self._one((10.0, 20.0, 30_000.0, -30_000.0, math.nan)), 0,
        )  # fmt: skip

    def _part(self) -> Message:
        return mavlink.MAVLink_mission_write_partial_list_message(1, 1, self._below(6), self._below(6), 0)

    def _clear(self) -> Message:
        return mavlink.MAVLink_mission_clear_all_message(1, 1, self._one((0, 255, 1)))

    def _current(self) -> Message:
        return mavlink.MAVLink_mission_set_current_message(1, 1, self._below(7))

    def _request(self) -> Message:
        kinds = (mavlink.MAVLink_mission_request_int_message, mavlink.MAVLink_mission_request_message)
        return self._one(kinds)(1, 1, self._below(7), self._one((0, 0, 1)))

    def _mode(self) -> Message:
        return mavlink.MAVLink_set_mode_message(1, 1, self._one(self._modes))

    def _rate(self) -> Message:
        rate = self._one((0, 1, 65535))
        return mavlink.MAVLink_request_data_stream_message(1, 1, self._below(14), rate, self._below(3))

    def _text(self) -> Message:
        return mavlink.MAVLink_statustext_message(
            self._below(256), bytes(range(130, 180)), self._below(65536), 0
        )

    # ------------------------------------------------------------ draws

    def _one(self, values: Sequence[Any]) -> Any:
        return values[int(self._rng.integers(len(values)))]

    def _some(self, values: Sequence[Any], count: int) -> list[Any]:
        return [self._one(values) for _ in range(count)]

    def _floats(self, count: int) -> list[float]:
        return self._some(FLOATS, count)

    def _below(self, limit: int) -> int:
        return int(self._rng.integers(limit))


def _long(command: int, *parameters: float) -> Message:
    filled = (*parameters, *(0.0,) * 7)[:7]
    return mavlink.MAVLink_command_long_message(1, 1, command, 0, *filled)


GARBAGE_SYSTEM: Final = 9
_HEADER: Final = 10
_SPECIAL: Final = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -0.0)
_SETUP_SIGNING: Final = mavlink.MAVLINK_MSG_ID_SETUP_SIGNING
_COMMANDS: Final = (
    *(20, 21, 22, 16, 17, 31, 84, 92, 176, 178, 179, 192, 195),
    *(400, 410, 511, 512, 519, 520, 521, 300),
)


def templates() -> list[Any]:
    """Legal messages of all kinds that the vehicle takes, and some that it does not."""
    position = (0.0, 0.0, -5.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    level = [1.0, 0.0, 0.0, 0.0]
    return [
        mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3),
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0b110111000111, *position),
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, 0b110111111000, 470000000, 80000000, 5.0, *position[3:]
        ),
        mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, level, 0.0, 0.0, 0.0, 0.5),
        mavlink.MAVLink_timesync_message(0, 123456),
        mavlink.MAVLink_ping_message(1, 2, 0, 0),
        mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1),
        mavlink.MAVLink_param_request_read_message(1, 1, b"SYSID_THISMAV", -1),
        mavlink.MAVLink_param_request_list_message(1, 1),
        mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 1500.0, 9),
        mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 5.0, 9),
        mavlink.MAVLink_set_mode_message(1, 1, 4),
        mavlink.MAVLink_mission_request_list_message(1, 1, 0),
        mavlink.MAVLink_mission_count_message(1, 1, 3, 0),
        mavlink.MAVLink_mission_item_int_message(
            1, 1, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 470000000, 80000000, 10.0, 0
        ),
        mavlink.MAVLink_mission_request_int_message(1, 1, 0, 0),
        mavlink.MAVLink_mission_set_current_message(1, 1, 0),
        mavlink.MAVLink_mission_clear_all_message(1, 1, 0),
        mavlink.MAVLink_landing_target_message(0, 0, 12, 0.1, 0.1, 2.0, 0.1, 0.1),
        mavlink.MAVLink_rc_channels_override_message(1, 1, *(1500,) * 8),
        mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
        mavlink.MAVLink_statustext_message(6, b"a text that is as long as a text of this kind may be.", 3, 0),
        mavlink.MAVLink_follow_target_message(
            0, 3, 470000000, 80000000, 400.0, [0.0] * 3, [0.0] * 3, level, [0.0] * 3, [1.0] * 3, 0
        ),
        *(mavlink.MAVLink_command_long_message(1, 1, number, 0, *(0.5,) * 7) for number in _COMMANDS),
        *(
            mavlink.MAVLink_command_int_message(
                1, 1, 6, number, 0, 0, 0.5, 0.5, 0.5, 0.5, 470000000, 80000000, 10.0
            )
            for number in _COMMANDS
        ),
    ]  # fmt: skip


# ---------------------------------------------------------------- one function a kind of garbage


def random_bytes(rng: Rng, frame: bytes) -> bytes:
    """Noise, now and then begun as a frame begins."""
    noise = rng.bytes(int(rng.integers(1, 300)))
    return (b"\xfd", b"\xfe", b"")[int(rng.integers(3))] + noise


def flipped(rng: Rng, frame: bytes) -> bytes:
    """Some bits the other way round; the check sum is wrong."""
    data = bytearray(frame)
    for _ in range(int(rng.integers(1, 5))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def flipped_and_mended(rng: Rng, frame: bytes) -> bytes:
    """Some bits of the content the other way round, and the check sum fits."""
    data = bytearray(frame)
    for _ in range(int(rng.integers(1, 9))):
        data[int(rng.integers(_HEADER, len(data) - 2))] ^= 1 << int(rng.integers(8))
    return mended(data)


def special_values(rng: Rng, frame: bytes) -> bytes:
    """Floats that are none, infinite, huge or tiny, anywhere."""
    data = bytearray(frame)
    for at in range(_HEADER, len(data) - 2 - 3, 4):
        if rng.random() < 0.5:
            struct.pack_into("<f", data, at, _SPECIAL[int(rng.integers(len(_SPECIAL)))])
    return mended(data)


def random_content(rng: Rng, frame: bytes) -> bytes:
    """Any message of the dialect with any content."""
    message_id = int(rng.choice(_MESSAGE_IDS))
    size = int(rng.integers(1, 256))
    header = struct.pack("<BBBBBBB", 0xFD, size, 0, 0, 0, GARBAGE_SYSTEM, int(rng.integers(256)))
    data = bytearray(header + message_id.to_bytes(3, "little") + rng.bytes(size) + b"\0\0")
    return mended(data)


def wrong_length(rng: Rng, frame: bytes) -> bytes:
    """A payload shorter or longer than the message's, and the check sum fits."""
    size = int(rng.integers(1, 256))
    payload = (frame[_HEADER:-2] + rng.bytes(255))[:size]
    return mended(bytearray(frame[:1] + bytes((size,)) + frame[2:_HEADER] + payload + b"\0\0"))


def false_length(rng: Rng, frame: bytes) -> bytes:
    """A length byte that claims other bytes than come."""
    return frame[:1] + rng.bytes(1) + frame[2:]


def truncated(rng: Rng, frame: bytes) -> bytes:
    """The beginning of a frame, or its end."""
    at = int(rng.integers(1, len(frame)))
    return frame[:at] if rng.random() < 0.5 else frame[at:]


def foreign(rng: Rng, frame: bytes) -> bytes:
    """A message that is in no dialect here."""
    return frame[:7] + int(rng.integers(60000, 1 << 24)).to_bytes(3, "little") + frame[_HEADER:]


def signed_by_nobody(rng: Rng, frame: bytes) -> bytes:
    """A signature of noise."""
    data = bytearray(frame)
    data[2] |= 1
    return mended(data) + rng.bytes(13)


def first_version(rng: Rng, frame: bytes) -> bytes:
    """MAVLink 1, its content flipped."""
    size, payload = frame[1], bytearray(frame[_HEADER:-2])
    payload[int(rng.integers(len(payload)))] ^= 1 << int(rng.integers(8))
    data = bytes((0xFE, size, frame[4], frame[5], frame[6], frame[7])) + bytes(payload)
    return data + _check_sum(data[1:], frame[7]) if frame[8:10] == b"\0\0" else data


KINDS: Final[tuple[Callable[[Rng, bytes], bytes], ...]] = (
    random_bytes,
    flipped,
    flipped_and_mended,
    special_values,
    random_content,
    wrong_length,
    false_length,
    truncated,
    foreign,
    signed_by_nobody,
    first_version,
)
# a key that really is taken over would end the legal stream, as it should
_MESSAGE_IDS: Final = [i for i in sorted(mavlink.mavlink_map) if i != _SETUP_SIGNING]


def mended(data: bytearray) -> bytes:
    """A MAVLink 2 frame with the check sum that its bytes ask for."""
    data[-2:] = _check_sum(bytes(data[1:-2]), int.from_bytes(data[7:10], "little"))
    return bytes(data)


def _check_sum(covered: bytes, message_id: int) -> bytes:
    extra = mavlink.mavlink_map[message_id].crc_extra
    return int(mavlink.x25crc(bytearray((*covered, extra))).crc).to_bytes(2, "little")
