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
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from tests.programs import ProgramHere
    from tests.scenario.flying import SharedFlights

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_library, "1")

WORKERS: Final = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
# the niceness of a worker that computes, over that of this run
COMPUTES_AT: Final = os.nice(0) + 5
# the folder of those that wait by the clock: simulators, autopilots and browsers in real time
REAL_TIME: Final = "tests/scenario/real_time/"
# what `make test` leaves to `make test-all`, besides what is marked slow itself
SLOW: Final = (REAL_TIME, "tests/scenario/flights/", "benchmarks/", "experiments/")
# seconds by test, of those that take one: recorded by pytest-split (`make durations`)
DURATIONS: Final = Path(__file__).with_name(".test_durations")
# of a file of flights of which nothing is recorded: a new one shall not be left to the end
FLIGHTS_S: Final = 40.0


def file_of(nodeid: str) -> str:
    """A test's file."""
    return nodeid.partition("::")[0]


def recorded_s() -> dict[str, float]:
    """Seconds by file."""
    files: dict[str, float] = {}
    for test, seconds in json.loads(DURATIONS.read_text(encoding="utf-8")).items():
        files[file_of(test)] = files.get(file_of(test), 0.0) + seconds
    return files


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


@pytest.hookimpl(tryfirst=True)  # before -m looks at the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what is in real time, then the slow files, the slowest first; mark whole folders as slow."""
    recorded = recorded_s()

    def order(item: pytest.Item) -> tuple[bool, float]:
        file = file_of(item.nodeid)
        flies = FLIGHTS_S if file.startswith("tests/scenario/flights/") else 0.0
        return not file.startswith(REAL_TIME), -recorded.get(file, flies)

    items.sort(key=order)
    for item in items:
        if item.nodeid.startswith(SLOW) and item.get_closest_marker("fast") is None:
            item.add_marker(pytest.mark.slow)


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


@pytest.fixture
def program(capsys: pytest.CaptureFixture[str]) -> ProgramHere:
    """Runs a program of ours in this process: `program("companion", "replay", log).code`."""
    from tests.programs import program_here

    return program_here(capsys)
