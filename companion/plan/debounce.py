"""Debouncing: a condition becomes true only after it has held without interruption for a given time."""


class Debounce:
    """How long a condition has held without a break."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def held_s(self, condition: bool, now_s: float) -> float:
        """How long (s) the condition has held; negative when it does not."""
        if not condition:
            self._since_s = None
            return -1.0
        if self._since_s is None:
            self._since_s = now_s
        return now_s - self._since_s
