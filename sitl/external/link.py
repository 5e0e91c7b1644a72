"""Links to an external vehicle over UDP or TCP, and a UDP port by which the app shares them.

`udp:HOST:PORT` sends to that port, `udpin:HOST:PORT` listens there (a PX4 SITL sends to 14540 and 14550),
`tcp:HOST:PORT` connects and reconnects (an ArduPilot SITL listens on 5760, 5762 and 5763). While the vehicle
is absent it waits; `tell` gets one line about that, and one when the vehicle is back.
"""

import asyncio
import contextlib
import os
from collections.abc import Callable
from typing import Final

from companion.base.udp_socket import Inbox, UdpSocket
from companion.config import CONNECTION_FORM, ConfigError
from sitl.run.mavlink_line import ByteLink

RETRY_S: Final = 1.0
_READ_BYTES: Final = 4096
_WRITE_BYTES: Final = 1 << 16

Tell = Callable[[str], None]


class TcpEnd:
    """A TCP connection that we open, and open again whenever it is closed."""

    def __init__(self, host: str, port: int, tell: Tell) -> None:
        self._name = f"tcp:{host}:{port}"
        self._inbox = Inbox()
        self._writer: asyncio.StreamWriter | None = None
        self._tell = tell
        self._warned = False
        self._task = asyncio.create_task(self._stay_connected(host, port), name=self._name)

    async def read(self) -> bytes:
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        """Send; dropped while there is no connection."""
        writer = self._writer
        if writer is not None and data and writer.transport.get_write_buffer_size() < _WRITE_BYTES:
            writer.write(data)

    def close(self) -> None:
        self._task.cancel()
        if self._writer is not None:
            self._writer.transport.abort()

    async def _stay_connected(self, host: str, port: int) -> None:
        while True:
            try:
                reader, self._writer = await asyncio.open_connection(host, port)
                if self._warned:
                    self._warned = False
                    self._tell(f"{self._name}: connected again")
                while data := await reader.read(_READ_BYTES):
                    self._inbox.put(data)
                self._complain("closed by the other side")
            except OSError as error:
                self._complain(_reason(error))
            finally:
                if self._writer is not None:
                    self._writer.close()
                    self._writer = None
            await asyncio.sleep(RETRY_S)

    def _complain(self, reason: str) -> None:
        if not self._warned:
            self._warned = True
            self._tell(f"{self._name}: {reason}; trying again every {RETRY_S:g} s")


ExternalLink = UdpSocket | TcpEnd


def check_connection(spec: str, option: str) -> None:
    """Refuse what is no connection, before anything is opened.

    Raises:
        ConfigError: one line with what was expected.
    """
    form = CONNECTION_FORM.fullmatch(spec)
    calls = form is not None and form["host"] is not None and _is_name(form["host"])
    if form is None or not calls or not 1 <= int(form["port"]) <= 65535:
        raise ConfigError(
            f"{option} {spec}: expected udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT, port 1..65535"
        )


def _is_name(host: str) -> bool:
    """Whether it is a valid host name; it is resolved later."""
    try:
        host.encode("idna")
    except UnicodeError:
        return False
    return True


async def open_link(spec: str, tell: Tell) -> ExternalLink:
    """Open a connection that `check_connection` has let pass.

    Raises:
        ConfigError: the port is taken, or the host is not known.
    """
    form = CONNECTION_FORM.fullmatch(spec)
    assert form is not None
    host, port = form["host"], int(form["port"])
    if form["kind"] == "tcp":
        return TcpEnd(host, port, tell)
    end = UdpSocket()
    try:
        await end.open(host, port, listen=form["kind"] == "udpin")
    except OSError as error:
        raise ConfigError(f"{spec}: {_reason(error)}; expected a free port of a known host") from error
    return end


def _reason(error: OSError) -> str:
    return os.strerror(error.errno) if error.errno is not None and error.errno > 0 else str(error)


async def open_relay() -> tuple[UdpSocket, int]:
    """A UDP port of the loopback for the app, and its number."""
    relay = UdpSocket()
    return relay, await relay.open("127.0.0.1", 0, listen=True)


async def pump(source: ByteLink, *sinks: Callable[[bytes], None], tell: Tell = print) -> None:
    """Forward what arrives, until cancelled or the source is closed.

    Invalid values from the vehicle do not end the simulation: `tell` gets the first
    such problem, and the bytes are ignored.
    """
    warned = False
    with contextlib.suppress(asyncio.CancelledError, OSError):
        while True:
            data = await source.read()
            for sink in sinks:
                try:
                    sink(data)
                except (ArithmeticError, ValueError) as error:
                    if not warned:
                        warned = True
                        tell(f"WARNING: ignored invalid data ({error})")
