"""Waiting in real time for what another thread or process does."""

import time
from collections.abc import Callable


def soon(is_so: Callable[[], object], most_s: float = 20.0, every_s: float = 0.01) -> bool:
    """Whether something comes true before long."""
    late_s = time.monotonic() + most_s
    while not is_so():
        if time.monotonic() > late_s:
            return False
        time.sleep(every_s)
    return True
