"""A task that fails is reported and started again."""

import asyncio

import pytest

from companion.app.app import BACK_AFTER_S, RESTART_PAUSE_S, supervised
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.errors import ConfigError
from companion.link.codec import Severity


class FailingTask:
    """Raises these errors, one a run, then ends well."""

    def __init__(self, *errors: Exception) -> None:
        self._errors = list(errors)
        self.started_s: list[float] = []
        self.notices: list[str] = []

    async def work(self) -> None:
        self.started_s.append(Clock().now_s())
        await asyncio.sleep(0.0)
        if self._errors:
            raise self._errors.pop(0)

    def notify(self, kind: str, text: str, severity: Severity) -> None:
        assert (kind, severity) in (("device_lost", "error"), ("device_back", "info"))
        self.notices.append(text)

    def run(self, *, on_ground: bool) -> None:
        run_in_virtual_time(supervised("GPS", self.work, self.notify, lambda: on_ground))


def test_it_is_started_again_after_a_pause() -> None:
    task = FailingTask(AttributeError("no field"), OSError("unplugged"))
    task.run(on_ground=False)
    assert task.notices == ["GPS lost: AttributeError: no field", "GPS lost: unplugged (failure 2)"]
    first_s = task.started_s[0]
    assert [t - first_s for t in task.started_s] == pytest.approx([0.0, RESTART_PAUSE_S, 2 * RESTART_PAUSE_S])


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(5, "serial port /dev/ttyAMA0: unplugged"), "serial port /dev/ttyAMA0: unplugged"),
        (
            FileNotFoundError(2, "No such file or directory", "/dev/i2c-1"),
            "/dev/i2c-1: No such file or directory",
        ),
    ],
)
def test_the_operating_systems_errors_are_told_without_their_numbers(error: OSError, told: str) -> None:
    task = FailingTask(error)
    task.run(on_ground=False)
    assert task.notices == [f"GPS lost: {told}"]


def test_a_failure_that_stays_is_reported_once() -> None:
    task = FailingTask(*(OSError("unplugged") for _ in range(5)))
    task.run(on_ground=False)
    assert task.notices == ["GPS lost: unplugged"]
    assert len(task.started_s) == 6


def test_what_the_user_can_correct_ends_the_app_on_the_ground_alone() -> None:
    with pytest.raises(ConfigError, match="wrong port"):
        FailingTask(ConfigError("wrong port")).run(on_ground=True)
    task = FailingTask(ConfigError("wrong port"))
    task.run(on_ground=False)
    assert task.notices == ["GPS lost: wrong port"]


def test_what_runs_again_is_said_to_be_back_once_and_its_next_failure_is_reported() -> None:
    notices: list[str] = []
    runs = iter([0.0, 0.0])

    async def work() -> None:
        await asyncio.sleep(next(runs, 3.0 * BACK_AFTER_S))
        if len(notices) < 3:
            raise OSError("unplugged")

    run_in_virtual_time(supervised("GPS", work, lambda _kind, text, _severity: notices.append(text), bool))
    assert notices == ["GPS lost: unplugged", "GPS is back", "GPS lost: unplugged (failure 3)", "GPS is back"]
