"""Ways to spoil bytes, text and trees of settings; all from the generator that is handed in."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable
from typing import Any, Final

_BYTES: Final = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)
_LONGEST_REPEAT: Final = 40
_HUGE: Final = 1e300
# what a person, an editor or a disk makes of a settings file
_WORDS: Final = (
    *("nan", ".nan", ".inf", "-.inf", "1e400", "-1", "0", "1e-320", "true", "no", "~", "null", "''"),
    *("[]", "{}", "[1, 2]", "{a: 1}", "- x", "!!python/object:os.system {}", "&a [*a]", "&b {b: *b}"),
    *("2026-01-01", "0x1F", "1_000", "12:30:45", "9" * 60, "\t", ": ", "\n", "\x00", "\ufeff", "\u2028", "é"),
    *("? [a, b]", "!!binary x", "!!set {a}", "<<: 1", "---\n", "...\n", "%YAML 3.0\n", "@", "`", "|", ">"),
)
_VALUES: Final[tuple[Any, ...]] = (
    *(None, True, False, 0, -1, 1, 1e308, -1e308, float("nan"), float("inf"), 10**400, "", "x", "nan", "1"),
    *([], {}, [1], [[1]], {"a": 1}, [None] * 4, "é\x00", b"x", (1, 2), {1: 2}, {None: 1}, [{}], "x" * 300),
)


def spoiled(rng: random.Random, data: bytes) -> bytes:
    """Bytes with one to four changes: bits, bytes, pieces lost, doubled, put in or cut off."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        _BYTE_CHANGES[rng.randrange(len(_BYTE_CHANGES))](rng, out)
    return bytes(out)


def _flip(rng: random.Random, out: bytearray) -> None:
    if out:
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)


def _set(rng: random.Random, out: bytearray) -> None:
    if out:
        out[rng.randrange(len(out))] = rng.choice(_BYTES)


def _cut(rng: random.Random, out: bytearray) -> None:
    start, end = _piece(rng, out)
    del out[start:end]


def _double(rng: random.Random, out: bytearray) -> None:
    start, end = _piece(rng, out)
    out[start:start] = out[start:end]


def _insert(rng: random.Random, out: bytearray) -> None:
    at = rng.randint(0, len(out))
    out[at:at] = rng.randbytes(rng.randint(1, 20))


def _repeat(rng: random.Random, out: bytearray) -> None:
    at = rng.randint(0, len(out))
    out[at:at] = bytes((rng.choice(_BYTES),)) * rng.randint(1, _LONGEST_REPEAT)


def _truncate(rng: random.Random, out: bytearray) -> None:
    del out[rng.randint(0, len(out)) :]


def _piece(rng: random.Random, out: bytearray) -> tuple[int, int]:
    start = rng.randint(0, len(out))
    return start, min(len(out), start + rng.randint(1, 20))


_BYTE_CHANGES: Final[tuple[Callable[[random.Random, bytearray], None], ...]] = (
    *(_flip, _flip, _set, _set, _cut, _double, _insert, _repeat, _truncate),
)


def spoiled_text(rng: random.Random, text: str) -> bytes:
    """A settings file's text with words and lines changed; now and then bytes that are no text."""
    if rng.random() < 0.2:
        return spoiled(rng, text.encode())
    lines = text.split("\n")
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(lines))
        match rng.randrange(6):
            case 0:
                lines.insert(at, lines[rng.randrange(len(lines))])
            case 1 if len(lines) > 1:
                del lines[at]
            case 2:
                lines[at] = " " * rng.randint(0, 6) + lines[at].strip()
            case 3:
                lines[at] = lines[at].partition(":")[0] + ": " + rng.choice(_WORDS)
            case 4:
                cut = rng.randint(0, len(lines[at]))
                lines[at] = lines[at][:cut] + rng.choice(_WORDS) + lines[at][cut:]
            case _:
                lines[at] = rng.choice(_WORDS)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def spoiled_tree(rng: random.Random, tree: Any) -> Any:
    """A tree of settings with one to three of its values or keys others."""
    spoilt = copy.deepcopy(tree)
    for _ in range(rng.randint(1, 3)):
        holder, key = _place(rng, spoilt)
        if holder is None:
            return rng.choice(_VALUES)
        match rng.randrange(4):
            case 0 if isinstance(holder, dict):
                holder[rng.choice(("x", "", 1, None, True, 1.5, (1, 2)))] = holder.pop(key)
            case 1:
                holder[key] = [copy.deepcopy(holder[key])] * rng.randint(0, 3)
            case 2 if isinstance(holder[key], int | float) and abs(holder[key]) < _HUGE:
                holder[key] = holder[key] * rng.choice((-1, 0, 10, 1e6, 1e-6, 0.5, 2))
            case _:
                holder[key] = copy.deepcopy(rng.choice(_VALUES))
    return spoilt


def _place(rng: random.Random, tree: Any) -> tuple[Any, Any]:
    """A value somewhere in a tree: what holds it, and under which key."""
    holder, key, here = None, None, tree
    while isinstance(here, dict | list) and here and (holder is None or rng.random() < 0.7):
        holder = here
        key = rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
        here = here[key]
    return holder, key
