"""The control loop's share of the interpreter, beside threads that compute: vision, and the flight log's."""

import asyncio
import sys
from types import SimpleNamespace
from typing import Any

from companion.app.app import App
from companion.base.clock import HAND_OVER_S, Clock
from companion.base.messages import Phase


def test_in_real_time_too_a_thread_that_computes_hands_the_interpreter_over_soon() -> None:
    # each system call of the loop would else wait for 5 ms: the minute that an order writes made cycles late
    async def nothing() -> None:
        pass

    async def fly() -> tuple[Phase, float]:
        app: Any = object.__new__(App)
        app._clock = Clock()
        app._actions = SimpleNamespace(start=nothing, close=nothing)
        app._service = SimpleNamespace(stopping=lambda: None)
        during_s = list[float]()

        async def run_tasks() -> Phase:
            during_s.append(sys.getswitchinterval())
            return Phase.LANDED

        app._run_tasks = run_tasks
        return await app.run(), during_s[0]

    before_s = sys.getswitchinterval()
    phase, interval_s = asyncio.run(fly())
    assert (phase, round(interval_s, 6)) == (Phase.LANDED, HAND_OVER_S)
    assert sys.getswitchinterval() == before_s > HAND_OVER_S
