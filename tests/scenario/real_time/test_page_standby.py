"""The service in standby, looked at: what a viewer is told, and what becomes of an order on the ground."""

import asyncio
import json
import signal
from pathlib import Path
from typing import Any, Final

import aiohttp
import yaml

from tests.scenario.flying import started, wait_for_line
from tests.scenario.real_time.test_real_time import simulated

TOKEN: Final = "the token of a test, long enough"
PATIENCE_S: Final = 30.0


class BrowserEnd:
    """What a browser keeps: the newest JSON of each kind, and how many pictures came."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket, self.heard, self.pictures = socket, dict[str, Any](), 0

    async def until(self, kind: str) -> Any:
        """The next JSON of a kind."""
        self.heard.pop(kind, None)
        async with asyncio.timeout(PATIENCE_S):
            while kind not in self.heard:
                message = await self.socket.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
                    self.pictures += 1
                else:
                    said = json.loads(message.data)
                    self.heard[said["kind"]] = said
        return self.heard[kind]


async def look(url: str) -> None:
    origin = url.rstrip("/")
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{url}live", headers={"Origin": origin}) as socket,
    ):
        viewer = BrowserEnd(socket)
        await viewer.until("token")
        await socket.send_json({"token": TOKEN})
        assert (await viewer.until("hello"))["commands"]
        assert len((await viewer.until("track"))["rows"]) > 1  # of the time before anybody looked
        while (state := await viewer.until("state"))["autopilot"] is None:
            pass
        assert (state["phase"], state["viewers"]) == ("standby", 1)
        assert [phase for _, phase in state["phases"]] == ["standby"]
        assert {entry["name"] for entry in state["inputs"]} >= {"IMU"}
        for kind, outcome, reason in (
            ("land", "temporarily_rejected", "not armed"),
            ("stop", "temporarily_rejected", "nothing to stop"),
        ):
            await socket.send_json({"order": kind})
            reply = await viewer.until("reply")
            assert (reply["order"], reply["outcome"]) == (kind, outcome)
            assert reason in reply["text"]
        assert viewer.pictures > 0


def test_a_service_in_standby_is_looked_at_and_refuses_what_companion_order_is_refused(
    tmp_path: Path,
) -> None:
    simulator, settings = simulated(tmp_path)
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    serve = {"address": "127.0.0.1:0", "token_file": str(token), "allow_commands": True}
    settings.write_text(yaml.safe_dump(yaml.safe_load(settings.read_text()) | {"serve": serve}))
    variables = {"RUNTIME_DIRECTORY": str(tmp_path / "run")}
    with simulator, started("--no-ui", "--config", settings, variables=variables) as process:
        url = wait_for_line(process, "live page at ").rpartition(" ")[2].strip()
        asyncio.run(look(url))
        process.send_signal(signal.SIGTERM)
        words, errors = process.communicate(timeout=PATIENCE_S)
        simulator.communicate("finish landed\n", timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert "order to land by the live page refused: the vehicle is not armed" in words
    assert TOKEN not in words
