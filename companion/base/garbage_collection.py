"""When Python looks for garbage: seldom in flight, and never through all there is.

A full collection walks every object of the program and its libraries: it stops the control loop for a tenth
of a second on a desktop, longer on a small board. Nearly all that a flight makes dies at once without it.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

# of the youngest objects, after so many more than have died; of those that outlived it, after so many such;
# of all, practically never (CPython's own: 700, 10, 10)
IN_FLIGHT: Final = (5_000, 3, 1_000_000)


@contextmanager
def infrequent_collection() -> Iterator[None]:
    """While inside, what is there already is passed over, and a collection takes a millisecond or two."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*IN_FLIGHT)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()
