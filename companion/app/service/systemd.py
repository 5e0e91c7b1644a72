"""What systemd is notified of, and what it says of the service.

It is told that the app is ready, that its control loop is alive, and what it does, by the protocol of
sd_notify(3): one datagram of KEY=VALUE lines to the socket named in NOTIFY_SOCKET. Without that variable (in
SITL, or started by hand) nothing is sent.
"""

import os
import shutil
import socket
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

SERVICE: Final = "companion.service"
PATIENCE_S: Final = 5.0
VCGENCMD_S: Final = 1.0


class ServiceNotifier:
    """Sends states to the service manager, if there is one."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            # the control loop calls: a manager that does not read must not hold it up
            self._socket.setblocking(False)

    def ready(self) -> None:
        """The start is done (Type=notify)."""
        self._send("READY=1")

    def alive(self) -> None:
        """The control loop has turned once more (WatchdogSec)."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """For `systemctl status`, as one line: the protocol's next line is another word to the manager."""
        self._send(f"STATUS={' '.join(text.splitlines())}")

    def stopping(self) -> None:
        """The end has begun."""
        self._send("STOPPING=1")

    def _send(self, line: str) -> None:
        if self._socket is not None:
            # a manager that has not read the last ones yet, or is away now, hears the next
            with suppress(OSError):
                self._socket.sendto(line.encode(errors="replace"), self._address)


@dataclass(frozen=True, slots=True)
class ServiceState:
    """What systemd says of the service; empty words where it says nothing."""

    load: str = ""
    enabled: str = ""
    active: str = ""

    @property
    def running(self) -> bool:
        """Whether it has the devices."""
        return self.active in {"active", "activating", "reloading", "deactivating"}


def output_of(*words: str, within_s: float = PATIENCE_S) -> str | None:
    """What a program prints; None when there is none, or when it does not end well."""
    if shutil.which(words[0]) is None:
        return None
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=within_s, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def throttled_bits() -> int | None:
    """What a Raspberry Pi says of its supply and its heat, by `vcgencmd get_throttled`; None elsewhere."""
    said = output_of("vcgencmd", "get_throttled", within_s=VCGENCMD_S) or ""
    with suppress(ValueError):
        return int(said.partition("=")[2], 16)
    return None


def service_state() -> ServiceState | None:
    """The service's state; None where no systemd runs."""
    detail = output_of("systemctl", "show", SERVICE, "--property=LoadState,UnitFileState,ActiveState")
    if detail is None:
        return None
    words = dict(line.split("=", 1) for line in detail.splitlines() if "=" in line)
    return ServiceState(
        words.get("LoadState", ""), words.get("UnitFileState", ""), words.get("ActiveState", "")
    )
