"""The duration of a trajectory: T = |Δ| / V + T_min, eq. 37 of the paper.

V comes from the speed law (`companion.plan.speed`), T_min is the setting `plan.guidance.minimum_time_s`.
The reference generator uses this time; `limits.within_limits` lengthens it if speed or acceleration would
exceed its limit.
"""


def trajectory_time_s(distance_m: float, speed_m_s: float, minimum_time_s: float) -> float:
    """T (s) of a way |Δ| (m) at an average speed V (m/s)."""
    return distance_m / speed_m_s + minimum_time_s
