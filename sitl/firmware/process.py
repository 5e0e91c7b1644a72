"""A firmware's process: started in an empty folder of its own, ended by us whatever happens."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Final

from companion.config import ConfigError

LOOPBACK: Final = "127.0.0.1"
INSTANCES: Final = 10  # PX4 gives further ones a shared port
_END_S: Final = 2.0
_DATAGRAM_BYTES: Final = 4096


class FirmwareError(RuntimeError):
    """The firmware has ended, or does not answer; the text is one line."""


class Process:
    """A child with its log in a temporary folder, which goes with it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._folder = tempfile.TemporaryDirectory(prefix=f"{name}-")
        self.folder = Path(self._folder.name)
        self._log: IO[bytes] = (self.folder / "firmware.log").open("wb")
        self._child: subprocess.Popen[bytes] | None = None

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
        except OSError as error:
            raise ConfigError(f"{command[0]}: cannot be run ({error.strerror})") from error

    def check(self) -> None:
        """Make sure that it runs.

        Raises:
            FirmwareError: it does not; the text has its last words.
        """
        if self._child is None or self._child.poll() is not None:
            code = None if self._child is None else self._child.returncode
            raise FirmwareError(f"{self.name} has ended (exit status {code}): {self.last_words()}")

    def last_words(self) -> str:
        """The last line of its log that says anything."""
        lines = (self.folder / "firmware.log").read_text(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")

    def close(self) -> None:
        """End it and clear up."""
        if self._child is not None:
            self._child.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.wait(_END_S)
        self._log.close()
        self._folder.cleanup()


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
        """The datagrams that have come since."""
        come: list[bytes] = []
        while True:
            try:
                data, self._peer = self._socket.recvfrom(_DATAGRAM_BYTES)
            except (BlockingIOError, ConnectionError):
                return come
            come.append(data)

    def write(self, data: bytes) -> None:
        """Send to whoever spoke last; dropped while nobody has."""
        if self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()
