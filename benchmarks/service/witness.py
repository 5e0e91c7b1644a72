"""A witness on the line between app and autopilot: what passed and when, and what a ground station says."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from companion.link.codec import Codec, command_long, mavlink

ASKING: Final = frozenset({mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE})
OFFBOARD: Final = 6 << 16  # PX4's main mode
POSCTL: Final = 3 << 16
GROUND_STATION: Final = (255, 190)


@dataclass(frozen=True, slots=True)
class Beat:
    """A heartbeat of the autopilot, with the time (s, monotonic) at which it passed."""

    time_s: float
    mode: int
    armed: bool


@dataclass(frozen=True, slots=True)
class AppCommand:
    """A command of the app's to the autopilot."""

    time_s: float
    number: int


@dataclass
class SeenTraffic:
    """What passed: the app's setpoints (s, monotonic) and commands, the autopilot's heartbeats."""

    setpoints: list[float] = field(default_factory=list)
    commands: list[AppCommand] = field(default_factory=list)
    beats: list[Beat] = field(default_factory=list)

    def take(self, message: Any, now_s: float, *, from_app: bool) -> None:
        """Note a message; requests for telemetry order nothing."""
        kind = message.get_type()
        if from_app and kind.startswith("SET_") and "TARGET" in kind:
            self.setpoints.append(now_s)
        elif from_app and kind in {"COMMAND_LONG", "COMMAND_INT"} and message.command not in ASKING:
            self.commands.append(AppCommand(now_s, message.command))
        elif not from_app and kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.beats.append(Beat(now_s, message.custom_mode, armed))

    def at(self, time_s: float) -> Beat:
        """The last heartbeat until then; before the first one, a vehicle that is disarmed."""
        return next((b for b in reversed(self.beats) if b.time_s <= time_s), Beat(time_s, 0, armed=False))


class UdpWitness:
    """A UDP relay between the app, which calls `port`, and the simulated vehicle at `vehicle_port`."""

    def __init__(self, vehicle_port: int, port: int = 0) -> None:
        self.seen = SeenTraffic()
        self._app_side = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._app_side.bind(("127.0.0.1", port))
        self._vehicle_side = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle_side.connect(("127.0.0.1", vehicle_port))
        for side in (self._app_side, self._vehicle_side):
            # what a socket is ready for may be an error, which the other direction's send takes away
            side.setblocking(False)
        self.port: int = self._app_side.getsockname()[1]
        self._pilot = Codec(*GROUND_STATION)
        self._ends = False
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the relay."""
        self._ends = True
        self._thread.join()
        self._app_side.close()
        self._vehicle_side.close()

    def pilot(self, number: int, *parameters: float) -> None:
        """A command of the ground station's to the autopilot."""
        filled = (*parameters, *(0.0,) * (7 - len(parameters)))
        self._vehicle_side.send(self._pilot.encode(command_long(number, filled, 1, 1)))

    def set_parameter(self, name: str, number: int) -> None:
        """Set an integer parameter as a ground station does: PX4 takes its bytes in a float's place."""
        value = struct.unpack("<f", struct.pack("<i", number))[0]
        message = mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_INT32)
        self._vehicle_side.send(self._pilot.encode(message))

    def until(self, holds: Callable[[Beat], bool], most_s: float) -> bool:
        """Wait for a heartbeat of which something holds; whether one came in time."""
        by_s, seen = time.monotonic() + most_s, len(self.seen.beats)
        while time.monotonic() < by_s:
            if any(holds(beat) for beat in self.seen.beats[seen:]):
                return True
            time.sleep(0.05)
        return False

    def _relay(self) -> None:
        app: tuple[str, int] | None = None
        codecs = {True: Codec(1), False: Codec(1)}
        while not self._ends:
            for ready in select.select([self._app_side, self._vehicle_side], [], [], 0.2)[0]:
                from_app = ready is self._app_side
                with suppress(OSError):
                    if from_app:
                        data, app = self._app_side.recvfrom(65536)
                        self._vehicle_side.send(data)
                    else:
                        data = self._vehicle_side.recv(65536)
                        if app is not None:
                            self._app_side.sendto(data, app)
                    now_s = time.monotonic()
                    for message in codecs[from_app].decode(data):
                        self.seen.take(message, now_s, from_app=from_app)
