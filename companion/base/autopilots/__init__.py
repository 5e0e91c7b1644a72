"""The autopilots that the app flies with: one profile for each make."""

from collections.abc import Mapping
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots.ardupilot import ARDUPILOT
from companion.base.autopilots.profile import AutopilotMake
from companion.base.autopilots.px4 import PX4

PROFILES: Final[Mapping[AutopilotKind, AutopilotMake]] = {
    profile.kind: profile for profile in (PX4, ARDUPILOT)
}
