"""A firmware's process: started in an empty folder of its own, ended by us whatever happens."""

import contextlib
import os
import signal
import socket
import subprocess
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Final, NamedTuple

from companion.base.geometry import Vector3
from companion.config import ConfigError
from sitl.firmware import FirmwareError
from sitl.scenario.scenario import AirframeConfig
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import QuadrotorState, RotorValues

LOOPBACK: Final = "127.0.0.1"
INSTANCES: Final = 10  # PX4 gives further ones a shared port
# time to exit after the connection was closed, so that the exit status can be reported
LAST_S: Final = 0.5
LOOK_S: Final = 0.2  # how often a process without output is checked
MOST_DATAGRAMS: Final = 1000  # at once; a firmware sends some tens
_END_S: Final = 2.0
_DATAGRAM_BYTES: Final = 4096
_LOG_NAME: Final = "firmware.log"
_WORDS_BYTES: Final = 4096
# $1 is the process group, $2 the folder; the end of standard input is ours
_WATCH: Final = 'read -r _; kill -s KILL -- "-$1"; rm -rf -- "$2"'


class Process:
    """A child process with its log in a temporary folder, which is removed with it.

    A shell watches this process: when it is killed, the shell ends the child and removes the folder.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._folder = tempfile.TemporaryDirectory(prefix=f"{name}-", ignore_cleanup_errors=True)
        self.folder = Path(self._folder.name)
        self._log: IO[bytes] = (self.folder / _LOG_NAME).open("wb")
        self._child: subprocess.Popen[bytes] | None = None
        self._watch: subprocess.Popen[bytes] | None = None

    def start(self, command: Sequence[str | Path], environment: Mapping[str, str]) -> None:
        """Start it.

        Raises:
            ConfigError: the program cannot be run.
        """
        try:
            self._child = subprocess.Popen(
                [str(word) for word in command],
                cwd=self.folder,
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            self._watch = subprocess.Popen(
                ["/bin/sh", "-c", _WATCH, "sh", str(self._child.pid), str(self.folder)],
                cwd="/",
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            raise ConfigError(f"{command[0]}: cannot be run ({error.strerror})") from error

    def check(self, wait_s: float = 0.0) -> None:
        """Make sure that it runs, and still does in `wait_s`.

        Raises:
            FirmwareError: it does not; the text has its last words.
        """
        assert self._child is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._child.wait(wait_s)
            how = f"exit status {code}" if code >= 0 else f"signal {-code}"
            raise FirmwareError(f"{self.name} has ended ({how}): {self.last_words()}")

    def last_words(self) -> str:
        """The last non-empty line of its log."""
        said = (self.folder / _LOG_NAME).read_bytes()[-_WORDS_BYTES:].decode(errors="replace")
        lines = (" ".join(line.split()) for line in reversed(said.split("\n")))
        return next((line for line in lines if line), "no output")

    def close(self) -> None:
        if self._child is not None and self._child.poll() is None:
            os.killpg(self._child.pid, signal.SIGKILL)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.wait(_END_S)
        self._log.close()
        self._folder.cleanup()
        if self._watch is not None:
            assert self._watch.stdin is not None
            self._watch.kill()
            self._watch.wait()
            self._watch.stdin.close()


class Datagrams:
    """Our end of the firmware's MAVLink over UDP: it never blocks."""

    def __init__(self, port: int) -> None:
        """Bind.

        Raises:
            OSError: the port is taken.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((LOOPBACK, port))
        except OSError:
            self._socket.close()
            raise
        self.port = int(self._socket.getsockname()[1])
        self._peer: tuple[str, int] | None = None

    def read(self) -> list[bytes]:
        """The datagrams that have come since; of very many the rest the next time."""
        come: list[bytes] = []
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while len(come) < MOST_DATAGRAMS:
                data, self._peer = self._socket.recvfrom(_DATAGRAM_BYTES)
                come.append(data)
        return come

    def write(self, data: bytes) -> None:
        """Send to the last sender; dropped while there is none."""
        if self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        self._socket.close()


def is_free(kind: socket.SocketKind, port: int) -> bool:
    """Whether a program may have a TCP or UDP port at all addresses of this computer."""
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            # it may have been given back just now
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", port))
        except OSError:
            return False
    return True


# an answer takes a fraction of a millisecond; a machine too busy for this one is hopeless
ANSWER_S: Final = 5.0


class Moment(NamedTuple):
    """The vehicle at one step, as its sensors have it; `clock_s` is the firmware's time."""

    clock_s: float
    sensors: SimulatedAutopilotSensors
    state: QuadrotorState


class Setup(NamedTuple):
    """What the firmware needs to know of the vehicle, set by parameters."""

    airframe: AirframeConfig  # as its builder believes it
    home: Vector3  # latitude (deg), longitude (deg), altitude (m AMSL) of the world's origin
    gps_delay_s: float
    parameters: dict[str, float]  # over all others
    rate_scale: float = 1.0  # what tuning has multiplied the rate loops' gains by


class Firmware(ABC):
    """A running firmware in lockstep: time passes for it in `step` alone. Making one opens the two below."""

    _link: Datagrams
    _opened: ExitStack

    @abstractmethod
    def step(self, moment: Moment) -> RotorValues:
        """The motors' shares of full thrust (front, right, rear, left) until the next step.

        Raises:
            FirmwareError: it has ended or does not answer.
        """

    def read(self) -> list[bytes]:
        return self._link.read()

    def write(self, data: bytes) -> None:
        self._link.write(data)

    def close(self) -> None:
        self._opened.close()
