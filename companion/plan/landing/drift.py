"""The drift of a vehicle that levels off for a contact, and the way on which it comes against that.

A level vehicle lacks a part of the acceleration that pad and wind ask for. What it lacks grows from nothing
as the tilt falls, is then there until the contact, and makes it drift. So it has to come to the place, and
with the speed, from which it drifts to the pad's middle and is still there. Horizontal, relative to the
pad: north + i east, m, s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from companion.base.geometry import ZERO3
from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.trajectory.course import CHECKED, Course, stretched
from companion.plan.trajectory.min_jerk import Trajectory, plan

LEVELS_M_S3: Final = 8.0  # how fast the tilt falls, `RESPONDS_S` after the decision to level off
# The attitude stays level for so long after the contact was due.
AFTER_S: Final = 0.11
# It begins to come against the drift so long before that, or longer where the limits ask for it: earlier, the
# air may be another by then. It is as long over the pad's middle again if no contact comes.
LEADS_S: Final = 1.0
FOLLOWS_S: Final = 0.25  # a way that is shorter is not followed, and its tilt is still there at the contact
_SHORTEST_S: Final = 1e-3
_TINY: Final = 1e-12


@dataclass(frozen=True, slots=True)
class Drift:
    """What a level vehicle lacks, all of it for `level_s` before a contact at `due_s`."""

    lacks_m_s2: complex
    due_s: float
    level_s: float

    @property
    def begins_s(self) -> float:
        """When it begins to lack something."""
        return self.due_s - self.level_s - self._levels_s

    @property
    def _levels_s(self) -> float:
        return max(_SHORTEST_S, abs(self.lacks_m_s2) / LEVELS_M_S3)

    def _gains(self, time_s: float) -> tuple[complex, complex]:
        """What it is given by that from a time on until the contact: speed, and way beside its own."""
        levels_s, level_s = self._levels_s, min(self.level_s, self.due_s - time_s)
        left_s = min(levels_s, max(0.0, self.due_s - self.level_s - time_s))  # of levelling off
        fully_s = left_s - 0.5 * left_s**2 / levels_s
        way_s2 = 0.5 * level_s**2 + level_s * fully_s + left_s**2 * (0.5 - left_s / (3.0 * levels_s))
        return -self.lacks_m_s2 * (level_s + fully_s), -self.lacks_m_s2 * way_s2

    def contact(self, motion: Motion, time_s: float) -> Motion:
        """How a vehicle touches that moves like this at a time."""
        speed, way = self._gains(time_s)
        place, velocity, _ = _flat(motion)
        return _aside(place + velocity * (self.due_s - time_s) + way, velocity + speed)

    def towards_middle(self, time_s: float, share: float = 1.0) -> Motion:
        """The motion with which it drifts to the pad's middle and is still there.

        share: less than 1, of the way and speed at `begins_s`: then it goes beyond the middle.
        """
        place, speed = self._still_in_middle(time_s)
        begins, begins_m_s = self._still_in_middle(self.begins_s)
        missing = 1.0 - share
        return _aside(
            place - missing * (begins + begins_m_s * (time_s - self.begins_s)), speed - missing * begins_m_s
        )

    def _still_in_middle(self, time_s: float) -> tuple[complex, complex]:
        speed, way = self._gains(time_s)
        return speed * (self.due_s - time_s) - way, -speed

    def lead(self, at: Callable[[float], Motion], limits: GuidanceConfig, now_s: float) -> Course | None:
        """The way to such a contact, as far as the limits let it; None: it is too late for one.

        at: where the reference goes otherwise. The way begins at its own start.
        """
        longest_s = self.begins_s - now_s
        if longest_s < FOLLOWS_S:
            return None
        soon_s, ends = min(LEADS_S, longest_s), self.towards_middle(self.begins_s)
        here = _aside(*_flat(at(self.begins_s - soon_s)))
        way = stretched(lambda times: plan(here, ends, 0.0, min(longest_s, times * soon_s)), limits)
        starts_s = self.begins_s - way.duration_s
        here = _aside(*_flat(at(starts_s)))
        share = _allowed_share(here, ends, way.duration_s, limits.horizontal_acceleration_m_s2)
        if share is None:
            return None
        begins = self.towards_middle(self.begins_s, share)
        return self._course(plan(here, begins, starts_s, way.duration_s), begins, share)

    def _course(self, way: Trajectory, begins: Motion, share: float) -> Course:
        level_from_s, ends_s = self.due_s - self.level_s, self.due_s + AFTER_S
        level, ends = (
            replace(
                self.towards_middle(time_s, share),
                acceleration_m_s2=(-self.lacks_m_s2.real, -self.lacks_m_s2.imag, 0.0),
            )
            for time_s in (level_from_s, ends_s)
        )
        return Course(
            (
                way,
                plan(begins, level, self.begins_s, self._levels_s),
                plan(level, ends, level_from_s, ends_s - level_from_s),
                plan(ends, Motion(ZERO3), ends_s, LEADS_S),
            )
        )


def _allowed_share(here: Motion, ends: Motion, lasts_s: float, most_m_s2: float) -> float | None:
    """How much of an end, at most 1, a way from here may lead to within the acceleration allowed; None: none.

    A way's acceleration is the start's part and so much of the end's.
    """
    by_start, by_end = plan(here, Motion(ZERO3), 0.0, lasts_s), plan(Motion(ZERO3), ends, 0.0, lasts_s)
    most_m_s2 = max(most_m_s2, abs(_flat(here)[2]))
    least, largest = 0.0, 1.0
    for k in range(1, CHECKED + 1):
        at_s = k * lasts_s / CHECKED
        begun, ended = _flat(by_start.at(at_s))[2], _flat(by_end.at(at_s))[2]
        # |begun + share ended| = most
        square, half = abs(ended) ** 2 + _TINY, (begun * ended.conjugate()).real
        root = half**2 - square * (abs(begun) ** 2 - most_m_s2**2)
        if root < 0.0:
            return None
        least = max(least, (-half - math.sqrt(root)) / square)
        largest = min(largest, (-half + math.sqrt(root)) / square)
    return largest if least <= largest else None


def _flat(motion: Motion) -> tuple[complex, complex, complex]:
    place, velocity, acceleration = (
        complex(*row[:2]) for row in (motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2)
    )
    return place, velocity, acceleration


def _aside(place: complex, velocity: complex = 0j, acceleration: complex = 0j) -> Motion:
    """A horizontal motion, each of its rows north + i east."""
    return Motion(*((row.real, row.imag, 0.0) for row in (place, velocity, acceleration)))
