"""How often and how lately each input came, and how late what is sent is: from what the log takes. Pure."""

from collections import deque
from dataclasses import dataclass
from typing import Any, Final

from companion.base.messages import FrameReport, LandingTargetPose, Setpoint

WINDOW_S: Final = 5.0
LATENCIES: Final = 300  # of the last frames or setpoints: ten seconds at 30 Hz


@dataclass(frozen=True, slots=True)
class Rate:
    """Messages a second over the last `WINDOW_S`, and how long ago the newest came (s)."""

    rate_hz: float
    age_s: float


class Meter:
    """Counts messages by topic; `note` costs a microsecond."""

    def __init__(self) -> None:
        self._since_s: float | None = None
        self._counts: dict[str, int] = {}
        self._newest_s: dict[str, float] = {}
        self._rates_hz: dict[str, float] = {}
        self._vision_s: deque[float] = deque(maxlen=LATENCIES)
        self._setpoint_s: deque[float] = deque(maxlen=LATENCIES)
        self._exposed_s: float | None = None

    def note(self, topic: str, message: Any, time_s: float) -> None:
        self._counts[topic] = self._counts.get(topic, 0) + 1
        self._newest_s[topic] = time_s
        if isinstance(message, FrameReport):
            self._vision_s.append(message.done_s - message.time_s)
        elif isinstance(message, Setpoint) and message.exposure_time_s is not None:
            self._sent(message.time_s, message.exposure_time_s)
        elif isinstance(message, LandingTargetPose):
            self._sent(time_s, message.time_s)
        self._turn(time_s)

    def rates(self, now_s: float) -> dict[str, Rate]:
        """By topic, whatever has ever come."""
        self._turn(now_s)
        return {
            topic: Rate(self._rates_hz.get(topic, 0.0), now_s - newest_s)
            for topic, newest_s in sorted(self._newest_s.items())
        }

    def latency_ms(self) -> dict[str, tuple[float, float]]:
        """Median and 99th percentile (ms) from exposure to the frame's result, and to what is sent."""
        found = {"frame": self._vision_s, "setpoint": self._setpoint_s}
        return {name: _percentiles_ms(values) for name, values in found.items() if values}

    def _sent(self, time_s: float, exposed_s: float) -> None:
        """A setpoint left; later ones that still live on the same sighting say nothing about the latency."""
        if exposed_s != self._exposed_s:
            self._exposed_s = exposed_s
            self._setpoint_s.append(time_s - exposed_s)

    def _turn(self, now_s: float) -> None:
        """Every `WINDOW_S` the counts become rates."""
        if self._since_s is None:
            self._since_s = now_s
        elapsed_s = now_s - self._since_s
        if elapsed_s >= WINDOW_S:
            self._rates_hz = {topic: count / elapsed_s for topic, count in self._counts.items()}
            self._counts.clear()
            self._since_s = now_s


def _percentiles_ms(values: deque[float]) -> tuple[float, float]:
    ordered = sorted(values)
    last = len(ordered) - 1
    return 1e3 * ordered[round(0.5 * last)], 1e3 * ordered[round(0.99 * last)]
