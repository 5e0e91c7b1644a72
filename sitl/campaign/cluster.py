"""Runs on a Dask cluster (the extra `campaign`): each of its worker threads flies one run after another.

The cluster needs `companion` installed in the same version, and sees the same files under the same paths;
each worker compares before it flies.
"""

import logging
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from functools import lru_cache
from typing import Final

from distributed import Client, Future, KilledWorker, as_completed

from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun, code_digest, scenario_digest
from sitl.campaign.worker import RunResult, Worker

CONNECT_S: Final = 10.0
LOGGERS: Final = ("distributed", "distributed.client")
_mine = threading.local()


def fly_on_cluster(flights: Sequence[CampaignRun], address: str) -> Generator[RunResult, None, None]:
    """Fly runs on the cluster of a scheduler; they come as they end.

    Raises:
        ConfigError: no scheduler is there, or its workers have other files or another version.
    """
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        text = str(error).splitlines()[0]
        raise ConfigError(f"--scheduler {address}: {text}; expected a Dask scheduler's address") from error
    # this module reports lost connections itself
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with client:
        futures = client.map(fly_here, flights, pure=False)
        asked = dict(zip(futures, flights, strict=True))
        try:
            for future in as_completed(futures, loop=client.loop):
                yield taken(future, asked[future])
                # what has been taken need not stay in the cluster's memory
                future.release()
        finally:
            client.cancel(futures)


def taken(future: Future, flight: CampaignRun) -> RunResult:
    """What became of a run on the cluster.

    Raises:
        ConfigError: the cluster cannot go on.
    """
    try:
        flown: RunResult = future.result()
    except KilledWorker as error:
        tries, last = error.allowed_failures + 1, error.last_worker.address
        return RunResult(flight, 0.0, error=f"{tries} workers of the cluster died of it, the last {last}")
    except CancelledError as error:
        raise ConfigError("--scheduler: it has gone; give the same command again when it is back") from error
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"--scheduler: a worker of the cluster has {error}; expected companion there"
        ) from error
    return flown


def fly_here(flight: CampaignRun) -> RunResult:
    """What a worker of the cluster does: fly in this thread's own process.

    Raises:
        ConfigError: version or files differ from the client's, or the app rejects them.
    """
    here = identity(flight.source, flight.config)
    if here != flight.identity:
        raise ConfigError(
            f"--scheduler: a worker of the cluster has '{flight.scenario}' as {here}, the campaign as "
            f"{flight.identity}; expected the same version and files"
        )
    if not hasattr(_mine, "worker"):
        _mine.worker = Worker()
    flown: RunResult = _mine.worker.fly(flight)
    return flown


@lru_cache(maxsize=256)
def identity(source: str, config: str | None) -> str:
    """What decides a run here, but for its seed: see `CampaignRun.identity`."""
    return f"{code_digest()}-{scenario_digest(source, config)}"
