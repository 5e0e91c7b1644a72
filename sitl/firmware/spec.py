"""Which firmware flies: PX4 or ArduPilot, and its program."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True)
class FirmwareSpec:
    """A SITL build: `px4` (build/px4_sitl_default/bin/px4) or `arducopter` (build/sitl/bin/arducopter)."""

    kind: AutopilotKind
    path: Path
    parameters: tuple[tuple[str, float], ...] = ()  # over those that make it fit the vehicle

    @classmethod
    def of(
        cls, kind: AutopilotKind | None, path: Path | None, parameters: Sequence[str] = ()
    ) -> FirmwareSpec | None:
        """From the command line's options (parameters as NAME=VALUE); None without any.

        Raises:
            ConfigError: one is given without the other, a parameter has another form, or the file is no
                program.
        """
        pairs = tuple(_pair(text) for text in parameters)
        if kind is None and path is None:
            if pairs:
                raise ConfigError("--firmware-param: expected it with --firmware and --firmware-path")
            return None
        if kind is None or path is None:
            raise ConfigError("--firmware and --firmware-path: expected both, or neither")
        if not path.is_file() or not os.access(path, os.X_OK):
            raise ConfigError(f"--firmware-path {path}: expected the program that a SITL build made")
        return cls(kind, path.resolve(), pairs)

    def as_json(self) -> dict[str, Any]:
        """What a model of it is made from."""
        return {"kind": self.kind, "path": str(self.path), "parameters": self.parameters}

    @property
    def options(self) -> tuple[str, ...]:
        """The command line's options that name it."""
        pairs = (f"--firmware-param={name}={number_text(value)}" for name, value in self.parameters)
        return ("--firmware", self.kind, "--firmware-path", str(self.path), *pairs)


def number_text(value: float) -> str:
    """A parameter's value with all its digits; firmwares read a whole number only without an exponent."""
    return str(int(value)) if value == int(value) else repr(value)


def _pair(text: str) -> tuple[str, float]:
    name, _, number = (part.strip() for part in text.partition("="))
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or not _NAME.fullmatch(name):
        raise ConfigError(f"--firmware-param {text}: expected NAME=VALUE, a number")
    return name, value
