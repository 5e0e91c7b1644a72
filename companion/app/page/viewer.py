"""One viewer: the newest of each kind waits for it, and nothing queues."""

import asyncio
from collections import deque
from typing import Final

from aiohttp import web

from companion.base.clock import Clock

# Pictures under way: of two, a busy browser's second waits behind the first and is older by a fifth. A slow
# line or phone gets fewer, not older ones.
MOST_UNDER_WAY: Final = 1
MOST_REPLIES: Final = 8
# whoever takes nothing for so long has gone
SENDING_S: Final = 10.0
# a browser tells of each picture that it has drawn, and of what a finger does
MOST_MESSAGES_A_S: Final = 40.0
BURST: Final = 80.0


class Viewer:
    """Takes what is offered and sends what its browser can take."""

    def __init__(self, socket: web.WebSocketResponse, clock: Clock) -> None:
        self._socket, self._clock = socket, clock
        self._picture: tuple[int, bytes] | None = None
        self._texts: dict[str, str] = {}
        self._replies: deque[str] = deque(maxlen=MOST_REPLIES)
        self._under_way: deque[int] = deque()
        self._changed = asyncio.Event()
        self._allowance, self._counted_s = BURST, clock.now_s()
        self.unanswered: set[str] = set()  # kinds of orders that wait for their first answer

    def offer_picture(self, number: int, data: bytes) -> None:
        """A new picture, in place of one that still waits."""
        self._picture = (number, data)
        self._changed.set()

    def offer(self, kind: str, text: str) -> None:
        """JSON, in place of what still waits of its kind."""
        self._texts[kind] = text
        self._changed.set()

    def reply(self, text: str) -> None:
        """An answer to this viewer's order."""
        self._replies.append(text)
        self._changed.set()

    def drawn(self, number: int) -> None:
        """It has drawn a picture, and therefore is done with those before."""
        while self._under_way and self._under_way[0] <= number:
            self._under_way.popleft()
        self._changed.set()

    def may_speak(self) -> bool:
        """Count a message of its; False when it sends more than any browser would."""
        now_s = self._clock.now_s()
        self._allowance = min(BURST, self._allowance + MOST_MESSAGES_A_S * (now_s - self._counted_s)) - 1.0
        self._counted_s = now_s
        return self._allowance >= 0.0

    async def send(self) -> None:
        """Send until the connection ends.

        Raises:
            TimeoutError: it takes nothing any more.
            OSError: it has gone.
        """
        while True:
            await self._changed.wait()
            self._changed.clear()
            texts = [*self._replies, *self._texts.values()]
            self._replies.clear()
            self._texts.clear()
            async with asyncio.timeout(SENDING_S):
                for text in texts:
                    await self._socket.send_str(text)
                if self._picture is not None and len(self._under_way) < MOST_UNDER_WAY:
                    (number, data), self._picture = self._picture, None
                    self._under_way.append(number)
                    await self._socket.send_bytes(data)
