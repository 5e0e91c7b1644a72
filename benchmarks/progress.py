"""A bar on a terminal for what takes minutes; nothing in a pipe or a log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from rich.console import Console
from rich.progress import track

T = TypeVar("T")


def watched(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """The items, with a bar on standard error until all are done; `total` where they have no length."""
    console = Console(stderr=True)
    count = len(items) if total is None and isinstance(items, Sized) else total
    yield from track(
        items, what, total=count, console=console, transient=True, disable=not console.is_terminal
    )
