"""The live status of a flight: what the terminal shows."""

from collections import deque
from dataclasses import dataclass
from typing import Final

from companion.base.messages import FrameReport, Notice, PadState, Phase, VehicleState

STATUS_PERIOD_S: Final = 0.25
FRAME_RATE_WINDOW_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Status:
    """What the terminal shows; times count from the app's start."""

    time_s: float
    phase: Phase
    mode: str
    vehicle: VehicleState | None
    pad: PadState | None
    last_frame: FrameReport | None
    frame_rate_hz: float
    latency_ms: float | None
    notices: tuple[Notice, ...]
    camera_problem: str | None = None


class FrameRate:
    """Frames per second over the last `FRAME_RATE_WINDOW_S`, from a count that is read every period."""

    def __init__(self) -> None:
        self._counts = deque([0], maxlen=round(FRAME_RATE_WINDOW_S / STATUS_PERIOD_S) + 1)

    def add(self, count: int) -> float:
        """Take the count of all frames so far; returns the rate (Hz)."""
        self._counts.append(count)
        return (self._counts[-1] - self._counts[0]) / (STATUS_PERIOD_S * (len(self._counts) - 1))
