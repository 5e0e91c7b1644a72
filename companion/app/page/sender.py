"""A thread that sends to the page's process: the newest of each kind, so it never lags and never grows."""

import threading
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Final

from companion.app.page.look import Look, Reply, Start, Text

MOST_REPLIES: Final = 32


class Sender:
    """`put` takes a reference and returns; pickling and writing happen in the thread."""

    def __init__(self, pipe: Connection, start: Start) -> None:
        """Send `start` first. The pipe is closed when the thread ends."""
        self._pipe = pipe
        self._newest: dict[str, Look | Text | Start] = {"": start}
        self._replies: deque[Reply] = deque(maxlen=MOST_REPLIES)
        self._ends = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="live page", daemon=True)
        self._thread.start()

    def put(self, message: Look | Text | Reply) -> None:
        """Hand over; a message of the same kind that still waits is dropped, but no reply."""
        with self._changed:
            if isinstance(message, Reply):
                self._replies.append(message)
            else:
                self._newest[message.kind if isinstance(message, Text) else "look"] = message
            self._changed.notify()

    def end(self) -> None:
        """Stop, without waiting: a process that does not read holds the thread until it is gone."""
        with self._changed:
            self._ends = True
            self._changed.notify()

    def _run(self) -> None:
        with suppress(OSError), self._pipe:
            while (messages := self._wait()) is not None:
                for message in messages:
                    self._pipe.send(message)

    def _wait(self) -> list[Look | Text | Start | Reply] | None:
        with self._changed:
            while not (self._newest or self._replies or self._ends):
                self._changed.wait()
            if self._ends:
                return None
            messages = [*self._newest.values(), *self._replies]
            self._newest.clear()
            self._replies.clear()
            return messages
