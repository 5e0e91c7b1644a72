"""Modules that a library imports for functions which we never call, left out until one of them is called."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import Any


class _LateModule(ModuleType):
    """Gives a function for any name; called, it imports the module and calls the one of that name there."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("__"):
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} before it is imported")
        module = self.__name__

        def late(*arguments: Any, **named: Any) -> Any:
            return getattr(import_module(module), name)(*arguments, **named)

        late.__name__ = name
        return late


@contextmanager
def imported_late(*names: str) -> Iterator[None]:
    """While inside, importing one of these modules takes no time; what is then taken from it are functions.

    Each imports its module when it is called. A module that has been imported already is left alone, and
    nothing of this is seen by who imports it afterwards.
    """
    late = {name: _LateModule(name) for name in names if name not in sys.modules}
    sys.modules.update(late)
    for name, module in late.items():
        parent, _, last = name.rpartition(".")
        if parent in sys.modules:  # as an import leaves it: a package may import its modules when asked for
            setattr(sys.modules[parent], last, module)
    try:
        yield
    finally:
        for name, module in late.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]
            parent, _, last = name.rpartition(".")
            if vars(sys.modules.get(parent, module)).get(last) is module:
                delattr(sys.modules[parent], last)
