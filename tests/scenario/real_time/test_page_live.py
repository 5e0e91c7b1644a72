"""A landing watched in a browser: what it shows on a phone and on a desk, and what its buttons do."""

import asyncio
import re
from pathlib import Path
from typing import Any, Final

import pytest
import yaml

from tests.browser import DESK, PHONE, Tab, browser, program
from tests.scenario.flying import COMMAND, ROOT, environment
from tests.scenario.real_time.quiet_machine import wait_for_quiet

TOKEN: Final = "the token of a test, long enough"
PATIENCE_S: Final = 60.0
# text of different elements that is drawn over one another, and what runs out of the window to the side
OVERPRINT: Final = """(() => {
  const shown = (e) => { const r = e.getBoundingClientRect(); return r.width > 0 && r.height > 0; };
  const layered = (e) => e.closest("#orders, header, #blind");
  const leaves = [...document.querySelectorAll("body *")].filter((e) => shown(e) && !layered(e)
    && [...e.childNodes].some((n) => n.nodeType === Node.TEXT_NODE && n.textContent.trim()));
  const boxes = leaves.map((e) => {
    const range = document.createRange(); range.selectNodeContents(e);
    const { left, right, top, bottom } = range.getBoundingClientRect();
    const list = e.closest("#news"), end = list ? list.getBoundingClientRect().bottom : bottom;
    return [e, { left, right, top, bottom: Math.min(bottom, end) }];  // what is scrolled away is not seen
  });
  const found = [];
  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
    const across = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const down = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    const over = across > 1 && down > 3 && !a.contains(b) && !b.contains(a);
    if (over) found.push(a.textContent + " | " + b.textContent);
  }));
  const wide = boxes.filter(([e, r]) => r.right > innerWidth + 1);
  return [...found, ...wide.map(([e]) => e.textContent)];
})()"""
SIDEWAYS: Final = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


@pytest.fixture(autouse=True)
def a_browser_on_a_machine_with_time_to_spare() -> None:
    if program() is None:
        pytest.skip("Chromium is not installed here: apt-get install chromium")
    wait_for_quiet()


def settings(folder: Path) -> Path:
    token, path = folder / "token", folder / "companion.yaml"
    token.write_text(TOKEN)
    token.chmod(0o600)
    path.write_text(yaml.safe_dump({"serve": {"token_file": str(token), "allow_commands": True}}))
    return path


class LandingApp:
    """The app, whose words are read all the time."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process, self.said = process, ""
        self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        assert self.process.stdout is not None
        while line := await self.process.stdout.readline():
            self.said += line.decode()

    async def says(self, pattern: str) -> re.Match[str]:
        async with asyncio.timeout(PATIENCE_S):
            while (found := re.search(pattern, self.said)) is None:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        return found

    async def ended(self) -> int:
        async with asyncio.timeout(PATIENCE_S):
            await self._reading
            return await self.process.wait()


async def looks_well(tab: Tab) -> None:
    """Nothing is drawn over anything else, and nothing runs out to the side."""
    for size, ratio in ((DESK, 1.0), (PHONE, 2.0)):
        await tab.resize(size, ratio)
        await asyncio.sleep(0.5)
        assert await tab.evaluate(SIDEWAYS) == 0, size
        assert await tab.evaluate(OVERPRINT) == [], size


async def text(tab: Tab, name: str) -> Any:
    return await tab.evaluate(f"document.getElementById('{name}').textContent")


async def hold(tab: Tab, seconds: float) -> None:
    """A finger on the land button for so long."""
    box = "document.getElementById('land').getBoundingClientRect()"
    x, y = await tab.evaluate(f"[{box}.x + {box}.width / 2, {box}.y + {box}.height / 2]")
    at = {"x": x, "y": y, "button": "left", "clickCount": 1}
    await tab.call("Input.dispatchMouseEvent", type="mousePressed", **at)
    await asyncio.sleep(seconds)
    await tab.call("Input.dispatchMouseEvent", type="mouseReleased", **at)


async def enter(tab: Tab, url: str) -> None:
    """With a wrong token nothing is seen; with the right one everything."""
    await tab.open(url)
    await tab.wait_for("window.companion && !document.getElementById('ask').hidden")
    for token in ("not the token of this test", TOKEN):
        await tab.evaluate(
            f"document.getElementById('token').value = '{token}', "
            "document.getElementById('ask').requestSubmit()"
        )
        if token != TOKEN:
            await tab.wait_for("document.getElementById('alarm').textContent.startsWith('wrong token')")
            assert await tab.evaluate("window.companion.drawn") == 0
    await tab.wait_for("window.companion.drawn > 5")
    assert TOKEN not in await tab.evaluate("location.href")


async def test_a_landing_is_watched_and_stopped_from_a_phone(tmp_path: Path) -> None:
    async with browser(tmp_path) as tab:  # it starts before the flight does, which waits for nobody
        process = await asyncio.create_subprocess_exec(
            *COMMAND,
            *("--sitl", "--no-ui", "--scenario", "static", "--serve", "127.0.0.1:0"),
            *("--config", str(settings(tmp_path))),
            cwd=ROOT,
            env=environment() | {"PYTHONUNBUFFERED": "1"},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        try:
            landing = LandingApp(process)
            url = (await landing.says(r"live page at (\S+)"))[1]
            await tab.resize(PHONE, 2.0)
            await enter(tab, url)
            await looks_well(tab)
            await tab.wait_for("document.getElementById('phase').textContent === 'descend'", PATIENCE_S)
            await looks_well(tab)
            assert (await text(tab, "lateral")).endswith("cm")
            assert await tab.evaluate("document.querySelectorAll('#lights li.silent').length") == 0
            await hold(tab, 0.3)  # a touch by mistake
            assert await text(tab, "answer") == ""
            await hold(tab, 1.8)
            answer = "document.getElementById('answer').textContent"
            await tab.wait_for(f"{answer}.startsWith('land: temporarily rejected: busy')")
            await tab.evaluate("document.getElementById('stop').click()")
            await landing.says("hold: stop requested")
            await tab.wait_for("document.getElementById('phase').textContent === 'abort'")
            assert await landing.ended() == 4
            await tab.wait_for("document.getElementById('alarm').textContent.includes('NO DATA')")
            assert await tab.evaluate("document.getElementById('orders').hidden")
            assert [line for line in tab.console if "ERR_CONNECTION_REFUSED" not in line] == []
            assert TOKEN not in landing.said
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()
