"""One app at an autopilot: what keeps a second one on this machine away from the same line.

Two of them would both answer orders and send setpoints, as one component, and neither would know. A serial
port can be had by one process alone, but a UDP or TCP address by many. So the one that flies holds a name,
made of the address, in Linux's abstract namespace of sockets: it belongs to no user and no folder, and it is
gone with the process that holds it, however that ends (unix(7)). Elsewhere than on Linux nothing is held.
"""

import errno
import hashlib
import os
import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from companion.base.errors import ConfigError

ANOTHER: Final = "another companion"
# nobody takes their calls: so many are told which process it is, the others that there is one
ASKED: Final = 100
_CREDENTIALS: Final = struct.Struct("3i")  # struct ucred: process, user, group


@contextmanager
def only_app_at(connection: str) -> Iterator[None]:
    """Hold the line to the autopilot while inside.

    Raises:
        ConfigError: another app on this machine holds it.
    """
    if sys.platform != "linux":
        yield
        return
    name = _name(connection)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as held:
        try:
            held.bind(name)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise ConfigError(
                f"link.connection {connection}: {_holder(name) or ANOTHER} is at this autopilot; "
                "expected it to be stopped ('systemctl stop companion', if it is the service)"
            ) from None
        held.listen(ASKED)  # so that who is refused can ask who is there
        yield


def app_at(connection: str) -> str | None:
    """Which app on this machine is at this autopilot, in words; None: none. Nothing is held by asking."""
    return _holder(_name(connection)) if sys.platform == "linux" else None


def _name(connection: str) -> str:
    """A name of fixed length, the same for all paths of one device."""
    kind, _, rest = connection.partition(":")
    if kind == "serial":
        path, _, _ = rest.rpartition(":")
        connection = f"serial:{os.path.realpath(path)}"
    return f"\0companion-{hashlib.sha256(connection.encode()).hexdigest()[:32]}"


def _holder(name: str) -> str | None:
    """Who holds it, as far as the kernel tells; None: nobody."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(name)
        except BlockingIOError:
            return ANOTHER
        except OSError:
            return None
        credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, _, _ = _CREDENTIALS.unpack(credentials)
    return f"{ANOTHER} (process {process})" if process > 0 else ANOTHER
