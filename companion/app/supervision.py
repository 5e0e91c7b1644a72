"""What becomes of a flight when one of its tasks fails: it continues, and the task is started again."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final

from companion.app.sensing import Notify
from companion.base.errors import ConfigError

# long enough that a task which fails at once costs nothing, short beside what a flight survives without it
RESTART_PAUSE_S: Final = 1.0
# what has failed is back once it has run for this long
BACK_AFTER_S: Final = 2.0


async def supervised(
    name: str, work: Callable[[], Awaitable[None]], notify: Notify, on_ground: Callable[[], bool]
) -> None:
    """Run a task; each time it fails, report that and start it again after `RESTART_PAUSE_S`.

    Meanwhile the planner knows what a flight without that device may still do. An internal fault is treated
    alike: better no GPS than no control. The same failure in a row is reported once, and so is its end.

    Raises:
        ConfigError: something the user can correct, while the vehicle is still on the ground.
    """
    failures, reported = 0, ""

    def say_back() -> None:
        nonlocal reported
        reported = ""
        notify("device_back", f"{name} is back", "info")

    while True:
        back = asyncio.get_running_loop().call_later(BACK_AFTER_S, say_back) if reported else None
        try:
            return await work()
        except ConfigError as error:
            if on_ground():
                raise
            text = str(error)
        except Exception as error:
            text = failure_words(error)
        finally:
            if back is not None:
                back.cancel()
        failures += 1
        if text != reported:
            again = "" if failures == 1 else f" (failure {failures})"
            notify("device_lost", f"{name} lost: {text}{again}", "error")
            reported = text
        await asyncio.sleep(RESTART_PAUSE_S)


def failure_words(error: Exception) -> str:
    """What a person reads of it; the operating system's errors without their number."""
    if not isinstance(error, OSError):
        return f"{type(error).__name__}: {error}"
    reason = error.strerror or str(error)
    return reason if error.filename is None else f"{error.filename}: {reason}"
