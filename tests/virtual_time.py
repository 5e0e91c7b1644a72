"""Tests and their helpers that run in virtual time."""

from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from companion.base.clock import run_in_virtual_time

P = ParamSpec("P")
T = TypeVar("T")


def in_virtual_time(work: Callable[P, Coroutine[Any, Any, T]]) -> Callable[P, T]:
    """A coroutine function as a plain one: each call runs to its end on a virtual-time loop of its own."""

    @wraps(work)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        return run_in_virtual_time(work(*args, **kwargs))

    return run
