"""Campaigns whose flights are stand-ins."""

from collections.abc import Iterator, Sequence
from functools import partial

import pytest

from sitl.campaign import run as running
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.worker import RunResult, Worker, fly_locally
from tests.unit.sitl.campaign.fake_flights import COMMAND


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[CampaignRun]:
    """Stand-ins fly and nothing is drawn, which takes seconds; what was asked for is kept."""
    monkeypatch.setattr("sitl.campaign.plots.write_plots", lambda *_: [])
    flights: list[CampaignRun] = []

    def fly(wanted: Sequence[CampaignRun], jobs: int) -> Iterator[RunResult]:
        flights.extend(wanted)
        return fly_locally(wanted, jobs, partial(Worker, COMMAND))

    monkeypatch.setattr(running, "fly_locally", fly)
    return flights
