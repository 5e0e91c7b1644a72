"""What the parts of the planner work on together, one of each in a mission."""

from dataclasses import dataclass

from companion.plan.events import Announcements
from companion.plan.landing.height_above_ground import HeightAboveGround
from companion.plan.landing.relative_state import PadTrack
from companion.plan.mission.requests import Requests
from companion.plan.mission.table import StateMachine
from companion.plan.trajectory.reference_generator import ReferenceGenerator


@dataclass(frozen=True, slots=True)
class Shared:
    """The state, what is asked of the autopilot, what is known below, and the reference."""

    machine: StateMachine
    requests: Requests
    say: Announcements
    pad: PadTrack
    ground: HeightAboveGround
    generator: ReferenceGenerator
