"""Short echoes in a row: what shows the feet down when no other sign of contact can be had. Times in s."""

from __future__ import annotations

from companion.base.messages import RangeSample
from companion.plan.landing.contact import FRESH_S

_IN_A_ROW = 2  # one may be a spike


class ShortEchoes:
    """Echoes of what the feet stand on: different ones in a row are a sign by themselves."""

    def __init__(self) -> None:
        """None yet."""
        self._times_s: list[float] = []

    def note(self, echo: RangeSample | None) -> None:
        """Take the newest echo, if it is short; None breaks the row."""
        if echo is None:
            self._times_s = []
        elif echo.time_s not in self._times_s:
            self._times_s = [*self._times_s, echo.time_s][-_IN_A_ROW:]

    def in_a_row(self, now_s: float) -> bool:
        """Whether enough have come, the last one just now."""
        return len(self._times_s) == _IN_A_ROW and now_s - self._times_s[-1] <= FRESH_S
