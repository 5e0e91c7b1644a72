"""Virtual time: jumps, never sleeps, and gives the same order every time."""

import asyncio

import pytest

from companion.clock import Clock, NothingScheduled, run_in_virtual_time


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
