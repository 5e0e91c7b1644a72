"""Flights to download from the page, and the settings to read: for those who show the token."""

import io
import zipfile
from pathlib import Path

import pytest

from tests.unit.app.page.starting import TOKEN
from tests.unit.app.page.test_server import served

BEARER = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def flights(tmp_path: Path) -> Path:
    for name in ("flight-0001", "flight-0002"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "flight.mcap").write_bytes(name.encode())
    (tmp_path / "latch.json").write_text("not a flight")
    return tmp_path


async def test_flights_are_listed_and_come_whole(flights: Path) -> None:
    async with served(flights=flights, token=TOKEN) as on:
        listed = await (await on.client.get("/flights", headers=BEARER)).json()
        assert [flight["name"] for flight in listed] == ["flight-0002", "flight-0001"]
        answer = await on.client.get("/flights/flight-0002", headers=BEARER)
        assert answer.headers["Content-Disposition"] == 'attachment; filename="flight-0002.zip"'
        with zipfile.ZipFile(io.BytesIO(await answer.read())) as archive:
            assert archive.namelist() == ["flight-0002/flight.mcap"]
            assert archive.read("flight-0002/flight.mcap") == b"flight-0002"


@pytest.mark.parametrize("name", ["latch.json", "%2e%2e%2fetc", "flight-0009"])
async def test_nothing_else_can_be_had(flights: Path, name: str) -> None:
    async with served(flights=flights, token=TOKEN) as on:
        assert (await on.client.get(f"/flights/{name}", headers=BEARER)).status == 404


async def test_without_the_token_nothing_is_shown(flights: Path) -> None:
    async with served(flights=flights, token=TOKEN, settings_text="pad: x") as on:
        for path in ("/flights", "/flights/flight-0001", "/settings"):
            for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Basic {TOKEN}"}):
                assert (await on.client.get(path, headers=headers)).status == 403
        assert await (await on.client.get("/settings", headers=BEARER)).text() == "pad: x"


async def test_where_nothing_is_recorded_there_are_no_flights() -> None:
    async with served() as on:
        assert await (await on.client.get("/flights")).json() == []
