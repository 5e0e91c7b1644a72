"""The newest value of something, and a way to wait for the next.

A slow reader sees the newest value and never a queue of old ones.
"""

from __future__ import annotations

import asyncio
from typing import Generic, TypeVar

T = TypeVar("T")


class LatestValue(Generic[T]):
    """The newest value of one topic, and a way to wait for the next."""

    def __init__(self) -> None:
        self._value: T | None = None
        self._arrived = asyncio.Event()

    def put(self, value: T) -> None:
        """Replace the value and wake who waits."""
        self._value = value
        self._arrived.set()

    async def next(self) -> T:
        """Wait for a value that came after the last call, then return the newest. For one reader."""
        await self._arrived.wait()
        self._arrived.clear()
        assert self._value is not None
        return self._value
