"""Debouncing: a condition becomes true only after it has held without interruption for a given time."""


class Debounce:
    """How long each of some conditions, by their names, has held without a break."""

    def __init__(self) -> None:
        self._since_s: dict[str, float] = {}

    def held_s(self, name: str, condition: bool, now_s: float) -> float:
        """How long (s) the condition has held; negative when it does not."""
        if not condition:
            self._since_s.pop(name, None)
            return -1.0
        return now_s - self._since_s.setdefault(name, now_s)

    def end(self, *names: str) -> None:
        """These conditions do not hold; without names, none does."""
        for name in names or tuple(self._since_s):
            self._since_s.pop(name, None)
