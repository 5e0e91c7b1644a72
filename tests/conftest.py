"""For all tests: one thread for each worker's arithmetic, the slow files first, and a state folder each.

Two workers share two cores. Libraries that start a thread per core, each waiting busily for the others, cost
time there.

Work stealing halves what is left of a worker's queue by count, not by seconds. A slow file at the end of a
queue would keep one worker busy while the other has nothing to do, so each worker begins with its share of
the slow files.
"""

from __future__ import annotations

import hashlib
import os
from collections import defaultdict
from typing import Final

import pytest

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_library, "1")

# of a file of flights that is not listed: a new one shall not be left to the end
FLIGHTS_S: Final = 40.0
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
    "scenario/flights/test_real_time.py": 60,
    "scenario/page/test_page_live.py": 40,
    "unit/test_docs.py": 100,
    "scenario/commands/test_records.py": 47,
    "unit/estimate/test_estimate_flight.py": 46,
    "unit/control/response/test_margins.py": 40,
    "scenario/clients/test_clients_mavsdk.py": 39,
    "scenario/flights/test_wirings.py": 39,
    "scenario/flights/test_faults.py": 37,
    "unit/control/test_closed_loop.py": 30,
    "scenario/flights/test_firmware_flights.py": 27,
    "scenario/clients/test_clients_mavutil.py": 24,
    "scenario/commands/test_streams.py": 20,
    "scenario/flights/test_external_autopilot.py": 20,
    "scenario/clients/test_clients_mavproxy.py": 16,
    "unit/control/mpc/test_mpc.py": 13,
    "unit/control/test_calm.py": 13,
    "scenario/commands/test_pad_check_live.py": 13,
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each worker's part of the queue its share of the slow files, the slowest first."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    files: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        files[item.nodeid.partition("::")[0].removeprefix("tests/")].append(item)
    queues: list[list[pytest.Item]] = [[] for _ in range(workers)]
    seconds = [0.0] * workers
    flights = {name: FLIGHTS_S for name in files if name.startswith("scenario/flights/")}
    slow_s = {name: took_s for name, took_s in {**flights, **SLOW_S}.items() if name in files}
    for name in sorted(slow_s, key=lambda name: (-slow_s[name], name)):
        least = seconds.index(min(seconds))
        queues[least] += files.pop(name)
        seconds[least] += slow_s[name]
    quick = [item for file in files.values() for item in file]
    # xdist cuts the list into queues of equal length
    for number, queue in enumerate(queues):
        room = max(0, len(items) * (number + 1) // workers - len(items) * number // workers - len(queue))
        queue.extend(quick[:room])
        del quick[:room]
    items[:] = [item for queue in queues for item in queue] + quick


@pytest.fixture(autouse=True)
def own_state_folder(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """No test finds the latch that another has left: the folder is made when it is written to."""
    name = hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:16]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / "state" / name))
    for variable in ("STATE_DIRECTORY", "NOTIFY_SOCKET"):
        monkeypatch.delenv(variable, raising=False)
