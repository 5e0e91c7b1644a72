"""Decides from the solver's result whether its plan is flown, and measures how long there has been none.

If the iterations run out, which happens while a wind needs more than the bounds allow, the result may be
close enough; otherwise the optimum without constraints is used, limited to the inputs' bounds. If time ran
out, or there is no result, the last answer is used further. m, s, m/s2.
"""

import math
from collections.abc import Collection

from companion.control.tracking import SolveOutcome, TrackingSolution

# OSQP's status values: solved to its tolerances; out of iterations, to ten times these or not even that
SOLVED, NEARLY_SOLVED, UNSOLVED = 1, 2, 7
UNFINISHED = (NEARLY_SOLVED, UNSOLVED)
# Out of iterations, with inputs at their bounds for long, the first input is within 0.2 m/s2 of the best by
# these: of the rows (m, m/s, m/s2), and of the gradient as a share of its parts.
ACCEPTED_PRIMAL = 0.05
ACCEPTED_DUAL_SHARE = 1e-2  # see above
# after so many solves in a row without a solution the last one is worth nothing
FAILURES_TO_STOP = 10
# a gust is over before; what cuts the inputs or takes all of the thrust or tilt for longer is a wind
GUST_S = 2.0


def outcome(status: int, *, primal: float, dual_share: float, late: bool) -> SolveOutcome:
    """What a search has come to: OSQP's status, how far its answer is from the rows and the optimum."""
    near = primal <= ACCEPTED_PRIMAL and dual_share <= ACCEPTED_DUAL_SHARE
    if status in (SOLVED, NEARLY_SOLVED) or (status == UNSOLVED and near):
        return SolveOutcome.SOLVED
    return SolveOutcome.CUT if status == UNSOLVED and not late else SolveOutcome.KEPT


class SolverHealth:
    """`begin` where no last answer is left to fly on; `note` every answer."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self.begin()

    def begin(self) -> None:
        """Nothing has been solved yet."""
        self._kept, self._cut, self._short = FAILURES_TO_STOP, 0, 0
        self.short_of = ""  # for longer than a gust

    def note(self, solution: TrackingSolution) -> None:
        """Count how often in a row it came to this, and how much more often than not it was short."""
        self._kept = self._kept + 1 if solution.outcome is SolveOutcome.KEPT else 0
        self._cut = self._cut + 1 if solution.outcome is SolveOutcome.CUT else 0
        # a cumulative sum: a turbulent wind takes all there is, lets go and takes it again
        most = math.ceil(GUST_S * self._rate_hz)
        self._short = min(most, self._short + 1) if solution.short_of else max(0, self._short - 1)
        self.short_of = solution.short_of if self._short == most else ""

    @property
    def stopped(self) -> bool:
        """Whether no plan is left that is worth flying."""
        return self._kept >= FAILURES_TO_STOP

    @property
    def cut_s(self) -> float:
        """For how long in a row the inputs were cut."""
        return self._cut / self._rate_hz

    def failure(self, limited: Collection[str]) -> str:
        """Why no plan is flown; "" while one is. `limited`: what the last gate made of the setpoint."""
        failed = self.stopped or self.cut_s >= GUST_S or "not_finite" in limited
        return "the controller finds no plan to fly" if failed else ""
