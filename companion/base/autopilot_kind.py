"""The autopilots that the app flies with."""

from typing import Literal

AutopilotKind = Literal["px4", "ardupilot"]
