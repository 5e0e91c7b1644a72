"""Which baud rate to talk to the GPS receiver at: finds the one it uses, and moves it to the one we want.

A receiver that wakes without its settings talks at 9600 baud; one that has been used elsewhere, at anything.
At a wrong rate its bytes are garbage, so: listen at the rate that we want; when no message is understood
there, at the next one; once there is a message, ask the receiver to change (CFG-PRT), go back to the wanted
rate and listen there. A receiver that says nothing unasked is asked at each rate all the same. No input or
output here, and no clock.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Final

# what a NEO-6M can, the likely ones first, and what ArduPilot leaves in later ones
RATES: Final = (9600, 38400, 57600, 115200, 19200, 4800, 230400, 460800)
LISTEN_S: Final = 1.6  # a receiver without settings talks once a second
SILENCE_S: Final = 3.0  # what was understood has stopped
CHANGES: Final = 3  # so often a receiver may be asked in vain


class BaudRate:
    """The rate of our end. `baud` is what the port is to be set to; `wanted` where the receiver is to go."""

    def __init__(self, wanted: int) -> None:
        self.baud = self.wanted = wanted
        self._others = self._all_others()
        self._since_s = -math.inf
        self._began = False
        self._asked = False
        self._in_vain = 0

    @property
    def there(self) -> bool:
        return self.baud == self.wanted

    def step(self, now_s: float, message_s: float) -> bool:
        """Change `baud` when it is time to.

        Args:
            now_s: the time; call it several times a second.
            message_s: when the last whole message came, at whatever rate.

        Returns:
            Whether to ask the receiver now to change to `wanted`. The next step goes there itself: by then
            the question must have left.
        """
        if not self._began:
            self._began, self._since_s = True, now_s
        if self._asked:
            self._asked = False
            self._go(self.wanted, now_s)
            return False
        understood = message_s > self._since_s
        quiet_s = now_s - max(self._since_s, message_s)
        if self.there:
            if understood:
                self._in_vain = 0
                self._others = self._all_others()
            if quiet_s > (SILENCE_S if understood else LISTEN_S):
                self._go(next(self._others), now_s)
            return False
        return self._ask(understood, quiet_s)

    def _ask(self, understood: bool, quiet_s: float) -> bool:
        if not understood and quiet_s <= LISTEN_S:
            return False
        if understood:  # if it does not follow, it is here
            self._in_vain += 1
            self._others = itertools.chain([self.baud], self._all_others())
        if self._in_vain > CHANGES:
            self.wanted = self.baud
            return False
        self._asked = True
        return True

    def _all_others(self) -> Iterator[int]:
        return itertools.cycle([rate for rate in RATES if rate != self.wanted])

    def _go(self, baud: int, now_s: float) -> None:
        self.baud = baud
        self._since_s = now_s
