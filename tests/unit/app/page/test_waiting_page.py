"""The page that is opened before the companion runs: a file of the viewer's own, which waits for it."""

from pathlib import Path

import pytest
from aiohttp.test_utils import TestServer, unused_port

from companion.app.page.server import PageServer
from tests.browser import browser, program
from tests.unit.app.page.test_server import served, start


async def test_it_is_a_file_to_keep_with_the_address_it_was_asked_by() -> None:
    async with served() as on:
        answer = await on.client.get("/wait.html", headers={"Host": "rover.lan:8080"})
        assert answer.status == 200
        assert answer.headers["Content-Disposition"] == "attachment; filename=companion.html"
        assert "<p>http://rover.lan:8080/</p>" in await answer.text()
        assert (await on.client.get("/wait.html", headers={"Host": "evil.example"})).status == 421


@pytest.mark.skipif(program() is None, reason="no Chromium here; Debian: apt install chromium")
async def test_opened_before_the_companion_runs_it_goes_to_the_page_once_that_is_there(
    tmp_path: Path,
) -> None:
    port = unused_port()
    address = f"http://127.0.0.1:{port}/"
    async with served() as on:
        kept = await (
            await on.client.get("/wait.html", headers={"Host": address.removeprefix("http://")[:-1]})
        ).text()
    (tmp_path / "companion.html").write_text(kept)
    async with browser(tmp_path) as tab:
        await tab.open(f"file://{tmp_path}/companion.html#token=abc")
        await tab.wait_for("document.getElementById('said')?.textContent.includes('no answer yet')")
        said: list[dict[str, object]] = []
        async with TestServer(PageServer(start(), said.append).application(), port=port):
            await tab.wait_for(f"location.href === '{address}'")
            await tab.wait_for("sessionStorage.getItem('token') === 'abc'")
            assert all("ERR_CONNECTION_REFUSED" in line for line in tab.console)
