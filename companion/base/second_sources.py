"""The table of second sources: no number that holds the vehicle up is believed on one word.

A row names a quantity, its two sources, how far they may be apart, and what follows when they are further.
Where the two are measured, a monitor makes a `SourceComparison` of them; `companion check`, the refusal of an
order, the failsafe in flight and `companion status` all judge it by its row, in the same words. The
difference counts as beyond a bound when it is so for sure: by `SIGMA_THRESHOLD` of its own standard
deviations. docs/second-sources.md is written from here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from companion.base.messages.sources import Quantity, SourceComparison

SIGMA_THRESHOLD: Final = 3.0


class Reaction(StrEnum):
    """What follows in flight, where control is ours."""

    HAND_BACK = "control returns to the autopilot at once; in the last centimetres it lands by LAND"
    LEAVE_PAD = "it climbs clear of the pad, then control returns to the autopilot"
    NOTICE = "a notice"


@dataclass(frozen=True, slots=True)
class SourceRow:
    """One quantity: its sources, the difference that is announced and the one that is not flown with.

    `notice` and `bound` are in `unit`; None: nothing is announced, or refused. `before` says
    what follows beyond the bound before control is taken, `reaction` what in flight; `hint`: what to look at.
    """

    quantity: Quantity
    first: str
    second: str
    unit: str
    notice: float | None
    bound: float | None
    before: str
    reaction: Reaction
    hint: str = ""

    @property
    def in_flight(self) -> str:
        """What follows in flight, in words."""
        return self.reaction.value

    def announces(self, comparison: SourceComparison) -> bool:
        """Whether the two are surely so far apart that it is announced."""
        return _surely_beyond(comparison, self.notice)

    def refuses(self, comparison: SourceComparison) -> bool:
        """Whether the two are surely so far apart that nobody flies with it."""
        return _surely_beyond(comparison, self.bound)

    def words(self, comparison: SourceComparison) -> str:
        """Both figures, and how far they may be apart."""
        most = self.bound if self.refuses(comparison) or self.notice is None else self.notice
        allowed = "" if most is None else f", at most {most:g} expected"
        hint = f": {self.hint}" if self.hint else ""
        return (
            f"{self.quantity}: {self.first} {comparison.first}, {self.second} {comparison.second}: "
            f"{comparison.difference:.3g} {self.unit} apart{allowed}{hint}"
        )


def _surely_beyond(comparison: SourceComparison, bound: float | None) -> bool:
    return bound is not None and comparison.difference - SIGMA_THRESHOLD * comparison.std > bound


_REFUSED: Final = "refused"

ROWS: Final = (
    SourceRow(
        Quantity.ATTITUDE,
        first="our horizon",
        second="the autopilot's",
        unit="deg",
        notice=1.5,
        bound=3.0,
        before=_REFUSED,
        reaction=Reaction.HAND_BACK,
        hint="is the IMU's board loose, or sense.imu.body_from_sensor_deg wrong?",
    ),
    SourceRow(
        Quantity.HEADING,
        first="ours",
        second="the autopilot's",
        unit="deg",
        notice=10.0,
        bound=20.0,
        before=_REFUSED,
        reaction=Reaction.HAND_BACK,
        hint="is one compass disturbed, or the IMU's board turned?",
    ),
    SourceRow(
        Quantity.CAMERA_ROTATION,
        first="camera_yaw_deg",
        second="the pad's apparent motion against the IMU's",
        unit="deg",
        notice=10.0,
        bound=20.0,
        before=_REFUSED,
        reaction=Reaction.LEAVE_PAD,
        hint="see companion check --pad",
    ),
)
TABLE: Final = {row.quantity: row for row in ROWS}


def announced(comparisons: Iterable[SourceComparison]) -> Iterator[tuple[Quantity, str]]:
    """Those whose sources are surely further apart than goes unsaid, in words."""
    for comparison in comparisons:
        row = TABLE[comparison.quantity]
        if row.announces(comparison):
            yield comparison.quantity, row.words(comparison)


def refused(comparisons: Iterable[SourceComparison]) -> Iterator[tuple[Quantity, str]]:
    """Those that nobody flies with, in words."""
    for comparison in comparisons:
        row = TABLE[comparison.quantity]
        if row.refuses(comparison):
            yield comparison.quantity, row.words(comparison)
