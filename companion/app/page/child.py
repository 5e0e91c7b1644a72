"""The page's process: `python -m companion.app.page.child FD`. It ends when the pipe from the app does."""

import os
import signal
import sys
from multiprocessing.connection import Connection
from typing import Final

# beside what the app itself runs at
NICENESS: Final = 5


def main() -> None:
    """Entry point. First of all it gets out of the way: importing what it needs takes a second."""
    os.nice(NICENESS)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # a service manager signals all of us; the app ends us
    from companion.app.page.listener import serve  # noqa: PLC0415 - see above

    serve(Connection(int(sys.argv[1]), writable=False))


if __name__ == "__main__":
    main()
