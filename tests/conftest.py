"""For all tests: one thread for each worker's arithmetic, the slow files first, and a state folder each.

Three workers share two cores. Two compute; the third begins with the tests that wait in real time, which
need a quarter of a core. The other two give way to it by their niceness, so that real time is kept.
Libraries that start a thread per core, each waiting busily for the others, cost time there.

Work stealing halves what is left of a worker's queue by count, not by seconds. A slow file at the end of a
queue would keep one worker busy while the other has nothing to do, so each worker begins with its share of
the slow files.
"""

from __future__ import annotations

import gc
import hashlib
import os
from collections import defaultdict
from collections.abc import Mapping, Set
from typing import Final

import pytest

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_library, "1")

WORKERS: Final = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
# the niceness of a worker that computes, over that of this run
COMPUTES_AT: Final = os.nice(0) + 5
# of a file of flights that is not listed: a new one shall not be left to the end
FLIGHTS_S: Final = 40.0
# files whose tests wait by the clock: simulators, autopilots and browsers in real time; rough seconds
REAL_TIME_S: Final = {
    "scenario/flights/test_real_time.py": 150,
    "scenario/flights/test_external_autopilot.py": 40,
    "scenario/clients/test_clients_mavsdk.py": 39,
    "scenario/page/test_page_live.py": 37,
    "scenario/commands/test_preflight_live.py": 26,
    "scenario/clients/test_clients_mavutil.py": 24,
    "scenario/clients/test_clients_mavproxy.py": 16,
    "scenario/commands/test_pad_check_live.py": 13,
    "scenario/page/test_page_standby.py": 10,
}
# rough seconds of a file; a new file of some ten seconds belongs here too
SLOW_S: Final = {
    "scenario/flights/test_landings.py": 200,
    "scenario/flights/test_autopilot_sensors.py": 95,
    "scenario/flights/test_standby.py": 100,
    "scenario/flights/test_link_first.py": 90,
    "scenario/flights/test_no_landing.py": 40,
    "scenario/commands/test_campaign.py": 60,
    "unit/tools/pad_check/test_pad_check.py": 30,
    "unit/tools/pad_check/test_pad_check_samples.py": 30,
    "unit/test_docs.py": 100,
    "architecture/test_types.py": 60,
    "scenario/commands/test_records.py": 47,
    "unit/estimate/test_estimate_flight.py": 46,
    "unit/control/response/test_margins.py": 40,
    "scenario/flights/test_wirings.py": 39,
    "scenario/flights/test_faults.py": 37,
    "unit/control/test_closed_loop.py": 30,
    "scenario/flights/test_firmware_flights.py": 27,
    "scenario/commands/test_streams.py": 20,
    "unit/control/mpc/test_mpc.py": 13,
    "unit/control/test_calm.py": 13,
}


def file_of(item: pytest.Item) -> str:
    """A test's file within `tests`."""
    return item.nodeid.partition("::")[0].removeprefix("tests/")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each worker's part of the queue its share of the slow files, the slowest first.

    With three workers or more the last has those in real time instead.
    """
    files: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        files[file_of(item)].append(item)
    queues: list[list[pytest.Item]] = [[] for _ in range(WORKERS)]
    computing, in_real_time = (queues[:-1], queues[-1:]) if WORKERS > 2 else (queues, queues)
    slow_s = {name: FLIGHTS_S for name in files if name.startswith("scenario/flights/")} | SLOW_S
    share_out(files, slow_s.keys() - REAL_TIME_S.keys(), slow_s, computing)
    share_out(files, REAL_TIME_S.keys(), REAL_TIME_S, in_real_time)
    quick = [item for file in files.values() for item in file]
    # xdist cuts the list into queues of equal length
    for number, queue in enumerate(queues):
        room = max(0, len(items) * (number + 1) // WORKERS - len(items) * number // WORKERS - len(queue))
        queue.extend(quick[:room])
        del quick[:room]
    items[:] = [item for queue in queues for item in queue] + quick


def share_out(
    files: dict[str, list[pytest.Item]],
    names: Set[str],
    took_s: Mapping[str, float],
    queues: list[list[pytest.Item]],
) -> None:
    """Move files into the queues, the slowest first, each into the one that is done first."""
    seconds = [0.0] * len(queues)
    for name in sorted(names & files.keys(), key=lambda name: (-took_s[name], name)):
        least = seconds.index(min(seconds))
        queues[least] += files.pop(name)
        seconds[least] += took_s[name]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that computes gives way to the one in real time, which may be this one up to here."""
    if WORKERS > 2 and file_of(item) not in REAL_TIME_S:
        os.nice(max(0, COMPUTES_AT - os.nice(0)))


def pytest_collection_finish() -> None:
    """A full garbage collection walks every object: those of imports and of the tests stay anyway."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def own_state_folder(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """No test finds the latch that another has left: the folder is made when it is written to."""
    name = hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:16]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / "state" / name))
    for variable in ("STATE_DIRECTORY", "NOTIFY_SOCKET"):
        monkeypatch.delenv(variable, raising=False)
