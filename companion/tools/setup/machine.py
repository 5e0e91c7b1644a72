"""The computer that is set up: what it is, its files, and the programs that change it.

Files are below `root`, which is "/" but in tests. A file is kept as it was under NAME.before-companion before
its first change.
"""

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from companion.base.files import write_atomically

BEFORE: Final = ".before-companion"
PATIENCE_S: Final = 900.0  # packages, over a slow network
NOT_FOUND: Final = 127


@dataclass(frozen=True, slots=True)
class Model:
    """A family of Raspberry Pis: the sections of config.txt that count for it, and its UARTs' switches.

    A UART that it does not have is None.
    """

    name: str
    sections: frozenset[str]
    gps: str | None
    autopilot: str | None
    rangefinder: str | None


# docs/how-to/wiring.md has the pins; the words are those of /proc/device-tree/model
MODELS: Final = {
    ("Raspberry Pi 5", "Compute Module 5", "Raspberry Pi 500"): Model(
        "Pi 5",
        frozenset({"pi5", "pi500", "cm5"}),
        "dtparam=uart0=on",
        "dtoverlay=uart2-pi5",
        "dtoverlay=uart4-pi5",
    ),
    ("Raspberry Pi 4", "Compute Module 4", "Raspberry Pi 400"): Model(
        "Pi 4",
        frozenset({"pi4", "pi400", "cm4", "cm4s"}),
        "dtoverlay=disable-bt",
        "dtoverlay=uart3",
        "dtoverlay=uart5",
    ),
    ("Raspberry Pi 3", "Compute Module 3", "Raspberry Pi Zero 2"): Model(
        "Pi 3", frozenset({"pi3", "pi3+", "pi02", "cm3"}), "dtoverlay=disable-bt", None, None
    ),
}


def run_program(words: tuple[str, ...]) -> tuple[int, str]:
    """Exit code and output of a program; 127 when there is none."""
    if shutil.which(words[0]) is None:
        return NOT_FOUND, f"no {words[0]}"
    try:
        done = subprocess.run(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return NOT_FOUND, str(error)
    return done.returncode, done.stdout


@dataclass(frozen=True, slots=True)
class Machine:
    """`run` starts a program; `has_module` tells whether this Python has a module; `user` ran sudo."""

    root: Path = Path("/")
    run: Callable[[tuple[str, ...]], tuple[int, str]] = run_program
    has_module: Callable[[str], bool] = lambda name: find_spec(name) is not None
    user: str | None = None

    def path(self, name: str) -> Path:
        return self.root / name.lstrip("/")

    def read(self, name: str) -> str | None:
        """A file's text; None when there is none."""
        try:
            return self.path(name).read_text(encoding="utf-8", errors="surrogateescape").rstrip("\0")
        except OSError:
            return None

    def write(self, name: str, text: str) -> None:
        """Replace a file, keeping the first one."""
        path = self.path(name)
        if path.exists() and not (kept := path.with_name(path.name + BEFORE)).exists():
            shutil.copyfile(path, kept)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode("utf-8", errors="surrogateescape"))

    @property
    def model(self) -> Model | None:
        """Which Raspberry Pi it is; None: none that is known."""
        words = self.read("/proc/device-tree/model") or ""
        return next((model for names, model in MODELS.items() if any(name in words for name in names)), None)

    @property
    def no_model(self) -> str:
        words = (self.read("/proc/device-tree/model") or "").strip()
        return f"not known here: {words}" if "Raspberry Pi" in words else "not a Raspberry Pi"

    def boot_file(self, name: str) -> str:
        """A file of the boot partition, where this system has that."""
        return f"/boot/firmware/{name}" if self.path("/boot/firmware").is_dir() else f"/boot/{name}"

    def group_members(self) -> dict[str, set[str]]:
        """Who is in which group, by /etc/group."""
        lines = [line.split(":") for line in (self.read("/etc/group") or "").splitlines()]
        return {line[0]: set(filter(None, line[3].split(","))) for line in lines if len(line) == 4}
