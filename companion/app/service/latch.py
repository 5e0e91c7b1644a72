"""The latch on disk: a flight was permitted, begun or ended. Without it a restart would fly again, unasked.

A file beside the flights. `begin` writes "begun" before anything is asked of the vehicle, `end` how it ended;
a process that is killed, or a battery that is pulled, leaves "begun". Then only the operator's word,
`companion permit`, lets the next start fly. What starts the app by itself, at boot, after a crash or after a
flight (systemd, a container's restart policy, cron), has no terminal: every such start needs that word. It is
used up as it is read, so that a start that dies in whatever way before its flight leaves none; an error that
is reported in order gives it back. It holds for an hour and until the computer starts anew: whoever powers
the vehicle up tomorrow has not given it.
"""

import json
import math
import os
import sys
import uuid
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.clock import up_s
from companion.base.errors import ConfigError
from companion.base.files import write_durably

FILE_NAME: Final = "latch.json"
PERMIT_S: Final = 3600.0
BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")  # Linux': another one at each boot
PERMIT_HINT: Final = "'companion permit' lets the next start fly"


class LatchState(StrEnum):
    """What the file says; NONE: there is no file."""

    NONE = "none"
    PERMITTED = "permitted"
    TAKEN = "taken"  # by a start that has begun no flight yet; the words are its own
    BEGUN = "begun"
    ENDED = "ended"
    UNREADABLE = "unreadable"


@dataclass(slots=True)
class FlightLatch:
    """The latch in a folder, which is made."""

    folder: Path
    _begun: bool = field(default=False, init=False)
    _taken: str | None = field(default=None, init=False)
    _permit: str = field(default="", init=False)
    _unattended: bool = field(default=False, init=False)

    @property
    def path(self) -> Path:
        return self.folder / FILE_NAME

    def read(self) -> tuple[LatchState, str]:
        """The state, and the words written with it. A file that cannot be read is no permission."""
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            return LatchState(content["state"]), str(content["words"])
        except FileNotFoundError:
            return LatchState.NONE, ""
        except (OSError, ValueError, KeyError, TypeError):
            return LatchState.UNREADABLE, ""

    def refusal(self, *, unattended: bool) -> str | None:
        """Why this start may not fly, None when it may; a permission is taken, for this start alone.

        `unattended`: a service manager or a script started the app, not a person.

        Raises:
            ConfigError: there is a permission, and the latch cannot be written.
        """
        self._unattended = unattended
        state, words = self.read()
        if state is LatchState.PERMITTED and not _stale(words):
            self._permit = words
            self._taken = uuid.uuid4().hex
            self._write(LatchState.TAKEN, self._taken)
            return None
        return _refusal(state, words, unattended=unattended)

    def begin(self) -> None:
        """Begin a flight: all that it needs is there.

        Raises:
            ConfigError: the latch cannot be written: a flight whose begin nobody remembers is not flown; or
                another start has used the permission up since `refusal` was asked.
        """
        reason = None if self._is_ours() else _refusal(*self.read(), unattended=self._unattended)
        if reason is not None:
            raise ConfigError(f"{self.path}: another start has changed it meanwhile: {reason}")
        self._write(LatchState.BEGUN, "")
        self._begun, self._taken = True, None

    def end(self, words: str) -> None:
        """The flight has ended, and how; a start that began none gives the permission that it took back.

        Raises:
            ConfigError: the latch cannot be written.
        """
        if self._begun:
            self._write(LatchState.ENDED, words)
            self._begun = False
        elif self._is_ours():
            self._write(LatchState.PERMITTED, self._permit)
            self._taken = None

    def _is_ours(self) -> bool:
        """Whether the permission is the one that this start took."""
        return self._taken is not None and self.read() == (LatchState.TAKEN, self._taken)

    def permit(self) -> None:
        """Let the next start fly.

        Raises:
            ConfigError: the latch cannot be written.
        """
        self._write(LatchState.PERMITTED, f"{_boot_id()} {up_s():.0f}")

    def _write(self, state: LatchState, words: str) -> None:
        write_durably(self.path, json.dumps({"state": state.value, "words": words}))


def _refusal(state: LatchState, words: str, *, unattended: bool) -> str | None:
    if state is LatchState.PERMITTED:
        return f"{stale}; {PERMIT_HINT}" if (stale := _stale(words)) else None
    if state is LatchState.TAKEN:
        return f"a start took the permission, and has begun no flight; {PERMIT_HINT}"
    if state is LatchState.BEGUN:
        return f"the last flight was begun and never ended; {PERMIT_HINT}"
    if state is LatchState.UNREADABLE:
        return f"nobody knows how the last flight ended: {FILE_NAME} cannot be read; {PERMIT_HINT}"
    if unattended:
        ended = f" (the last one ended: {words})" if words else ""
        return f"not started at a terminal, and no flight is permitted{ended}; {PERMIT_HINT}"
    return None


def _stale(words: str) -> str:
    """Why the permission does not hold, by the boot and the uptime written with it; "" when it does."""
    boot, _, given_s = words.rpartition(" ")
    age_s = up_s() - float(given_s) if given_s.isdecimal() else -math.inf
    if boot != _boot_id() or age_s < -1.0:  # it is written in whole seconds
        return "the permission was given before the computer started anew"
    if age_s > PERMIT_S:
        return f"the permission is older than {PERMIT_S / 60.0:.0f} min"
    return ""


def _boot_id() -> str:
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return "unknown"


def state_folder() -> Path:
    """Where the latch is without `--record`: systemd's state directory, else the user's."""
    directory = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    if directory:
        return Path(directory)
    home = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(home) / "companion"


def unattended() -> bool:
    """Whether a service manager, a container or a script started this process: no person at a terminal."""
    return bool(os.environ.get("NOTIFY_SOCKET")) or sys.stdin is None or not sys.stdin.isatty()


# ---------------------------------------------------------------- companion permit

PERMIT_HELP: Final = """Let the next start of the app fly.

After a crash, a kill or a power cut, and whenever it is not started at a terminal, the app stays in standby
until this was said. It holds for one start, for an hour, and until the computer starts anew.
"""


def permit_command(
    record: Annotated[
        Path | None,
        typer.Option("--record", help="The folder that the app records to, if it does.", metavar="DIR"),
    ] = None,
) -> None:
    latch = FlightLatch(record or state_folder())
    state, words = latch.read()
    latch.permit()
    before = {
        LatchState.NONE: "no flight before",
        LatchState.PERMITTED: "permitted already",
        LatchState.TAKEN: "a start took the last permission, and has begun no flight",
        LatchState.BEGUN: "the last flight never ended",
        LatchState.ENDED: f"the last flight ended: {words}",
        LatchState.UNREADABLE: "the file could not be read",
    }[state]
    typer.echo(f"{latch.path}: the next start may fly ({before})")
