"""The tolerances for starting down and for going on; they widen the longer a try lasts.

Relative to the pad, NED axes, m and s.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import NormalDist

from companion.base.messages import PadState
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import TouchdownConfig
from companion.plan.landing.contact import RESPONDS_S, UNSEEN_S

# Waiting it heaves by so much in gusts; what is left of a sink at the commit is added to the planned one.
_HEIGHT_TOLERANCE_M = 0.10
_SINK_TOLERANCE_M_S = 0.15
# In units of `gentle_wait_s`: from then on the tolerances widen steadily, to 2.4 times after six.
_WAITS_UNTIL_WIDER = 2.0
_TOLERANCE_GROWTH = 0.35
# After one wait, a tilt so little above the least within `gentle_wait_s` is a lull: a wind that does not
# calm has none better.
_LULL_M_S2 = 0.2
_LULL_S = 0.5
# The tolerance aside never exceeds this, unless the setting does.
_FARTHEST_ASIDE_M = 0.12
# A gust that has just begun shows in the speed first: the offset is judged so far ahead, the time from an
# estimate to the flown correction (the control's cycle, the command's delay, the autopilot's response).
_DRIFT_S = 0.22
# It breaks off for an offset that is out of tolerance with this probability, by the estimate's covariance; it
# starts down by the estimate itself.
_BREAKS_OFF_STD = NormalDist().inv_cdf(0.9)
# A sink is stopped at this rate, after `RESPONDS_S`: without that room no break-off begins.
_STOPS_M_S2 = 2.5
# Sliding over the pad slows it down by so much, with half its weight on the feet (friction 0.6).
_SLIDES_M_S2 = 3.0
_SLIDES_M_S = 0.5  # slower it stays where it touches
# While it corrects it tilts this much more than now or at contact: a foot hangs lower.
_TILTS_MORE_RAD = math.radians(3.0)


def gentle(sight: PadState, config: TouchdownConfig) -> bool:
    """Whether the pad accelerates little enough for a soft contact."""
    a = sight.acceleration_ned_m_s2
    return (
        math.hypot(a[0], a[1]) <= config.gentle_horizontal_m_s2 and abs(a[2]) <= config.gentle_vertical_m_s2
    )


def aligned(sight: PadState, wait_height_m: float, tolerance_scale: float, config: TouchdownConfig) -> bool:
    """Whether the vehicle is over the pad's centre closely and quietly enough to commit."""
    return (
        sight.unseen_s <= UNSEEN_S
        and sight.lateral_m <= config.lateral_m * tolerance_scale
        and sight.lateral_speed_m_s <= config.lateral_speed_m_s * tolerance_scale
        and abs(sight.height_m - wait_height_m) <= _HEIGHT_TOLERANCE_M * tolerance_scale
        and abs(sight.sink_m_s) <= _SINK_TOLERANCE_M_S * tolerance_scale
    )


def room_to_stop_m(sink_m_s: float, tilt_rad: float, foot_reach_m: float) -> float:
    """How much lower the lowest foot of a vehicle that sinks and tilts so gets before it rises."""
    sink = max(0.0, sink_m_s)
    below_m = foot_reach_m * math.sin(tilt_rad + _TILTS_MORE_RAD)
    return sink * RESPONDS_S + sink * sink / (2.0 * _STOPS_M_S2) + below_m


def slides_off(sight: PadState, farthest_m: float) -> str:
    """Says so when feet that touch would slide farther aside than that, the pad having stopped; else "".

    By the speed that was seen: a vehicle that is stopped at the contact feels the same whether it slides over
    the pad from then on or the pad has stopped with it, and the next sightings tell.
    """
    (x, y, _), (vx, vy, _) = sight.relative_position_ned_m, sight.seen_velocity_ned_m_s
    speed_m_s = math.hypot(vx, vy)
    slides_s = 0.5 * speed_m_s / _SLIDES_M_S2
    # a filter that has just started says any speed, but not that it knows it
    known = sight.unseen_s <= UNSEEN_S and speed_m_s >= max(
        _SLIDES_M_S, SIGMA_THRESHOLD * sight.velocity_std_m_s
    )
    off = known and math.hypot(x + slides_s * vx, y + slides_s * vy) > farthest_m
    return f"sliding over the pad at {speed_m_s:.1f} m/s" if off else ""


