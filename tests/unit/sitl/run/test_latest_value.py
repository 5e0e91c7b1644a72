"""A slot hands on the newest value only."""

import asyncio

from sitl.run.in_process import LatestValue


async def test_a_slow_reader_sees_the_newest_value_only() -> None:
    slot: LatestValue[int] = LatestValue()
    slot.put(1)
    slot.put(2)
    assert await slot.next() == 2
    waiting = asyncio.ensure_future(slot.next())
    await asyncio.sleep(0)
    assert not waiting.done()
    slot.put(3)
    assert await waiting == 3
