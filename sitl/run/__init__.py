"""A simulation put together and run, in process or as a process of its own."""

from typing import Final

LOOPBACK: Final = "127.0.0.1"
COMPANION_PORT: Final = 14540
GROUND_PORT: Final = 14550
TCP_PORT: Final = 5760
