"""Wrong MAVLink by the million, and a legal stream in between that has to get through.

A flown vehicle has three clients: one sends over UDP (a datagram a frame), one over TCP (the bytes cut
anywhere), one only listens. The two send garbage, and every so often a command and a TIMESYNC whose answers
are known. Everything comes from one seed. Garbage bears other names than the legal stream's. `orders`: most
of it is legal in form, and slower, so that the vehicle does something about it (`fuzz_orders`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmarks.mavlink.fuzz_orders import Orders
from benchmarks.mavlink.garbage import GARBAGE_SYSTEM, KINDS, templates
from companion.base.autopilot_kind import AutopilotKind
from sitl.mavlink.framing import FrameReader, dialect
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.network import VEHICLE, Network, Port
from sitl.mavlink.signing import Signing
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight

mavlink: Any = dialect

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
