"""Performing an action: from its handler to a result, and the end at once of one whose purpose is void."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Final

from companion.base.clock import Clock
from companion.base.messages import Action, ActionResult
from companion.link.commands import WITHDRAWN
from companion.link.session import Session

Handler = Callable[[Action], Coroutine[Any, Any, None]]

_WORDS_S: Final = 0.2  # a refusal's reason comes as a text of its own, before or after it


class Refused(Exception):  # noqa: N818 - it reads as what happened
    """An action came to nothing; the text says why."""


class Unanswered(Refused):
    """Nothing was heard of it, so that it may have been carried out or not."""


class Performances:
    """The actions under way."""

    def __init__(self, session: Session, clock: Clock) -> None:
        self._session = session
        self._clock = clock
        self._under_way: list[asyncio.Task[ActionResult]] = []

    async def perform(self, handler: Handler, action: Action) -> ActionResult:
        """Run a handler and report how it went; "withdrawn" after `cancel`, whatever it was at."""
        work = asyncio.create_task(self._result(handler, action))
        self._under_way.append(work)
        try:
            await asyncio.wait((work,))
        finally:
            self._under_way.remove(work)
            work.cancel()  # when it is we who are cancelled; nothing once it is done
        if work.cancelled():
            return ActionResult(self._clock.now_s(), action.kind, accepted=False, text=WITHDRAWN)
        return work.result()

    def cancel(self) -> None:
        for work in self._under_way:
            work.cancel()

    async def _result(self, handler: Handler, action: Action) -> ActionResult:
        """How a handler ends; a refusal carries the autopilot's text of that time."""
        session, clock = self._session, self._clock
        heard_before = session.texts_heard
        try:
            await handler(action)
        except Refused as refusal:
            await clock.sleep_until(clock.now_s() + _WORDS_S)
            count = session.texts_heard - heard_before
            words = session.state.texts[-count:] if count > 0 else ()
            text = "; ".join((str(refusal), *words))
            return ActionResult(clock.now_s(), action.kind, accepted=False, text=text)
        return ActionResult(clock.now_s(), action.kind, accepted=True)
