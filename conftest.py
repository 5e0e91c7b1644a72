"""For all tests: one thread for each worker's arithmetic, which worker runs what, and a state folder each.

Three workers share two cores. One begins with the tests that wait in real time, which need a quarter of a
core; the other two give way to it by their niceness, so that real time is kept. A file goes as a whole to
the next worker that is free, the slowest first: what is left at the end is short. Those in real time are
one group, so that no two of them run at once.
Libraries that start a thread per core, each waiting busily for the others, cost time there.
"""

from __future__ import annotations

import gc
import hashlib
import os
from typing import TYPE_CHECKING, Any, Final

import pytest
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from tests.scenario.flying import SharedFlights

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_library, "1")

WORKERS: Final = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
# the niceness of a worker that computes, over that of this run
COMPUTES_AT: Final = os.nice(0) + 5
# the folder of those that wait by the clock: simulators, autopilots and browsers in real time
REAL_TIME: Final = "tests/scenario/real_time/"
# of a file of flights that is not listed: a new one shall not be left to the end
FLIGHTS_S: Final = 40.0
# rough seconds of a core; a new file of some ten seconds belongs here too
SLOW_S: Final = {
    "tests/scenario/flights/test_landings.py": 140,
    "tests/unit/test_docs.py": 90,
    "tests/scenario/flights/test_standby.py": 60,
    "tests/scenario/commands/test_campaign.py": 50,
    "tests/scenario/flights/test_autopilot_sensors.py": 45,
    "tests/unit/control/response/test_margins.py": 41,
    "tests/scenario/commands/test_records.py": 35,
    "tests/scenario/flights/test_firmware_flights.py": 27,
    "tests/architecture/test_types.py": 25,
    "tests/scenario/flights/test_link_first.py": 25,
    "tests/unit/control/test_closed_loop.py": 24,
    "tests/scenario/flights/test_no_landing.py": 20,
    "tests/unit/estimate/test_estimate_flight.py": 17,
    "tests/unit/base/test_service_packages.py": 17,
    "benchmarks/tests/test_bench_mutants.py": 16,
    "tests/unit/tools/pad_check/test_pad_check_samples.py": 15,
    "tests/unit/tools/pad_check/test_pad_check.py": 14,
    "tests/unit/flightlog/replay/test_replay_command.py": 14,
    "tests/unit/control/mpc/test_mpc.py": 13,
    "benchmarks/tests/test_bench_mutations.py": 12,
    "tests/unit/calibration/mount/test_mount_command.py": 12,
    "tests/scenario/flights/test_faults.py": 11,
    "tests/scenario/flights/test_wirings.py": 11,
    "benchmarks/tests/test_bench_faults_runs.py": 11,
    "tests/scenario/flights/test_fault_phases.py": 8,
}


def file_of(nodeid: str) -> str:
    """A test's file."""
    return nodeid.partition("::")[0]


def took_s(file: str) -> float:
    """Rough seconds of a file, by which files are ordered."""
    return SLOW_S.get(file, FLIGHTS_S if file.startswith("tests/scenario/flights/") else 0.0)


class ByFile(LoadScopeScheduling):  # type: ignore[misc]
    """Gives whole files to workers, and all that is in real time to one."""

    def _split_scope(self, nodeid: str) -> str:
        file = file_of(nodeid)
        return REAL_TIME if file.startswith(REAL_TIME) else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByFile:
    """The order is that of the collection, not by how many tests a file has."""
    config.option.loadscopereorder = False
    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what is in real time, then the slow files, the slowest first."""
    files = {file_of(item.nodeid) for item in items}
    order = {file: (not file.startswith(REAL_TIME), -took_s(file)) for file in files}
    items.sort(key=lambda item: order[file_of(item.nodeid)])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that computes gives way to the one in real time, which may be this one up to here."""
    if WORKERS > 2 and not file_of(item.nodeid).startswith(REAL_TIME):
        os.nice(max(0, COMPUTES_AT - os.nice(0)))


def pytest_collection_finish() -> None:
    """A full garbage collection walks every object: those of imports and of the tests stay anyway."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def shared_flights(tmp_path_factory: pytest.TempPathFactory) -> SharedFlights:
    """Flights that this run's workers have in common."""
    from tests.scenario.flying import SharedFlights  # which imports numpy: after what is set above

    folder = tmp_path_factory.getbasetemp()
    shared = (folder.parent if WORKERS > 1 else folder) / "flights"
    shared.mkdir(exist_ok=True)
    return SharedFlights(shared)


@pytest.fixture(autouse=True)
def own_state_folder(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """No test finds the latch that another has left: the folder is made when it is written to."""
    name = hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:16]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / "state" / name))
    for variable in ("STATE_DIRECTORY", "NOTIFY_SOCKET"):
        monkeypatch.delenv(variable, raising=False)