class Tolerance:
    """The tolerances of one try, from `since_s` on; `tolerance_scale` widens all of them."""

    def __init__(self, config: TouchdownConfig, since_s: float, tolerance_scale: float) -> None:
        self._config, self.since_s, self.tolerance_scale = config, since_s, tolerance_scale
        self._tilts: deque[tuple[float, float]] = deque()  # of the last gentle_wait_s: when, m/s²

    def note_tilt(self, tilt_m_s2: float, now_s: float) -> None:
        """Take in how much tilt a contact would have met, while waiting."""
        tilts = self._tilts
        while tilts and tilts[-1][1] > tilt_m_s2:
            tilts.pop()
        tilts.append((now_s, tilt_m_s2))
        while now_s - tilts[0][0] > self._config.gentle_wait_s:
            tilts.popleft()

    @property
    def escape_m(self) -> float:
        """Farther aside the feet may miss the pad: it climbs and tries again."""
        return self._config.escape_lateral_m * self.tolerance_scale

    def waits_passed(self, now_s: float) -> float:
        """How many `gentle_wait_s` have passed since this try began."""
        return (now_s - self.since_s) / self._config.gentle_wait_s

    def slack_by_now(self, now_s: float) -> float:
        """The tolerance_scale, wider after two waits."""
        return self.tolerance_scale * (1.0 if self.waits_passed(now_s) < _WAITS_UNTIL_WIDER else 1.5)

    def exceeds_lateral_tolerance(self, sight: PadState, now_s: float, *, surely: bool = False) -> bool:
        """Whether the vehicle is too far aside to start down, or will be; `surely`: to go on.

        A vehicle that sinks is not stopped for what is the estimate's own noise.
        """
        (x, y, _), (vx, vy, _) = sight.relative_position_ned_m, sight.relative_velocity_ned_m_s
        soon_m = math.hypot(x + _DRIFT_S * vx, y + _DRIFT_S * vy)
        now_std_m, soon_std_m = (
            _BREAKS_OFF_STD * sight.lateral_std_m(ahead_s) if surely else 0.0 for ahead_s in (0.0, _DRIFT_S)
        )
        farthest_m = self._farthest_aside_m(now_s)
        aside = sight.lateral_m - now_std_m > farthest_m
        return aside or soon_m - soon_std_m > farthest_m * self._tolerance_growth(now_s)

    def max_horizontal_acceleration_m_s2(self, now_s: float) -> float:
        """How much tilt (m/s²) at contact is borne: grows with the waits, and is no less than a lull's."""
        borne_m_s2 = self._config.gentle_tilt_m_s2 * self._tolerance_growth(now_s)
        if not self._tilts or self.waits_passed(now_s) < 1.0:
            return borne_m_s2
        (since_s, least_m_s2), (until_s, _) = self._tilts[0], self._tilts[-1]
        turned = until_s - since_s >= _LULL_S  # what falls still may fall on
        return max(borne_m_s2, least_m_s2 + _LULL_M_S2) if turned else borne_m_s2

    def most_tilt_rad(self, now_s: float) -> float:
        """How far a deck may tilt at contact; grows with the waits."""
        return math.radians(self._config.contact_deck_tilt_deg) * self._tolerance_growth(now_s)

    def _farthest_aside_m(self, now_s: float) -> float:
        """Farther aside than this it neither starts down nor goes on."""
        setting_m = self._config.break_off_lateral_m
        return min(max(setting_m, _FARTHEST_ASIDE_M), setting_m * self.slack_by_now(now_s))

    def _tolerance_growth(self, now_s: float) -> float:
        """Factor on the tolerances of tilt and drift, which will not get less by waiting."""
        return 1.0 + _TOLERANCE_GROWTH * max(0.0, self.waits_passed(now_s) - _WAITS_UNTIL_WIDER)
