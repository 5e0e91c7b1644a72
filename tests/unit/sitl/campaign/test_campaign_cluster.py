"""Campaigns on a Dask cluster: one within this process, whose threads fly on stand-ins for the app."""

from collections.abc import Iterator
from concurrent.futures import Future
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun, make_plan
from sitl.campaign.worker import Worker
from tests.unit.sitl.campaign.campaign_parts import flight
from tests.unit.sitl.campaign.fake_flights import COMMAND, DIES, IS_REFUSED

distributed = pytest.importorskip("distributed")
cluster = pytest.importorskip("sitl.campaign.cluster")


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    with (
        pytest.MonkeyPatch.context() as patch,
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as made,
    ):
        patch.setattr(cluster, "Worker", partial(Worker, COMMAND))
        yield made.scheduler_address


def flights(first_seed: int, runs: int) -> list[CampaignRun]:
    return list(make_plan(["static"], first_seed, runs, None).flights())


def test_every_run_comes_back_once(scheduler: str) -> None:
    flown = {run.flight: run for run in cluster.fly_on_cluster(flights(0, 6), scheduler)}
    assert set(flown) == set(flights(0, 6))
    assert [flown[each].result["seed"] for each in flights(0, 6)] == list(range(6))


def test_a_run_that_dies_is_failed_and_the_others_fly(scheduler: str) -> None:
    flown = {run.flight.seed: run.error for run in cluster.fly_on_cluster(flights(DIES - 1, 2), scheduler)}
    assert flown == {DIES - 1: "", DIES: f"killed by SIGKILL: last words of {DIES}"}


def test_other_files_or_another_version_there_are_refused(scheduler: str) -> None:
    with pytest.raises(ConfigError, match=r"has 'static' as .* the campaign as code-files; expected"):
        list(cluster.fly_on_cluster([flight(0)], scheduler))


def test_what_the_app_refuses_there_ends_the_campaign(scheduler: str) -> None:
    with pytest.raises(ConfigError, match=r"a\.yaml: no"):
        list(cluster.fly_on_cluster(flights(IS_REFUSED, 1), scheduler))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "tcp://[bad"])
def test_no_scheduler_is_one_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 0.3)
    with pytest.raises(ConfigError) as told:
        list(cluster.fly_on_cluster([flight(0)], address))
    assert str(told.value).startswith(f"--scheduler {address}: ")
    assert str(told.value).endswith("expected a Dask scheduler's address")
    assert "\n" not in str(told.value)


def failed(error: BaseException) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_exception(error)
    return future


def test_a_run_that_kills_the_clusters_workers_is_failed() -> None:
    error = distributed.KilledWorker("fly_here-1", SimpleNamespace(address="tcp://far:1"), 3)
    flown = cluster.taken(failed(error), flight(3))
    assert (flown.flight, flown.result) == (flight(3), None)
    assert flown.error == "4 workers of the cluster died of it, the last tcp://far:1"


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ModuleNotFoundError("No module named 'sitl'"), "No module named 'sitl'; expected companion there"),
        (distributed.client.FutureCancelledError("key", "lost"), "it has gone"),
    ],
)
def test_a_cluster_that_cannot_go_on_ends_the_campaign(error: BaseException, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        cluster.taken(failed(error), flight(3))
