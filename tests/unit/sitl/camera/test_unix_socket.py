"""Sockets at a path: whose they are, and what is in the way."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest

from companion.config import ConfigError
from sitl.devices.socket_servers import MOST_PATH_BYTES, UnixServer


async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.close()


async def test_one_that_is_served_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "camera"
    first = await UnixServer.start(silent, path)
    before = path.stat().st_ino
    with pytest.raises(ConfigError, match="another simulator serves there; expected a folder of its own"):
        await UnixServer.start(silent, path)
    assert path.stat().st_ino == before
    first.close()
    assert not path.exists()


async def test_one_that_was_left_behind_is_replaced_and_anothers_is_not_removed(tmp_path: Path) -> None:
    path = tmp_path / "camera"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    server = await UnixServer.start(silent, path)
    path.rename(tmp_path / "mine")  # whose number is not given to another meanwhile
    path.write_text("somebody else's")
    server.close()
    assert path.read_text() == "somebody else's"


async def test_what_is_in_the_way_is_reported(tmp_path: Path) -> None:
    (tmp_path / "camera").write_text("a file")
    with pytest.raises(ConfigError, match="is in the way of a socket"):
        await UnixServer.start(silent, tmp_path / "camera")
    with pytest.raises(ConfigError, match="too long for a socket"):
        await UnixServer.start(silent, tmp_path / ("x" * MOST_PATH_BYTES))
    with pytest.raises(ConfigError, match="No such file or directory; expected a folder"):
        await UnixServer.start(silent, tmp_path / "nowhere" / "camera")
