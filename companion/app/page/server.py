"""The page's server: its files, a WebSocket for what is live, the flights' logs and the settings.

Whoever has not shown the token takes no viewer's place, and keeps no connection from anybody: the oldest of
them makes room for a new one.
"""

import asyncio
import json
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any, Final

from aiohttp import WSCloseCode, WSMsgType, web

from companion.app.page.access import host_is_ours, own_names, same_origin, same_token
from companion.app.page.look import Reply, Start, Text
from companion.base.clock import Clock
from companion.flightlog.flights import numbered_flights, pack, size_bytes

# ---------------------------------------------------------------- what is given to keep
# The flights' logs as zip files, and the settings to read. Whoever asks shows the token, where there is one,
# as a bearer's (RFC 6750). Nothing is changed from here.

MEGABYTE: Final = 1e6


def add_file_routes(app: web.Application, start: Start) -> None:
    async def flights(request: web.Request) -> web.Response:
        _let_in(request, start)
        return web.json_response(await asyncio.to_thread(listed, start.flights))

    async def flight(request: web.Request) -> web.StreamResponse:
        _let_in(request, start)
        folder = next((f for f in _folders(start.flights) if f.name == request.match_info["name"]), None)
        if folder is None:
            raise web.HTTPNotFound(text="no such flight\n")
        headers = {**HEADERS, "Content-Disposition": f'attachment; filename="{folder.name}.zip"'}
        answer = web.StreamResponse(headers=headers)
        answer.content_type = "application/zip"
        await answer.prepare(request)
        pieces = pack(folder)  # as it is taken: a copy of each download would fill the card that we record to
        try:
            while (piece := await asyncio.to_thread(next, pieces, None)) is not None:
                async with asyncio.timeout(SENDING_S):
                    await answer.write(piece)
        except (OSError, TimeoutError):
            # it takes nothing, or the flight has gone: what came must not look whole
            if request.transport is not None:
                request.transport.abort()
        return answer

    async def settings(request: web.Request) -> web.Response:
        _let_in(request, start)
        return web.Response(text=start.settings_text)

    app.add_routes(
        [web.get("/flights", flights), web.get("/flights/{name}", flight), web.get("/settings", settings)]
    )


def listed(root: Path | None) -> list[dict[str, Any]]:
    """The flights, newest first, with their sizes."""
    return [
        {"name": folder.name, "megabytes": size_bytes(folder) / MEGABYTE}
        for folder in reversed(_folders(root))
    ]


def _folders(root: Path | None) -> list[Path]:
    return [] if root is None else numbered_flights(root)


def _let_in(request: web.Request, start: Start) -> None:
    """See that the token is shown.

    Raises:
        HTTPForbidden: it is not.
    """
    kind, _, given = request.headers.get("Authorization", "").partition(" ")
    if (token := start.access.token) is not None and not (kind == "Bearer" and same_token(given, token)):
        raise web.HTTPForbidden(text="needs the token\n")


# ---------------------------------------------------------------- one viewer

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


STATIC: Final = Path(__file__).parent / "static"
WAITING: Final = Path(__file__).parent / "wait.html"
FILES: Final = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/plots.js": ("plots.js", "text/javascript"),
    "/lamps.js": ("lamps.js", "text/javascript"),
    "/alert.js": ("alert.js", "text/javascript"),
    "/files.js": ("files.js", "text/javascript"),
    "/picture.js": ("picture.js", "text/javascript"),
}
LONGEST_MESSAGE: Final = 1024
MOST_CONNECTIONS: Final = 64
TOKEN_S: Final = 5.0
WRONG_TOKEN_S: Final = 1.0
HEARTBEAT_S: Final = 5.0
# WebSocket close codes of our own
WRONG_TOKEN: Final = 4401
TOO_MANY: Final = 4429
HEADERS: Final = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "Server": "companion",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
    "connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

