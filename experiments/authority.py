"""How many cycles of a descent the speed law decides: those in which T is the law's own, by eq. 37.

T = |Δ| / V + T_min is lengthened where the way would exceed the plan's limits, and most of the last plan's
time is kept. The log holds T, V and the reference over the horizon, not Δ. That follows from them: the way is
the quintic of eqs. 20 to 30 that ends at rest in the pad's frame, so its start and one point of it give its
end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.messages import Phase, PlanStep, Reference
from companion.plan.trajectory.trajectory_time import trajectory_time_s

DESCENTS: Final = frozenset({Phase.APPROACH, Phase.DESCEND})
SAME_SHARE: Final = 0.01  # of T


@dataclass(frozen=True, slots=True)
class RuleAuthority:
    """Cycles that planned a way to the pad, and those of them whose time was the law's."""

    cycles: int = 0
    decided: int = 0


def authority(plans: Sequence[PlanStep], minimum_time_s: float) -> RuleAuthority:
    """Count them over a flight's plan, by its T_min (s)."""
    decided = [
        abs(law_s - plan.time_to_go_s) <= SAME_SHARE * plan.time_to_go_s
        for plan in plans
        if (law_s := _law_s(plan, minimum_time_s)) is not None
    ]
    return RuleAuthority(len(decided), sum(decided))


def _law_s(plan: PlanStep, minimum_time_s: float) -> float | None:
    """Eq. 37's own time for the way of a cycle (s); None in a cycle without one."""
    reference, planned = plan.reference, plan.speed_m_s > 0.0 and plan.time_to_go_s > 0.0
    if reference is None or reference.origin != "pad" or plan.phase not in DESCENTS or not planned:
        return None
    return trajectory_time_s(way_to_go_m(reference, plan.time_to_go_s), plan.speed_m_s, minimum_time_s)


def way_to_go_m(reference: Reference, time_to_go_s: float) -> float:
    """|Δ| (m) of the quintic that a reference shows the beginning of, by eqs. 29 and 30."""
    row = len(reference.position_m) // 2
    tau = min(1.0, row * reference.step_s / time_to_go_s)
    start = reference.position_m[0]
    velocity = time_to_go_s * reference.velocity_m_s[0]
    acceleration = time_to_go_s**2 * reference.acceleration_m_s2[0]
    moved = (
        velocity * (tau - 6.0 * tau**3 + 8.0 * tau**4 - 3.0 * tau**5)
        + acceleration * (0.5 * tau**2 - 1.5 * tau**3 + 1.5 * tau**4 - 0.5 * tau**5)
    )  # fmt: skip
    share = 10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5
    return float(np.linalg.norm((reference.position_m[row] - start - moved) / share))
