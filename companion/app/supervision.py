"""What becomes of a flight when one of its tasks fails: it continues without that task, and says so."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from companion.app.sensing import Notify
from companion.base.errors import ConfigError


async def supervised(
    name: str, work: Callable[[], Awaitable[None]], notify: Notify, on_ground: Callable[[], bool]
) -> None:
    """Run a task; when it fails, report it and continue without it.

    The planner knows what a flight without that device may still do. An internal fault is treated alike:
    better no GPS than no control.

    Raises:
        ConfigError: something the user can correct, while the vehicle is still on the ground.
    """
    try:
        await work()
    except ConfigError as error:
        if on_ground():
            raise
        notify("device_lost", f"{name} lost: {error}", "error")
    except Exception as error:
        kind = "" if isinstance(error, OSError) else f"{type(error).__name__}: "
        notify("device_lost", f"{name} lost: {kind}{error}", "error")
