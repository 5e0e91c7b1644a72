"""Runs side by side on this machine: one process a job, each flying one run after another."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from queue import SimpleQueue

from sitl.campaign.manifest import CampaignRun
from sitl.campaign.worker import RunResult, Worker


def fly_locally(
    flights: Sequence[CampaignRun], jobs: int, make_worker: Callable[[], Worker] = Worker
) -> Generator[RunResult, None, None]:
    """Fly runs, `jobs` at a time; they come as they end. Close it early and nothing is left running.

    Raises:
        ConfigError: the app refuses a scenario or the settings.
    """
    workers = [make_worker() for _ in range(min(jobs, len(flights)))]
    idle: SimpleQueue[Worker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def fly(flight: CampaignRun) -> RunResult:
        worker = idle.get()
        try:
            return worker.fly(flight)
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(max(1, len(workers)), thread_name_prefix="campaign")
    try:
        for future in as_completed([threads.submit(fly, flight) for flight in flights]):
            yield future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        # what is in the air falls, its thread comes back, and only then can its pipes be closed
        for worker in workers:
            worker.stop()
        threads.shutdown()
        for worker in workers:
            worker.close()
