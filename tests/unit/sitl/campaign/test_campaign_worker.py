"""A campaign's processes: one flies many, and one that dies, hangs or fails takes only its own run along."""

import contextlib
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun, make_plan
from sitl.campaign.worker import RunResult, Worker, fly_locally
from tests.unit.sitl.campaign.campaign_parts import flight
from tests.unit.sitl.campaign.fake_flights import COMMAND, DIES, FAULTS, HANGS, IS_REFUSED, LEAVES, WAITS


@pytest.fixture
def worker() -> Iterator[Worker]:
    made = Worker(COMMAND, flights_per_process=3)
    yield made
    made.close()


def process_of(flown: RunResult) -> int:
    assert flown.result is not None, flown.error
    return int(flown.result["events"][0]["text"])


def alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def test_one_process_flies_several_and_is_then_replaced(worker: Worker) -> None:
    flown = [worker.fly(flight(seed, "line")) for seed in range(5)]
    processes = [process_of(each) for each in flown]
    assert len(set(processes[:3])) == 1
    assert processes[3] == processes[4] != processes[0]
    assert not alive(processes[0])
    for seed, each in enumerate(flown):
        assert each.result is not None
        assert (each.result["seed"], each.result["scenario"], each.error) == (seed, "line", "")
        assert each.touchdown_pad_m == [1e-3 * seed, 0.0]


@pytest.mark.parametrize(
    ("seed", "words"),
    [
        (DIES, f"killed by SIGKILL: last words of {DIES}"),
        (LEAVES, f"ended with exit status 7: last words of {LEAVES}"),
        (FAULTS, "KeyError: 'x'"),
    ],
)
def test_what_fails_has_last_words_and_the_next_runs_flies_elsewhere(
    seed: int, words: str, worker: Worker
) -> None:
    before = process_of(worker.fly(flight(0)))
    flown = worker.fly(flight(seed))
    assert (flown.result, flown.error) == (None, words)
    assert process_of(worker.fly(flight(1))) != before
    assert not alive(before)


def test_one_that_hangs_is_ended(worker: Worker) -> None:
    before = process_of(worker.fly(flight(0)))
    flown = worker.fly(flight(HANGS), timeout_s=0.3)
    assert flown.error == f"no answer within 0 s: last words of {HANGS}"
    assert not alive(before)
    assert worker.fly(flight(1)).result is not None


def test_a_command_that_is_not_there_or_says_nothing_is_a_failed_run() -> None:
    worker = Worker(("/bin/sh", "-c", "exit 3"))
    assert worker.fly(flight(0)).error == "ended with exit status 3: no output"
    worker.close()


def test_stopping_from_another_thread_ends_the_run_and_all_further_ones(worker: Worker) -> None:
    worker.fly(flight(0))
    timer = threading.Timer(0.2, worker.stop)
    timer.start()
    assert worker.fly(flight(HANGS)).error.startswith("killed by SIGKILL")
    timer.join()
    assert worker.fly(flight(1)).error == "stopped"


# ---------------------------------------------------------------- side by side


def test_every_run_is_flown_once_on_as_many_processes_as_jobs() -> None:
    flights = [flight(WAITS, f"s{k}") for k in range(4)] + [flight(seed) for seed in range(8)]
    flown = list(fly_locally(flights, 2, lambda: Worker(COMMAND)))
    assert {run.flight for run in flown} == set(flights)
    assert len(flown) == len(flights)
    assert len({process_of(run) for run in flown}) == 2


def test_a_run_that_fails_does_not_stop_the_others() -> None:
    flights = [flight(DIES), flight(0), flight(LEAVES), flight(1)]
    flown = {run.flight.seed: run.error for run in fly_locally(flights, 1, lambda: Worker(COMMAND))}
    assert [bool(flown[run.seed]) for run in flights] == [True, False, True, False]


def test_closing_it_early_leaves_nothing_running() -> None:
    workers: list[Worker] = []

    def make() -> Worker:
        workers.append(Worker(COMMAND))
        return workers[-1]

    with contextlib.closing(fly_locally([flight(0), flight(HANGS), flight(1)], 1, make)) as flown:
        process = process_of(next(flown))
        assert alive(process)
    assert not alive(process)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("campaign")]


def test_what_the_app_refuses_comes_out_of_the_pool_and_ends_the_campaign() -> None:
    with pytest.raises(ConfigError, match=r"^a\.yaml: no$"):
        list(fly_locally([flight(IS_REFUSED), flight(HANGS)], 2, lambda: Worker(COMMAND)))


# ----------------
# Campaigns on a Dask cluster: one within this process, whose threads fly on stand-ins for the app.

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
