"""The service's local socket, for `companion status` and `order`: JSON requests and answers, one a line.

    {"request": "status"}                 -> a StateReport
    {"request": "order", "kind": "land"}  -> {"kind": "land", "outcome": "in_progress", "text": ""}, later how
                                             it ended

What comes meanwhile is read at once: no order waits for the end of another. One with "until_s" (since the
machine's boot) is refused later than that: whoever gave it has been told that nobody answers.

A socket of the file system, for the owner and the group alone: who may give orders is who may open it.
"""

import asyncio
import json
import math
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Final

from companion.base.clock import Clock, up_s
from companion.base.errors import ConfigError
from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply

FILE_NAME: Final = "companion.sock"
MODE: Final = 0o660
LONGEST_REQUEST: Final = 4096
SYSTEM_FOLDER: Final = Path("/run/companion")
SOCKETS: Final = Path("/proc/net/unix")  # proc_pid_net(5)
_LISTENS: Final = 0x10000  # of a socket's flags there

Give = Callable[[Order, Callable[[OrderReply], None]], None]


def socket_path() -> Path:
    """Where a service listens: systemd's runtime directory, else the user's."""
    directory = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if directory:
        return Path(directory) / FILE_NAME
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user or "/tmp") / f"companion-{os.getuid()}" / FILE_NAME


def where_to_ask() -> Path:
    """Where a client looks: the system's service first, then the user's own."""
    # the folder is there while the service runs; who is not of its group sees nothing in it
    return SYSTEM_FOLDER / FILE_NAME if SYSTEM_FOLDER.is_dir() else socket_path()


def listening_elsewhere(than: Path) -> list[str]:
    """Where other services on this machine listen, of whatever user; none where the kernel does not tell."""
    try:
        rows = [line.split(maxsplit=7) for line in SOCKETS.read_text(errors="replace").splitlines()[1:]]
    except OSError:
        return []
    paths = {row[7] for row in rows if len(row) == 8 and int(row[3], 16) & _LISTENS}
    return sorted(path for path in paths if Path(path).name == FILE_NAME and path != str(than))


@asynccontextmanager
async def served(
    path: Path, report: Callable[[], Awaitable[str]], give: Give, clock: Clock
) -> AsyncIterator[None]:
    """Listen while inside; `report` gives the state as one line of JSON, `give` takes orders.

    Raises:
        ConfigError: the socket cannot be made, or another service listens there.
    """

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.CancelledError):  # asyncio would log it, when the service ends
            try:
                async with asyncio.TaskGroup() as answering:
                    await _serve(reader, writer, report, give, clock, answering)
            except* (OSError, ValueError, asyncio.IncompleteReadError):
                pass  # it has gone, or what it sends has no end
        writer.close()

    try:
        await _make_room(path)
        server = await asyncio.start_unix_server(serve, path, limit=LONGEST_REQUEST)
        path.chmod(MODE)  # noqa: ASYNC240 - a moment, at the start
    except OSError as error:
        raise ConfigError(f"local socket {path}: {error.strerror or error}") from error
    try:
        yield
    finally:
        server.close()
        path.unlink(missing_ok=True)  # noqa: ASYNC240


async def _make_room(path: Path) -> None:
    """Make the folder, and remove what a service that was killed left; one that answers stays.

    Raises:
        ConfigError: another service listens there, or the folder is somebody else's.
        OSError: it cannot be made.
    """
    folder = path.parent
    folder.mkdir(mode=0o750, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise ConfigError(f"local socket: {folder} belongs to another user; expected one's own folder")
    try:
        _, writer = await asyncio.open_unix_connection(path)
    except OSError:
        path.unlink(missing_ok=True)  # noqa: ASYNC240
        return
    writer.close()
    raise ConfigError(f"local socket {path}: another companion listens there; expected it to be stopped")


async def _serve(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    report: Callable[[], Awaitable[str]],
    give: Give,
    clock: Clock,
    answering: asyncio.TaskGroup,
) -> None:
    while line := await reader.readline():
        try:
            request = json.loads(line)
            wanted = request["request"]
            kind = OrderKind(request["kind"]) if wanted == "order" else None
            late = up_s() > float(request.get("until_s", math.inf))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            writer.write(b'{"error": "expected a request: status, or order with its kind"}\n')
            continue
        if kind is not None and late:
            _answer(writer, kind, OrderOutcome.TEMPORARILY_REJECTED, "it came too late")
        elif kind is not None:
            answering.create_task(_order(writer, kind, give, clock))
        elif wanted == "status":
            writer.write((await report()).encode() + b"\n")
        else:
            writer.write(b'{"error": "expected a request: status or order"}\n')
        await writer.drain()


async def _order(writer: asyncio.StreamWriter, kind: OrderKind, give: Give, clock: Clock) -> None:
    """Give an order and send its answers as they come; the client going away changes nothing."""
    replies: asyncio.Queue[OrderReply] = asyncio.Queue()
    give(Order(clock.now_s(), kind, "the local socket"), replies.put_nowait)
    while True:
        reply = await replies.get()
        _answer(writer, kind, reply.outcome, reply.text)
        await writer.drain()
        if reply.outcome is not OrderOutcome.IN_PROGRESS:
            return


def _answer(writer: asyncio.StreamWriter, kind: OrderKind, outcome: OrderOutcome, text: str) -> None:
    answer = {"kind": kind.value, "outcome": outcome.value, "text": text}
    writer.write(json.dumps(answer).encode() + b"\n")
