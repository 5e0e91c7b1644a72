"""The second sources' newest comparisons, from where they are measured, and what is announced of them."""

from __future__ import annotations

from companion.app.sensing import Notify
from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import announced
from companion.estimate.estimator import StateEstimator


class SourceWatch:
    """Ask it in every cycle; each quantity whose sources differ is announced once a mission."""

    def __init__(self, estimator: StateEstimator, notify: Notify) -> None:
        self._estimator, self._notify = estimator, notify
        self._announced: set[Quantity] = set()

    def begin(self) -> None:
        """A new mission."""
        self._announced.clear()

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        """The newest of each."""
        return self._estimator.comparisons

    def look(self) -> tuple[SourceComparison, ...]:
        """The newest of each; announces what was not announced before."""
        found = self.comparisons
        for quantity, words in announced(found):
            if quantity not in self._announced:
                self._announced.add(quantity)
                self._notify("sources", words, "warning")
        return found
