"""The form in which parts of the planner announce something: kind, text, time and severity."""

from collections.abc import Callable
from typing import Final, Literal

NoticeSeverity = Literal["info", "warning", "error"]
NoticeSink = Callable[[str, str, float, NoticeSeverity], None]

NOTICE_THRESHOLD_M: Final = 0.2  # a climb that is announced
