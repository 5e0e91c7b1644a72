"""Who hears of what is logged, beside the log itself: the live page."""

from collections.abc import Mapping
from typing import Any, Protocol

from pydantic import BaseModel

from companion.base.messages import Frame


class Tap(Protocol):
    """Who hears of all that is logged, on the control loop: whatever it does delays control."""

    def know(self, settings: Mapping[str, BaseModel]) -> None: ...
    def note(self, topic: str, message: Any, time_s: float) -> None: ...
    def frame(self, frame: Frame) -> None: ...


class NoTap:
    """Nobody hears."""

    def know(self, settings: Mapping[str, BaseModel]) -> None:
        """See `Tap`."""

    def note(self, topic: str, message: Any, time_s: float) -> None:
        """See `Tap`."""

    def frame(self, frame: Frame) -> None:
        """See `Tap`."""
