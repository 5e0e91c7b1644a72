"""The vehicle's links and what passes between them, sans I/O.

Each client is a `Port` with an endpoint of its own on the one autopilot. Frames that are for others, or for
all, are forwarded unchanged to the ports behind which their target has been seen (mavlink.io, "Routing"; both
autopilots forward so). The ground station at the pad has no socket: it receives from and sends to all.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from companion.base.geometry import Vector3
from companion.link.codec import mavlink
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.mavlink.framing import FrameReader, MavFrame, Signing
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.sensor_telemetry import TruthMessages
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors

Write = Callable[[Sequence[bytes]], None]
VEHICLE: Final = (1, 1)
# a key for one link, and a radio's status of one link
_NEVER_FORWARDED: Final = frozenset(
    {mavlink.MAVLINK_MSG_ID_SETUP_SIGNING, mavlink.MAVLINK_MSG_ID_RADIO, mavlink.MAVLINK_MSG_ID_RADIO_STATUS}
)
_MOST_NODES: Final = 64


class Port:
    """One client's port: its endpoint, how to write to it (whole frames), and the nodes behind it."""

    def __init__(self, endpoint: MavlinkEndpoint, write: Write) -> None:
        self.endpoint = endpoint
        self.write = write
        self.nodes: set[tuple[int, int]] = set()

    def learn(self, frame: MavFrame) -> None:
        """Store the sender's system and component; bounded."""
        if frame.system and len(self.nodes) < _MOST_NODES:
            self.nodes.add((frame.system, frame.component))

    def leads_to(self, system: int, component: int) -> bool:
        """Whether a target has been seen on this port; 0 is any."""
        if system == 0:
            return True
        return any(s == system and component in (0, c) for s, c in self.nodes)


class Network:
    """All MAVLink ports of one vehicle."""

    def __init__(
        self,
        autopilot: SimulatedAutopilot,
        sensors: SimulatedAutopilotSensors,
        ground_station: GroundStation,
        signing: Signing,
        unix_at_start_s: float,
        truth: TruthMessages | None = None,
    ) -> None:
        self._autopilot = autopilot
        self._sensors = sensors
        self._ground_station = ground_station
        self._signing = signing
        self._unix_at_start_s = unix_at_start_s
        self._truth = truth
        self._ports: list[Port] = []
        self._links_made = 0

    def connect(self, write: Write, *, datagrams: bool) -> Port:
        """Open a port for a client; `datagrams`: whole ones are handed to `receive`."""
        endpoint = MavlinkEndpoint(
            self._autopilot,
            self._sensors,
            *VEHICLE,
            signing=self._signing,
            link_id=self._links_made % 256,
            datagrams=datagrams,
            unix_at_start_s=self._unix_at_start_s,
            truth=self._truth,
        )
        self._links_made += 1
        port = Port(endpoint, write)
        endpoint.send_to_other_links = lambda message: self._send_to_others(port, message)
        self._ports.append(port)
        return port

    def disconnect(self, port: Port) -> None:
        self._ports.remove(port)

    def restart(self) -> None:
        """After a reset of the autopilot: every link's streams are the default ones."""
        for port in self._ports:
            port.endpoint.restart()

    def receive(self, port: Port, data: bytes, now_s: float) -> None:
        """Handle what a client sent, forward what is for others, and answer at once."""
        endpoint = port.endpoint
        for frame in endpoint.frames(data, now_s):
            if (frame.system, frame.component) == VEHICLE:
                continue  # the vehicle's own frame, returned by a loop
            port.learn(frame)
            self._forward(port, frame)
            endpoint.handle(frame, now_s)
            self._ground_station.handle(frame, now_s)
        self._answer(now_s)

    def transmit(self, now_s: float, pad_position_ned_m: Vector3, pad_velocity_ned_m_s: Vector3) -> None:
        """Send all that is due; the pad's motion is where the ground station's beacon starts."""
        self._signing.advance(self._unix_at_start_s + now_s)
        beacon = self._ground_station.transmit(now_s, pad_position_ned_m, pad_velocity_ned_m_s)
        if self._ground_station.intruders:
            self._obey(beacon, now_s)
        for port in tuple(self._ports):
            if port.endpoint.waits:
                self.receive(port, b"", now_s)
            due = port.endpoint.due(now_s)
            if beacon:
                due.append(beacon)
            if due:
                port.write(due)
        self._answer(now_s)  # including texts queued by the above

    def _obey(self, data: bytes, now_s: float) -> None:
        """What others send to the vehicle, over the same radio."""
        for frame in FrameReader(datagrams=True).read(data, now_s):
            if (frame.system, frame.component) != VEHICLE and self._signing.accepts(frame):
                for port in self._ports[:1]:
                    port.endpoint.handle(frame, now_s)

    def _answer(self, now_s: float) -> None:
        self._send_texts()
        for port in self._ports:
            if answers := port.endpoint.answers(now_s):
                port.write(answers)

    def _send_texts(self) -> None:
        for severity, text in self._autopilot.take_texts():
            for port in self._ports:
                port.endpoint.send_text(severity, text)

    def _send_to_others(self, source: Port, message: Any) -> None:
        for port in self._ports:
            if port is not source:
                port.endpoint.queue(message)

    def _forward(self, source: Port, frame: MavFrame) -> None:
        if len(self._ports) < 2 or frame.message_id in _NEVER_FORWARDED:
            return
        target = frame.target
        if target == VEHICLE:
            return
        for port in self._ports:
            if port is not source and port.leads_to(*target):
                port.write((frame.data,))
