"""Short echoes in a row: what shows the feet down when no other sign of contact can be had. m and s."""

from __future__ import annotations

from companion.base.messages import RangeSample
from companion.plan.landing.contact import FRESH_S

_STANDS_S = FRESH_S  # at the slowest sink they would shorten by four times their noise


class ShortEchoes:
    """Echoes of what the feet stand on: that they shorten no more is felt, without IMU and camera."""

    def __init__(self, sink_m_s: float) -> None:
        """None yet; `sink_m_s` is the slowest that is planned."""
        self._sink_m_s = sink_m_s
        self._row: list[RangeSample] = []

    def note(self, echo: RangeSample | None) -> None:
        """Take the newest echo, if it is short; None breaks the row."""
        if echo is None:
            self._row = []
        elif not self._row or echo.time_s > self._row[-1].time_s:
            self._row.append(echo)

    def standing(self, now_s: float) -> bool:
        """Whether they have shortened by less than half of a sink, over long enough, up to now."""
        if not self._row or now_s - self._row[-1].time_s > FRESH_S:
            return False
        newest = self._row[-1]
        before = [echo for echo in self._row if newest.time_s - echo.time_s >= _STANDS_S]
        if not before:
            return False
        lasted_s = newest.time_s - before[-1].time_s
        return before[-1].distance_m - newest.distance_m <= 0.5 * self._sink_m_s * lasted_s
