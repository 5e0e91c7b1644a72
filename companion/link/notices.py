"""Texts to people by STATUSTEXT; what was told into a silent link is sent again when it is heard.

The texts that matter most come from the silence itself: why it holds, what it does meanwhile. Sans I/O.
"""

import math
from collections import deque
from typing import Final

from companion.link.codec import Message, Severity, status_texts

SILENT_S: Final = 1.5  # a link that carries heartbeats alone, one a second, is up
UNHEARD: Final = 5  # so few are sent again: setpoints wait behind them


class Notices:
    """Makes the messages; `heard` is called with every message of the autopilot's."""

    def __init__(self) -> None:
        self._told = 0
        # since the autopilot was last heard: it shows only later that the link is silent
        self._unheard: deque[tuple[str, Severity]] = deque(maxlen=UNHEARD)

    def tell(self, text: str, severity: Severity) -> list[Message]:
        """A text now."""
        if severity != "info" and (text, severity) not in self._unheard:
            self._unheard.append((text, severity))
        return self._messages(text, severity)

    def heard(self, silent_s: float) -> list[Message]:
        """What is sent again, now that the autopilot is heard after so long; infinite: for the first time."""
        unheard = list(self._unheard)
        self._unheard.clear()
        if not SILENT_S < silent_s < math.inf:
            return []
        return [message for told in unheard for message in self._messages(*told)]

    def _messages(self, text: str, severity: Severity) -> list[Message]:
        self._told = self._told % 0xFFFF + 1
        return status_texts(text, severity, self._told)
