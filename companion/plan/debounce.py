"""Times between cycles: how long a condition has held without interruption, and how long a step lasts."""

import math


class Debounce:
    """How long each of some conditions, by their names, has held without a break."""

    def __init__(self) -> None:
        self._since_s: dict[str, float] = {}

    def held_s(self, name: str, condition: bool, now_s: float) -> float:
        """How long (s) the condition has held; negative when it does not.

        `now_s`: of the cycle, or of the measurement that says so, where a cycle may have none of its own.
        """
        if not condition:
            self._since_s.pop(name, None)
            return -1.0
        return now_s - self._since_s.setdefault(name, now_s)

    def end(self, *names: str) -> None:
        """These conditions do not hold; without names, none does."""
        for name in names or tuple(self._since_s):
            self._since_s.pop(name, None)


class StepClock:
    """How long the step lasts that ends with a call."""

    def __init__(self) -> None:
        self._before_s = -math.inf

    def step_s(self, now_s: float) -> float:
        """Time (s) since the call before this, never negative; inf at the first: nothing of before counts."""
        elapsed_s, self._before_s = max(0.0, now_s - self._before_s), now_s
        return elapsed_s
