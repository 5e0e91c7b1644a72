"""Virtual time: jumps, never sleeps, and gives the same order every time."""

import asyncio
import gc
import os
import signal
import sys
import threading

import pytest

from companion.base.clock import Clock, NothingScheduled, run_in_virtual_time


async def test_a_real_loop_is_not_virtual() -> None:
    assert not Clock().virtual


def test_an_hour_of_virtual_time_passes_at_once() -> None:
    async def sleep_an_hour() -> float:
        clock = Clock()
        assert clock.virtual
        await clock.sleep_until(3600.0)
        return clock.now_s()

    # were it slept for real, the test run itself would tell
    assert run_in_virtual_time(sleep_an_hour()) == 3600.0


def test_timers_fire_in_the_order_of_their_times() -> None:
    async def race() -> list[str]:
        order: list[str] = []

        async def worker(name: str, period_s: float) -> None:
            for _ in range(3):
                await asyncio.sleep(period_s)
                order.append(name)

        await asyncio.gather(worker("slow", 0.25), worker("fast", 0.1))
        return order

    assert run_in_virtual_time(race()) == ["fast", "fast", "slow", "fast", "slow", "slow"]


def test_computing_takes_its_modelled_time() -> None:
    async def compute() -> tuple[int, float]:
        clock = Clock()
        value = await clock.run(pow, 2, 10, modelled_s=0.025)
        await clock.spend(0.005)
        return value, clock.now_s()

    value, now_s = run_in_virtual_time(compute())
    assert value == 1024
    assert now_s == pytest.approx(0.030)


def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the user's machine, though these tests share theirs."""
    monkeypatch.delenv("OMP_NUM_THREADS")
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


def test_the_virtual_loop_goes_on_beside_what_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    two_cores(monkeypatch)

    async def compute() -> tuple[bool, float]:
        clock, of_the_loop = Clock(), threading.Event()
        asyncio.get_running_loop().call_later(0.020, of_the_loop.set)
        heard = await clock.run(of_the_loop.wait, 10.0, modelled_s=0.025)
        return heard, clock.now_s()

    assert run_in_virtual_time(compute()) == (True, 0.025)


@pytest.mark.parametrize("share", [True, False])
def test_an_error_comes_when_the_result_was_due(*, share: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not share:
        two_cores(monkeypatch)

    async def compute() -> float:
        clock = Clock()
        with pytest.raises(ValueError, match="not a number"):
            await clock.run(float, "not a number", modelled_s=0.025)
        return clock.now_s()

    assert run_in_virtual_time(compute()) == 0.025


@pytest.mark.parametrize(("share", "modelled_s"), [(True, 0.025), (False, 0.0)])
def test_where_cores_are_shared_and_what_takes_no_time_is_computed_on_the_loop(
    *, share: bool, modelled_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not share:
        two_cores(monkeypatch)

    async def compute() -> int:
        return await Clock().run(threading.get_ident, modelled_s=modelled_s)

    assert run_in_virtual_time(compute()) == threading.get_ident()


def test_no_thread_is_left_when_virtual_time_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    two_cores(monkeypatch)
    before, interval_s = threading.active_count(), sys.getswitchinterval()

    async def compute() -> tuple[int, float]:
        await Clock().run(pow, 2, 10, modelled_s=0.025)
        return threading.active_count(), sys.getswitchinterval()

    count, during_s = run_in_virtual_time(compute())
    assert count > before
    assert during_s < interval_s
    assert (threading.active_count(), sys.getswitchinterval()) == (before, interval_s)


def test_waiting_for_nothing_is_reported_instead_of_hanging() -> None:
    async def wait_forever() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(NothingScheduled):
        run_in_virtual_time(wait_forever())


async def test_in_real_time_computing_leaves_the_loop_free() -> None:
    clock = Clock()
    started = asyncio.Event()
    loop = asyncio.get_running_loop()

    def wait_for_the_loop() -> bool:
        loop.call_soon_threadsafe(started.set)
        return asyncio.run_coroutine_threadsafe(started.wait(), loop).result(timeout=10.0)

    assert await clock.run(wait_for_the_loop, modelled_s=1e6)


def test_the_virtual_loop_hears_a_signal_and_a_thread_while_it_jumps() -> None:
    async def wait_for_both() -> set[str]:
        loop = asyncio.get_running_loop()
        heard: set[str] = set()
        loop.add_signal_handler(signal.SIGUSR1, heard.add, "signal")
        try:
            os.kill(os.getpid(), signal.SIGUSR1)
            thread = threading.Thread(target=loop.call_soon_threadsafe, args=(heard.add, "thread"))
            thread.start()
            thread.join()
            for _ in range(10_000):
                if len(heard) == 2:
                    break
                await asyncio.sleep(0.001)
        finally:
            loop.remove_signal_handler(signal.SIGUSR1)
        return heard

    assert run_in_virtual_time(wait_for_both()) == {"signal", "thread"}


def test_a_flight_collects_garbage_as_the_process_did_before_and_after() -> None:
    before = gc.get_threshold()

    async def threshold() -> int:
        return gc.get_threshold()[0]

    assert run_in_virtual_time(threshold()) > before[0]
    assert gc.get_threshold() == before
