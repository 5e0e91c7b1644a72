"""What the page gives to keep: the flights' logs as zip files, and the settings to read.

Whoever asks shows the token, where there is one, as a bearer's (RFC 6750). Nothing is changed from here.
"""

import asyncio
import tempfile
import zipfile
from pathlib import Path
from typing import IO, Any, Final

from aiohttp import web

from companion.app.page.access import same_token
from companion.app.page.look import Start
from companion.flightlog.flights import numbered_flights

MEGABYTE: Final = 1e6
_PIECE: Final = 256 * 1024


def add_file_routes(app: web.Application, start: Start) -> None:
    """`/flights`, `/flights/NAME` and `/settings`."""

    async def flights(request: web.Request) -> web.Response:
        _let_in(request, start)
        return web.json_response(await asyncio.to_thread(listed, start.flights))

    async def flight(request: web.Request) -> web.StreamResponse:
        _let_in(request, start)
        folder = next((f for f in _folders(start.flights) if f.name == request.match_info["name"]), None)
        if folder is None:
            raise web.HTTPNotFound(text="no such flight\n")
        with tempfile.TemporaryFile() as packed:
            await asyncio.to_thread(pack, folder, packed)
            return await _sent(request, packed, f"{folder.name}.zip")

    async def settings(request: web.Request) -> web.Response:
        _let_in(request, start)
        return web.Response(text=start.settings_text)

    app.add_routes(
        [
            web.get("/flights", flights),
            web.get("/flights/{name}", flight),
            web.get("/settings", settings),
        ]
    )


def listed(root: Path | None) -> list[dict[str, Any]]:
    """The flights, newest first, with their sizes."""
    return [
        {
            "name": folder.name,
            "megabytes": sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / MEGABYTE,
        }
        for folder in reversed(_folders(root))
    ]


def pack(folder: Path, packed: IO[bytes]) -> None:
    """All of a flight's folder as `companion logs export` has it; the log is compressed already."""
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(path, Path(folder.name) / path.relative_to(folder))


async def _sent(request: web.Request, packed: IO[bytes], name: str) -> web.StreamResponse:
    size = packed.tell()
    packed.seek(0)
    answer = web.StreamResponse(
        headers={
            "Content-Type": "application/zip",
            "Content-Length": str(size),
            "Content-Disposition": f'attachment; filename="{name}"',
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
        }
    )
    await answer.prepare(request)
    while piece := await asyncio.to_thread(packed.read, _PIECE):
        await answer.write(piece)
    await answer.write_eof()
    return answer


def _folders(root: Path | None) -> list[Path]:
    return [] if root is None else list(numbered_flights(root))


def _let_in(request: web.Request, start: Start) -> None:
    """See that the token is shown.

    Raises:
        HTTPForbidden: it is not.
    """
    kind, _, given = request.headers.get("Authorization", "").partition(" ")
    if start.token is not None and not (kind == "Bearer" and same_token(given, start.token)):
        raise web.HTTPForbidden(text="needs the token\n")
