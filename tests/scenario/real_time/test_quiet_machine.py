"""What keeps real time waiting: other programs, not this run's own."""

import subprocess
import sys

import pytest

from tests.scenario.real_time import quiet_machine
from tests.scenario.real_time.quiet_machine import PATIENCE_S, WINDOW_S, _cpu_seconds, wait_for_quiet

WORKED_S = 0.5
WORK = f"import time\nwhile time.process_time() < {WORKED_S}: pass"


@pytest.fixture(autouse=True)
def nothing_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quiet_machine, "_waited_s", 0.0)


def test_what_a_child_of_this_run_works_is_ours_also_when_it_has_ended() -> None:
    all_s, ours_s = _cpu_seconds()
    subprocess.run((sys.executable, "-c", WORK), check=True)
    all_then_s, ours_then_s = _cpu_seconds()
    assert ours_then_s - ours_s >= 0.9 * WORKED_S
    assert all_then_s - all_s >= 0.9 * WORKED_S


def test_it_goes_on_as_soon_as_the_others_leave_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    used = iter([0.9, 0.6, 0.4])
    monkeypatch.setattr(quiet_machine, "used_by_others", lambda: next(used))
    wait_for_quiet(0.5)
    assert next(used, None) is None


def test_others_that_go_on_cost_all_tests_together_no_more_than_the_patience(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks = 0

    def busy() -> float:
        nonlocal looks
        looks += 1
        return 0.83

    monkeypatch.setattr(quiet_machine, "used_by_others", busy)
    for _ in range(2):
        with pytest.raises(pytest.skip.Exception, match="other programs use 83% of each core; expected at"):
            wait_for_quiet()
    assert looks == PATIENCE_S / WINDOW_S + 2
