"""The autopilots that the app flies with."""

from __future__ import annotations

from typing import Literal

AutopilotKind = Literal["px4", "ardupilot"]