Say = Callable[[dict[str, Any]], None]
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class PageServer:
    """Serves the page; `say` tells the app's process how many look, and what is ordered."""

    def __init__(self, start: Start, say: Say) -> None:
        self._start, self._say, self._clock = start, say, Clock()
        self._names = own_names(start.serve.host_names)
        self._viewers: set[Viewer] = set()
        self._admitted: set[web.RequestHandler] = set()  # the viewers' connections
        self._orders: dict[int, Viewer] = {}
        self._ordered = 0
        self._contents = {path: (STATIC / name).read_bytes() for path, (name, _) in FILES.items()}
        self._waiting_page = WAITING.read_text("utf-8")

    def application(self) -> web.Application:
        app = web.Application(middlewares=[self._guarded], client_max_size=LONGEST_MESSAGE)
        app.add_routes([web.get(path, self._file) for path in FILES])
        app.router.add_get("/live", self._live)
        app.router.add_get("/wait.html", self._waiting)
        add_file_routes(app, self._start)
        return app

    def make_room(self, connections: Sequence[web.RequestHandler]) -> bool:
        """Whether there is room for one more connection beside these, oldest first.

        The oldest that are no viewer's are closed for it; of a burst some may be open for a moment.
        """
        living = [c for c in connections if c.transport is not None and not c.transport.is_closing()]
        strangers = [c.transport for c in living if c not in self._admitted]
        too_many = max(0, len(living) + 1 - MOST_CONNECTIONS)
        for transport in strangers[:too_many]:
            if transport is not None:
                transport.abort()
        return too_many <= len(strangers)

    # ------------------------------------------------------------ what the app's process sends

    def picture(self, number: int, data: bytes) -> None:
        for viewer in self._viewers:
            viewer.offer_picture(number, data)

    def text(self, text: Text) -> None:
        for viewer in self._viewers:
            viewer.offer(text.kind, text.json)

    def reply(self, reply: Reply) -> None:
        """For the one who gave the order."""
        last = reply.outcome != "in_progress"
        viewer = self._orders.pop(reply.number, None) if last else self._orders.get(reply.number)
        if viewer is not None:
            viewer.unanswered.discard(reply.kind)
            answer = {"kind": "reply", "order": reply.kind, "outcome": reply.outcome, "text": reply.text}
            viewer.reply(json.dumps(answer))

    # ------------------------------------------------------------ requests

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer only who calls us by our address, and tell browsers what the page may do."""
        if not host_is_ours(request.headers.get("Host"), self._names):
            return web.Response(status=421, text="this is not the host that you asked for\n")
        response = await handler(request)
        if not response.prepared:
            response.headers.update(HEADERS)
            response.headers["Content-Security-Policy"] = POLICY.format(host=request.headers["Host"])
        return response

    async def _file(self, request: web.Request) -> web.Response:
        return web.Response(
            body=self._contents[request.path], content_type=FILES[request.path][1], charset="utf-8"
        )

    async def _waiting(self, request: web.Request) -> web.Response:
        """A file to keep: opened before we run, it waits for us, where a browser shows its own error."""
        host = request.headers["Host"]  # one of ours, see _guarded
        text = self._waiting_page.replace("@ADDRESS@", escape(f"{request.scheme}://{host}/"))
        response = web.Response(text=text, content_type="text/html")
        response.headers["Content-Disposition"] = "attachment; filename=companion.html"
        return response

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if not same_origin(request.headers.get("Origin"), request.headers.get("Host")):
            return web.Response(status=403, text="opened by a page from elsewhere\n")
        socket = web.WebSocketResponse(max_msg_size=LONGEST_MESSAGE, heartbeat=HEARTBEAT_S, compress=False)
        await socket.prepare(request)
        if not await self._shows_token(socket):
            await socket.close(code=WRONG_TOKEN, message=b"wrong token")
        elif len(self._viewers) >= self._start.serve.most_viewers:
            await socket.close(code=TOO_MANY, message=b"too many viewers")
        else:
            self._admitted.add(request.protocol)
            try:
                await self._show(socket)
            finally:
                self._admitted.discard(request.protocol)
        return socket

    async def _shows_token(self, socket: web.WebSocketResponse) -> bool:
        """Whether its first message is the token, where there is one."""
        token = self._start.access.token
        if token is None:
            return True
        with suppress(TimeoutError, TypeError, ValueError, RecursionError):
            await socket.send_str('{"kind": "token"}')
            first = json.loads(await socket.receive_str(timeout=TOKEN_S))
            if isinstance(first, dict) and same_token(first.get("token"), token):
                return True
            await asyncio.sleep(WRONG_TOKEN_S)
        return False

    async def _show(self, socket: web.WebSocketResponse) -> None:
        viewer = Viewer(socket, self._clock)
        viewer.offer("hello", json.dumps({"kind": "hello", "commands": self._start.serve.allow_commands}))
        self._viewers.add(viewer)
        self._say({"viewers": len(self._viewers)})
        sending = asyncio.create_task(self._send(viewer, socket))
        try:
            await self._receive(viewer, socket)
        finally:
            sending.cancel()
            self._viewers.discard(viewer)
            self._orders = {number: who for number, who in self._orders.items() if who is not viewer}
            self._say({"viewers": len(self._viewers)})

    async def _send(self, viewer: Viewer, socket: web.WebSocketResponse) -> None:
        with suppress(OSError, TimeoutError):
            await viewer.send()
        # a browser that takes nothing does not take a farewell either
        if (transport := socket.get_extra_info("transport")) is not None:
            transport.abort()

    async def _receive(self, viewer: Viewer, socket: web.WebSocketResponse) -> None:
        """Take what the browser says until it goes, or says what no page of ours does."""
        async for message in socket:
            understood = message.type is WSMsgType.TEXT and viewer.may_speak()
            if not (understood and self._take(viewer, message.data)):
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"not understood")
                return

    def _take(self, viewer: Viewer, text: str) -> bool:
        """One message; whether it is one of ours."""
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            return False
        match message:
            case {"drawn": int(number)}:
                viewer.drawn(number)
            case {"order": "land" | "stop" as kind}:
                self._order(viewer, kind)
            case _:
                return False
        return True

    def _order(self, viewer: Viewer, kind: str) -> None:
        """Hand an order on, but no second one of a kind before the first has an answer."""
        if kind in viewer.unanswered:
            return
        viewer.unanswered.add(kind)
        self._ordered += 1
        self._orders[self._ordered] = viewer
        self._say({"order": kind, "number": self._ordered})
