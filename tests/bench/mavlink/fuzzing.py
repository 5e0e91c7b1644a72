"""Wrong MAVLink by the million, and a legal stream in between that has to get through.

A flown vehicle has three clients: one sends over UDP (a datagram a frame), one over TCP (the bytes cut
anywhere), one only listens. The two send garbage, and every so often a command and a TIMESYNC whose answers
are known. Everything comes from one seed. Garbage bears other names than the legal stream's. `orders`: most
of it is legal in form, and slower, so that the vehicle does something about it (`fuzz_orders`).
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from sitl.mavlink.framing import FrameReader, dialect
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.network import VEHICLE, Network, Port
from sitl.mavlink.signing import Signing
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from tests.bench.mavlink.fuzz_orders import Orders
from tests.unit.sitl.autopilot.autopilot_flight import HOME, Flight

mavlink: Any = dialect

LEGAL_EVERY: Final = 20  # one frame in so many
FRAMES_PER_TICK: Final = 20
ORDERS_PER_TICK: Final = 2
ORDERS_SHARE: Final = 0.8
TICK_S: Final = 0.01
LEGAL_SYSTEM: Final = 250
GARBAGE_SYSTEM: Final = 9
_HEADER: Final = 10
_SPECIAL: Final = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -0.0)
_SETUP_SIGNING: Final = mavlink.MAVLINK_MSG_ID_SETUP_SIGNING

Rng = np.random.Generator


def templates() -> list[Any]:
    """Legal messages of all kinds that the vehicle takes, and some that it does not."""
    position = (0.0, 0.0, -5.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    level = [1.0, 0.0, 0.0, 0.0]
    commands = (
        20,
        21,
        22,
        16,
        17,
        31,
        84,
        92,
        176,
        178,
        179,
        192,
        195,
        400,
        410,
        511,
        512,
        519,
        520,
        521,
        300,
    )
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
        *(mavlink.MAVLink_command_long_message(1, 1, number, 0, *(0.5,) * 7) for number in commands),
        *(
            mavlink.MAVLink_command_int_message(
                1, 1, 6, number, 0, 0, 0.5, 0.5, 0.5, 0.5, 470000000, 80000000, 10.0
            )
            for number in commands
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


# ---------------------------------------------------------------- the vehicle between them


@dataclass
class Client:
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
        self.flight = Flight(autopilot_kind)
        self.flight.take_off()
        self.flight.take_control()
        self.signing = Signing(autopilot_kind, key)
        sensors = SimulatedAutopilotSensors(
            np.random.default_rng(seed), TICK_S, home=HOME, field_ned_ut=(20.9, 0.6, 42.9), imu_filter=4
        )
        ground_station = GroundStation(np.random.default_rng(seed), 1.0, HOME, signing=self.signing)
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

    def _client(self, component: int, key: bytes | None) -> Client:
        packer = mavlink.MAVLink(None, srcSystem=LEGAL_SYSTEM, srcComponent=component)
        if key is not None:
            packer.signing.secret_key, packer.signing.sign_outgoing = key, True
            packer.signing.timestamp = int((1.7e9 - 1_420_070_400) * 1e5)
            packer.signing.allow_unsigned_callback = None
        return Client(packer)

    def _garbage(self) -> bytes:
        if self._orders is not None and self.rng.random() < ORDERS_SHARE:
            self._kinds["orders"] += 1
            return bytes(self._orders.next().pack(self._pilot if self.rng.random() < 0.5 else self._packer))
        make = KINDS[int(self.rng.integers(len(KINDS)))]
        self._kinds[make.__name__.replace("_", " ")] += 1
        return make(self.rng, self._templates[int(self.rng.integers(len(self._templates)))])

    def _legal(self, client: Client, number: int) -> bytes:
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

    def _send(self, client: Client, data: bytes) -> None:
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
