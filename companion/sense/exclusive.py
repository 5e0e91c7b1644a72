"""One program of ours at a device: a second one reads away what the first waits for, or sets it up anew.

A lock on the open file (flock(2)): the kernel drops it with the file, however the program ends. It keeps
nobody else away who does not ask for it, such as `i2cdetect`.
"""

import fcntl
from typing import Final

TAKEN: Final = "busy; expected a device that no other program has open"


def take_alone(descriptor: int) -> None:
    """Take an open device for this program.

    Raises:
        BlockingIOError: another one has it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, TAKEN) from None
