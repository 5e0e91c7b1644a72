"""Carries the mission's actions to the autopilot and the ground station, and brings the answers back.

Most go one after another. What makes safe (hold, land, disarm) overtakes everything: what is under way is
withdrawn and what waits is dropped, so that no late command takes the vehicle back. Asking the ground
station for the pad's position is nobody's turn to wait for and goes beside them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Final

from companion.base.messages import Action, ActionKind, ActionResult
from companion.link.actions.actions import VehicleActions

URGENT: Final = frozenset({ActionKind.HOLD, ActionKind.LAND, ActionKind.DISARM})


class Errands:
    """The actions waiting and under way. `told` hears each result once."""

    def __init__(self, actions: VehicleActions, told: Callable[[ActionResult], None]) -> None:
        self._actions, self._told = actions, told
        self._waiting: deque[Action] = deque()
        self._arrived = asyncio.Event()
        self._beside: set[asyncio.Task[None]] = set()
        self._under_way: ActionKind | None = None

    @property
    def busy(self) -> bool:
        """Whether anything is waiting or under way in the main line."""
        return self._under_way is not None or bool(self._waiting)

    def ask(self, action: Action) -> None:
        """Put an action in line, or in front of all others when it is urgent."""
        if action.kind is ActionKind.REQUEST_PAD_POSITION:
            task = asyncio.create_task(self._perform(action))
            self._beside.add(task)
            task.add_done_callback(self._beside.discard)
            return
        if action.kind in URGENT:
            self._waiting = deque(waiting for waiting in self._waiting if waiting.kind in URGENT)
            if self._under_way not in URGENT:
                self._actions.cancel()
        self._waiting.append(action)
        self._arrived.set()

    def void(self) -> None:
        """Drop what waits and withdraw what is under way: its purpose is gone."""
        self._waiting.clear()
        self._actions.cancel()

    async def run(self) -> None:
        """Work until cancelled."""
        try:
            while True:
                while self._waiting:
                    action = self._waiting.popleft()
                    self._under_way = action.kind
                    await self._perform(action)
                    self._under_way = None
                self._arrived.clear()
                await self._arrived.wait()
        finally:
            for task in self._beside:
                task.cancel()

    async def _perform(self, action: Action) -> None:
        self._told(await self._actions.perform(action))
