"""Detects an attitude error, as after a step of the gyroscope's bias, by fixes that deviate to one side.

A bias that steps tilts the estimate, and the tilt drives the velocity away from the fixes in one direction
for seconds. Noise, however large, has no direction; a receiver that hangs or jumps is refused by its own
test. So a large deviation is not enough: it has to last in one direction, over fixes that are still
accepted. A large deviation without a direction is noise larger than stated, or an uncertain time; it
reduces the weight of the next fixes.

Changes of velocity show the heading without any compass: between two fixes the receiver's and ours differ
by our heading error. The uncertainty that the latest fixes leave decides whether another heading is
possible. Immutable, so that a snapshot may hold it.

Over seconds they also show how much of the force's error that vibration usually means is there at all: by
how much our velocity, uncorrected, drifts from the receiver's. That share goes on when there are none.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from companion.base.geometry import ZERO3, Vector3, between, dot, subtract
from companion.estimate.gating import CHI_SQUARE_999
from companion.estimate.vehicle.innovation_watch import WINDOW_S

# What follows is judged by two flights (decision 42): a step of 3 deg/s is found, a receiver that hangs is no
# error of the attitude.
EXCESS_SHARE: Final = 0.35  # of a new fix in the fading mean of the tests
SCATTER_SHARE: Final = 0.1  # the same, for the noise
DIRECTION_SHARE: Final = 0.2  # and in that of the direction
BOUND: Final = 4.5  # of the tests' mean, a degree of freedom; 1 when all is well
LARGEST_TEST: Final = 10.0  # one outlier counts as no more
ONE_SIDED: Final = 0.75  # the mean's square against the mean square: 1 when all point the same way
# the square of a fading mean of independent ones, as a share of theirs
_CHANCE: Final = DIRECTION_SHARE / (2.0 - DIRECTION_SHARE)
CHANCE_MARGIN: Final = 2.0  # so many times that are chance still; judged
FORCE_ERROR_S: Final = 1.0  # an erroneous force stays off for so long
DRIFT_S: Final = 0.2  # a force that is off leads the velocity away for so long before a fix shows it
MOST_REFUSED: Final = 5  # in a row; a jump needs more to show its direction
HEADING_S: Final = 5.0  # changes of velocity count for the heading that it has had for so long
FRESH_S: Final = 1.0  # a fix: receivers give one a second at least
DRIFT_SPAN_S: Final = 2.0 * FORCE_ERROR_S  # a force that is off shows by then, beside a receiver's noise
DRIFT_SPANS: Final = 10  # the fading mean goes back so far


class LastFix(NamedTuple):
    """The antenna's velocity (NED, m/s) at a fix: the receiver's, and ours after it."""

    time_s: float
    measured_m_s: Vector3
    estimated_m_s: Vector3


class VelocityDrift(NamedTuple):
    """How our velocity drifts from the receiver's, beside how it would if vibration did what it usually does.

    Level alone: not every receiver tells the climb. `seen` and `expected` (m²/s²) are of a span, the sum of
    two axes.
    """

    north_m_s: float = 0.0
    east_m_s: float = 0.0
    usual_m2_s2: float = 0.0
    span_s: float = 0.0
    spans: int = 0
    seen_m2_s2: float = 0.0
    expected_m2_s2: float = 0.0

    def after(self, north_m_s: float, east_m_s: float, usual_m2_s2: float, elapsed_s: float) -> VelocityDrift:
        """With what has come between two fixes; `usual_m2_s2` is what vibration usually does, on an axis."""
        north, east = self.north_m_s + north_m_s, self.east_m_s + east_m_s
        usual, span_s = self.usual_m2_s2 + usual_m2_s2, self.span_s + elapsed_s
        if span_s < DRIFT_SPAN_S:
            return self._replace(north_m_s=north, east_m_s=east, usual_m2_s2=usual, span_s=span_s)
        spans = self.spans + 1
        share = 1.0 / min(spans, DRIFT_SPANS)
        seen = self.seen_m2_s2 + share * (north * north + east * east - self.seen_m2_s2)
        expected = self.expected_m2_s2 + share * (2.0 * usual - self.expected_m2_s2)
        return VelocityDrift(spans=spans, seen_m2_s2=seen, expected_m2_s2=expected)

    def interrupted(self) -> VelocityDrift:
        """Without the span that has begun: a fix is missing."""
        return self._replace(north_m_s=0.0, east_m_s=0.0, usual_m2_s2=0.0, span_s=0.0)

    @property
    def share(self) -> float:
        """Of the force's error that vibration usually means, 1 at most."""
        # a mean of so many spans, of two axes each, errs by this much of itself
        surely = 1.0 - 1.0 / math.sqrt(min(max(self.spans, 1), DRIFT_SPANS))
        if self.seen_m2_s2 >= surely * self.expected_m2_s2:
            return 1.0
        return math.sqrt(self.seen_m2_s2 / (surely * self.expected_m2_s2))


