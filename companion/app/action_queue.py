"""The queue of the mission's actions to the autopilot and the ground station.

Most are performed one after another. Hold, land and disarm overtake everything: the action under way is
cancelled and what waits is dropped, so that no late command undoes them. A request to the ground station for
the pad's position does not wait in the queue.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Final

from companion.base.messages import Action, ActionKind, ActionResult
from companion.link.actions.actions import VehicleActions

URGENT: Final = frozenset({ActionKind.HOLD, ActionKind.LAND, ActionKind.DISARM})


class ActionQueue:
    """The actions waiting and under way; `on_result` receives each result once."""

    def __init__(self, actions: VehicleActions, on_result: Callable[[ActionResult], None]) -> None:
        self._actions, self._on_result = actions, on_result
        self._waiting: deque[Action] = deque()
        self._arrived = asyncio.Event()
        self._beside: set[asyncio.Task[None]] = set()
        self._under_way: ActionKind | None = None

    @property
    def busy(self) -> bool:
        """Whether an action is waiting or under way."""
        return self._under_way is not None or bool(self._waiting)

    def add(self, action: Action) -> None:
        """Append an action; an urgent one goes before all others."""
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

    def clear(self) -> None:
        """Drop what waits and cancel what is under way."""
        self._waiting.clear()
        self._actions.cancel()

    async def run(self) -> None:
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
        self._on_result(await self._actions.perform(action))
