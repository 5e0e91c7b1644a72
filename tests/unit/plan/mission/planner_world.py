"""Worlds for whole missions of the planner, and what counts as a good landing."""

from companion.base.messages import Phase
from companion.config import PlanConfig
from tests.unit.plan.pad_paths import Path, circle
from tests.unit.plan.plan_harness import PlanWorld

GOOD = [
    Phase.CONNECT,
    Phase.ARM,
    Phase.TAKE_OFF,
    Phase.WAYPOINT,
    Phase.SEARCH,
    Phase.APPROACH,
    Phase.DESCEND,
    Phase.TOUCHDOWN,
    Phase.LANDED,
]


def world(pad: Path | None = None, config: PlanConfig | None = None) -> PlanWorld:
    w = PlanWorld(pad or circle(), config=config)
    w.beacon_after_s = 0.5
    return w