class FixWatch(NamedTuple):
    """What the velocities of the last fixes had to say against the predicted ones."""

    excess: float = 1.0
    scatter: float = 1.0
    mean_m_s: Vector3 = ZERO3
    mean_square: float = 0.0
    suspected_s: float = -math.inf
    last: LastFix | None = None
    turn_information: float = 0.0  # 1/rad²
    informed_turn: float = 0.0  # that times the turn about down (rad) that our heading lacks
    drift: VelocityDrift = VelocityDrift()

    def after(self, innovation_m_s: Vector3, test: float) -> FixWatch:
        """With one fix more; `test` is its normalised innovation squared, a degree of freedom."""
        mean = between(self.mean_m_s, innovation_m_s, DIRECTION_SHARE)
        square = dot(innovation_m_s, innovation_m_s)
        return self._replace(
            excess=self.excess + EXCESS_SHARE * (min(test, LARGEST_TEST) - self.excess),
            scatter=self.scatter + SCATTER_SHARE * (min(test, LARGEST_TEST) - self.scatter),
            mean_m_s=mean,
            mean_square=self.mean_square + DIRECTION_SHARE * (square - self.mean_square),
        )

    def turned(
        self, fix: LastFix, predicted_m_s: Vector3, variance_m2_s2: float, usual_force_error_m_s2: float = 0.0
    ) -> FixWatch:
        """With how the velocity has changed since the last fix; the receiver's errs by a variance an axis.

        `predicted_m_s` is ours before this fix, `usual_force_error_m_s2` what vibration usually does to the
        force for a second or so.
        """
        last, elapsed_s = self.last, math.inf if self.last is None else fix.time_s - self.last.time_s
        if last is None or not 0.0 < elapsed_s <= FRESH_S:
            drift = self.drift.interrupted()
            return self._replace(last=fix, turn_information=0.0, informed_turn=0.0, drift=drift)
        north, east, _ = ours = subtract(predicted_m_s, last.estimated_m_s)
        apart = subtract(subtract(fix.measured_m_s, last.measured_m_s), ours)
        usual = usual_force_error_m_s2**2 * FORCE_ERROR_S * elapsed_s
        kept, weight = math.exp(-elapsed_s / HEADING_S), 0.5 / variance_m2_s2  # it errs at both fixes
        return self._replace(
            last=fix,
            turn_information=kept * self.turn_information + weight * (north * north + east * east),
            informed_turn=kept * self.informed_turn + weight * (north * apart[1] - east * apart[0]),
            drift=self.drift.after(apart[0], apart[1], usual, elapsed_s),
        )

    def refutes(self, turn_rad: float) -> bool:
        """Whether our heading fits the fixes far better than one turned by so much about down would."""
        better = turn_rad * (turn_rad * self.turn_information - 2.0 * self.informed_turn)
        return better > CHI_SQUARE_999[1]

    @property
    def noise_factor(self) -> float:
        """By how much the variance of the next fix's velocity exceeds what is claimed, 1 at least."""
        return 1.0 if self._one_sided else max(self.scatter, 1.0)

    @property
    def force_error_m_s2(self) -> float:
        """By how much the force's mean is off, as far as the fixes keep to one side for it.

        Of innovations without a direction the mean's square is `_CHANCE` of the mean square.
        """
        excess = dot(self.mean_m_s, self.mean_m_s) - CHANCE_MARGIN * _CHANCE * self.mean_square
        return math.sqrt(max(excess, 0.0)) / DRIFT_S

    @property
    def _one_sided(self) -> bool:
        return dot(self.mean_m_s, self.mean_m_s) > ONE_SIDED * self.mean_square

    def suspect(self, time_s: float) -> bool:
        """Whether the last suspicion has not had its effect yet."""
        return time_s - self.suspected_s < WINDOW_S

    def suspicious(self, time_s: float, refused_in_a_row: int) -> bool:
        """Whether the attitude is suspect; the fixes themselves have been refused so often."""
        return (
            self.excess > BOUND
            and self._one_sided
            and refused_in_a_row <= MOST_REFUSED
            and not self.suspect(time_s)
        )

    def suspected(self, time_s: float) -> FixWatch:
        """After the attitude was suspected."""
        return self._replace(excess=0.0, suspected_s=time_s)
