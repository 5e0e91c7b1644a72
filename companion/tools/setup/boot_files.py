"""Editing config.txt and cmdline.txt of a Raspberry Pi's boot partition. Pure.

config.txt: `[section]` lines restrict what follows to a model; `dtoverlay=NAME,...` loads an overlay,
`dtparam=NAME=VALUE,...` sets a parameter, the last one counting. Source: Raspberry Pi
documentation, config.txt.
"""

import re
from typing import Final

_SECTION: Final = re.compile(r"^\[(.+)\]$")
EVERY_MODEL: Final = "all"
# the login console on a serial line; console=tty1, the screen's, stays
_SERIAL_CONSOLE: Final = re.compile(r"^console=(serial|ttyAMA|ttyS)\d+(,\S*)?$")


def active_lines(text: str, sections: frozenset[str]) -> list[str]:
    """The lines that count for a model: those of its `sections` and of every model, without comments."""
    lines, section = list[str](), EVERY_MODEL
    for line in text.splitlines():
        word = line.split("#", 1)[0].strip()
        if (found := _SECTION.match(word)) is not None:
            section = found[1].strip().lower()
        elif word and section in sections | {EVERY_MODEL}:
            lines.append(word)
    return lines


def has_overlay(text: str, sections: frozenset[str], name: str) -> bool:
    overlays = [
        line.partition("=")[2] for line in active_lines(text, sections) if line.startswith("dtoverlay=")
    ]
    return name in {overlay.split(",")[0].strip() for overlay in overlays}


def parameter(text: str, sections: frozenset[str], name: str) -> str | None:
    """The value of a device tree parameter; a name without a value is "on"."""
    value = None
    for line in active_lines(text, sections):
        if not line.startswith("dtparam="):
            continue
        for assignment in line.partition("=")[2].split(","):
            key, given, word = assignment.strip().partition("=")
            if key == name:
                value = word if given else "on"
    return value


def with_lines(text: str, comment: str, lines: tuple[str, ...]) -> str:
    """The file with lines for every model at its end, under a comment."""
    if text and not text.endswith("\n"):
        text += "\n"
    sections = [
        found[1].strip().lower() for line in text.splitlines() if (found := _SECTION.match(line.strip()))
    ]
    head = "" if sections[-1:] in ([], [EVERY_MODEL]) else f"[{EVERY_MODEL}]\n"
    return text + head + f"# companion: {comment}\n" + "".join(f"{line}\n" for line in lines)


def without_serial_console(text: str) -> str:
    """The kernel's command line without a console on a serial line."""
    words = [word for word in text.split() if not _SERIAL_CONSOLE.match(word)]
    return text if len(words) == len(text.split()) else " ".join(words) + "\n"
