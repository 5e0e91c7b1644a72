"""The open requests to the autopilot: spacing, retries and giving up.

An action is sent once, again `retry_s` after a refusal or `answer_s` after silence, and `attempts` times at
most. Only arming is repeated until its phase times out, because an autopilot may not be ready to arm yet;
what it lacks is reported at each change. Pure: time is an argument.
"""

from dataclasses import dataclass, replace
from typing import Final

from companion.base.messages import Action, ActionKind, ActionResult

PATIENT: Final = frozenset({ActionKind.ARM})


@dataclass(frozen=True, slots=True)
class _Pending:
    action: Action
    due_s: float
    sent: int = 0
    answer_by_s: float = float("inf")
    why: str = ""


@dataclass(slots=True)
class _Fate:
    """What has become of a kind of request since `forget`."""

    awaited: int = 0  # so many answers are still to come
    granted: bool = False
    in_doubt: bool = False


class Requests:
    """The open requests, at most one of a kind."""

    def __init__(self, retry_s: float, answer_s: float, attempts: int) -> None:
        self._retry_s, self._answer_s, self._attempts = retry_s, answer_s, attempts
        self._pending: dict[ActionKind, _Pending] = {}
        self._fates: dict[ActionKind, _Fate] = {}  # of what has been sent since `forget`
        self._in_doubt_before: frozenset[ActionKind] = frozenset()
        self._reports: list[Action] = []
        self._news: list[str] = []

    @property
    def open(self) -> bool:
        """Whether any request waits for its answer or its next try."""
        return bool(self._pending)

    def ask(self, action: Action, now_s: float) -> None:
        """Open a request, unless one of its kind is open or has been granted since `forget`.

        One that may be carried out by force takes the place of one that may not.
        """
        pending = self._pending.get(action.kind)
        stronger = pending is not None and action.force and not pending.action.force
        if not self.granted(action.kind) and (pending is None or stronger):
            self._pending[action.kind] = _Pending(action, due_s=now_s)

    def tell(self, action: Action) -> None:
        self._reports.append(action)

    def forget(self) -> None:
        """Drop what is open and what was granted: a new phase asks anew."""
        self._in_doubt_before = frozenset(kind for kind in self._fates if self.in_doubt(kind))
        self._pending.clear()
        self._fates.clear()
        self._news.clear()

    def withdraw(self, kind: ActionKind) -> None:
        """Drop what is open of a kind and what was granted: its reason is gone."""
        if self.in_doubt(kind):
            self._in_doubt_before |= {kind}
        self._pending.pop(kind, None)
        self._fates.pop(kind, None)

    def granted(self, kind: ActionKind) -> bool:
        """Whether a request of this kind was accepted since `forget`."""
        return kind in self._fates and self._fates[kind].granted

    def in_doubt(self, kind: ActionKind) -> bool:
        """Whether a request of this kind may have left since `forget`, and was neither granted nor denied.

        Only the autopilot's own denial ends a doubt: a try that did not leave says nothing of one before it.
        """
        fate = self._fates.get(kind)
        return fate is not None and not fate.granted and (fate.in_doubt or fate.awaited > 0)

    def awaited(self, kind: ActionKind) -> bool:
        return kind in self._fates and self._fates[kind].awaited > 0

    @property
    def asked_last(self) -> frozenset[ActionKind]:
        """What is asked for or was granted since `forget`, and what may still be carried out of before."""
        may_be_done = {kind for kind in self._fates if self.granted(kind) or self.in_doubt(kind)}
        return self._in_doubt_before | may_be_done | self._pending.keys()

    def asked(self, kind: ActionKind) -> bool:
        """Whether a request of this kind has left since `forget`."""
        return kind in self._fates

    def hear(self, results: tuple[ActionResult, ...], now_s: float) -> tuple[str, ...]:
        """Take the answers in; returns why a request is given up, for each that is."""
        for result in results:
            open_request = self._pending.get(result.kind)
            if open_request is None or open_request.sent == 0:
                continue
            fate = self._fates[result.kind]
            fate.awaited = max(0, fate.awaited - 1)
            fate.granted |= result.accepted
            fate.in_doubt = fate.in_doubt if result.in_doubt is None else result.in_doubt
            if result.accepted:
                del self._pending[result.kind]
            else:
                self._put_off(open_request, now_s, result.text or "refused")
        return self._give_up(now_s)

    def news(self) -> tuple[str, ...]:
        """Why what is asked again and again is refused, once for each reason that differs from the last."""
        news = tuple(self._news)
        self._news.clear()
        return news

    def due(self, now_s: float) -> tuple[Action, ...]:
        ready = [p for p in self._pending.values() if p.due_s <= now_s]
        for p in ready:
            self._fates.setdefault(p.action.kind, _Fate()).awaited += 1
            self._pending[p.action.kind] = replace(
                p, due_s=float("inf"), sent=p.sent + 1, answer_by_s=now_s + self._answer_s
            )
        due = (*self._reports, *(p.action for p in ready))
        self._reports.clear()
        return due

    def _put_off(self, pending: _Pending, now_s: float, why: str) -> None:
        kind = pending.action.kind
        if kind in PATIENT and why != pending.why:
            self._news.append(f"{_words(kind)} refused: {why}; retry every {self._retry_s:g} s")
        self._pending[kind] = replace(pending, due_s=now_s + self._retry_s, answer_by_s=float("inf"), why=why)

    def _give_up(self, now_s: float) -> tuple[str, ...]:
        for pending in list(self._pending.values()):
            if pending.answer_by_s <= now_s:
                self._put_off(pending, now_s, "no answer")
        spent = [
            p
            for kind, p in self._pending.items()
            if kind not in PATIENT and p.sent >= self._attempts and p.due_s < float("inf")
        ]
        for pending in spent:
            del self._pending[pending.action.kind]
        return tuple(f"{_words(p.action.kind)} refused {p.sent} times: {p.why}" for p in spent)


def _words(kind: ActionKind) -> str:
    return kind.value.replace("_", " ")
