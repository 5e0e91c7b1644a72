"""The table of second sources: each quantity that a flight depends on is compared with another source.

A row names a quantity, its two sources, the allowed difference, and the reaction to a larger one. A monitor
measures both and makes a `SourceComparison`. `companion check`, the refusal of an order, the failsafe in
flight and `companion status` all judge it by its row, in the same words. A difference exceeds a bound only if
it does so by `SIGMA_THRESHOLD` of its own standard deviations. docs/reference/second-sources.md is written
from here.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from companion.base.messages import Quantity, SourceComparison

SIGMA_THRESHOLD: Final = 3.0
# reports and fixes come five times a second or more
OLDEST_S: Final = 2.0


class Reaction(StrEnum):
    """What follows in flight, where control is ours."""

    HAND_BACK = "control returns to the autopilot at once; in the final descent the app commands LAND"
    HAND_BACK_AWAY = "control returns to the autopilot at once, except in approach, descent and touchdown"
    LEAVE_PAD = "the vehicle climbs clear of the pad, then control returns to the autopilot"
    NOTICE = "a notice"


class SourceState(StrEnum):
    """What a comparison says."""

    NOT_MEASURED = "not measured"
    AGREES = "agrees"
    DIFFERS = "differs"  # announced, and flown with
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class SourceRow:
    """One quantity: its sources, the difference that is announced and the one that is not flown with.

    `built`: of what is built or set, and not of the moment: a comparison of long ago counts.
    `notice` and `bound` are in `unit`; None: nothing is announced, or refused. `before` says
    what follows beyond the bound before control is taken, `reaction` what in flight, or `in_flight` in words
    where an event of the mission's own table does; `hint`: what to look at.
    """

    quantity: Quantity
    first: str
    second: str
    unit: str
    built: bool = False
    notice: float | None = None
    bound: float | None = None
    before: str = "refused"
    reaction: Reaction | None = None
    in_flight: str = ""
    hint: str = ""

    def __post_init__(self) -> None:
        if self.reaction is not None:
            object.__setattr__(self, "in_flight", self.reaction.value)

    def announces(self, comparison: SourceComparison) -> bool:
        """Whether the difference exceeds the notice by `SIGMA_THRESHOLD`."""
        return _surely_beyond(comparison, self.notice)

    def refuses(self, comparison: SourceComparison) -> bool:
        """Whether the difference exceeds the bound by `SIGMA_THRESHOLD`."""
        return _surely_beyond(comparison, self.bound)

    def words(self, comparison: SourceComparison) -> str:
        """Both figures, and how far they may be apart."""
        most = self.bound if self.refuses(comparison) or self.notice is None else self.notice
        allowed = f", limit {most:g}" if most else ""
        hint = f": {self.hint}" if self.hint else ""
        return f"{self.quantity}: {self.figures(comparison)} apart{allowed}{hint}"

    def figures(self, comparison: SourceComparison) -> str:
        """Both figures, and their difference with its standard deviation."""
        return (
            f"{self.first} {comparison.first}, {self.second} {comparison.second}: "
            f"{comparison.difference:.1f} ±{comparison.std:.1f} {self.unit}"
        )


def _surely_beyond(comparison: SourceComparison, bound: float | None) -> bool:
    return bound is not None and comparison.difference - SIGMA_THRESHOLD * comparison.std > bound


_SHOWN: Final = "shown by companion status"

ROWS: Final = (
    SourceRow(
        Quantity.HOVER_THRUST,
        first="the vehicle's file",
        second="the autopilot's parameter; by attitude, the thrust that holds it in the air",
        unit="%",
        built=True,
        before="announced from 15 % on; by attitude, refused if the measured thrust is not known to 10 %, or "
        "is not 0.5 to 1.6 times one of the two",
        in_flight="learnt from the accelerometer; if the vehicle falls 0.5 m/s faster than planned, control "
        "returns to the autopilot",
    ),
    SourceRow(
        Quantity.ATTITUDE,
        first="our horizon",
        second="the autopilot's",
        unit="deg",
        notice=1.5,
        bound=3.0,
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
        reaction=Reaction.HAND_BACK,
        hint="is one compass disturbed, or the IMU's board turned?",
    ),
    SourceRow(
        Quantity.VELOCITY,
        first="ours",
        second="the nearer of the autopilot's and the GPS receiver's",
        unit="m/s",
        notice=0.5,
        bound=1.0,
        reaction=Reaction.HAND_BACK_AWAY,
        hint="has the IMU's board come loose?",
    ),
    SourceRow(
        Quantity.DECLINATION,
        first="magnetic_field_ned_ut",
        second="the World Magnetic Model at the GPS position",
        unit="deg",
        built=True,
        # the standard deviation holds what model and setting may err by
        notice=0.0,
        before="announced; if the heading is wrong because of it, the row heading refuses",
        in_flight="learnt from the GPS velocities of the first manoeuvres",
        hint="remove estimate.magnetic_field_ned_ut: the app then uses the model",
    ),
    SourceRow(
        Quantity.HEIGHT_OVER_PAD,
        first="the camera's",
        second="the echo",
        unit="m",
        before=_SHOWN,
        in_flight="if echoes are far shorter than that height, the app searches again (ground near)",
    ),
    SourceRow(
        Quantity.PAD_SCALE,
        first="the pad's file",
        second="the pad's motion against the IMU's, and the echoes",
        unit="%",
        built=True,
        notice=2.0,
        bound=4.0,
        reaction=Reaction.LEAVE_PAD,
        hint="measure a marker's edge, and the camera's focal length",
    ),
    SourceRow(
        Quantity.CAMERA_ROTATION,
        first="camera_yaw_deg",
        second="the pad's apparent motion against the IMU's",
        unit="deg",
        built=True,
        notice=10.0,
        bound=20.0,
        reaction=Reaction.LEAVE_PAD,
        hint="see companion check --pad",
    ),
    SourceRow(
        Quantity.CAMERA_DELAY,
        first="stamps with camera_time_offset_s",
        second="the pad's apparent motion while the gyroscope measures a turn",
        unit="ms",
        built=True,
        notice=20.0,
        bound=90.0,
        reaction=Reaction.LEAVE_PAD,
        hint="see calibrate-mount, and whether the camera's driver stamps its frames",
    ),
    SourceRow(
        Quantity.IMU_DELAY,
        first="our stamps",
        second="the autopilot's attitude by TIMESYNC",
        unit="ms",
        notice=60.0,
        bound=120.0,
        reaction=Reaction.HAND_BACK,
        hint="one direction of the link is slower than the other, or the IMU's stamps are late",
    ),
    SourceRow(
        Quantity.LINK_DELAY,
        first="half of TIMESYNC's round trip",
        second="turns seen by the camera against the same turns by telemetry",
        unit="ms",
        notice=20.0,
        # twice of it the IMU's samples are late, a message besides; for 0.1 s an acceleration is carried on
        bound=40.0,
        reaction=Reaction.LEAVE_PAD,
        hint="one direction of the link is slower than the other",
    ),
    SourceRow(
        Quantity.CLOCK_RATE,
        first="ours",
        second="the autopilot's by TIMESYNC",
        unit="%",
        before=_SHOWN,
        in_flight="stamps are mapped by the measured rate",
    ),
    SourceRow(
        Quantity.LEG_HEIGHT,
        first="the vehicle's file",
        second="measured where it stands",
        unit="cm",
        built=True,
        notice=4.0,
        # grass, a place measured by a ruler: 3 cm each; a vehicle that falls from there lands at 1 m/s
        bound=5.0,
        in_flight="approach and descent use the file's, the touchdown the mean of both, weighted by their "
        "variances; a height alone does not count as contact",
        hint="measure from the centre of mass to the feet, and range_position_body_m",
    ),
    SourceRow(
        Quantity.BATTERY,
        first="the share that the autopilot reports",
        second="none",
        unit="%",
        before="low: no take-off; critical: no landing is begun",
        in_flight="critical: control returns to the autopilot",
    ),
)
TABLE: Final = {row.quantity: row for row in ROWS}


def current(comparisons: Iterable[SourceComparison], now_s: float) -> tuple[SourceComparison, ...]:
    """Those that still say something: what changes is not known by a comparison of long ago."""
    return tuple(c for c in comparisons if TABLE[c.quantity].built or now_s - c.time_s <= OLDEST_S)


def judged(comparisons: Iterable[SourceComparison]) -> Iterator[tuple[SourceRow, SourceState, str]]:
    """Every row of the table with its newest comparison's judgement, and both figures in words."""
    newest = {comparison.quantity: comparison for comparison in comparisons}
    for row in ROWS:
        comparison = newest.get(row.quantity)
        if comparison is None:
            yield row, SourceState.NOT_MEASURED, "not measured yet"
        elif row.refuses(comparison):
            yield row, SourceState.REFUSED, row.figures(comparison)
        else:
            differs = row.announces(comparison)
            yield row, SourceState.DIFFERS if differs else SourceState.AGREES, row.figures(comparison)


def announced(comparisons: Iterable[SourceComparison]) -> Iterator[tuple[Quantity, str]]:
    """The comparisons beyond the notice, in words."""
    for comparison in comparisons:
        row = TABLE[comparison.quantity]
        if row.announces(comparison):
            yield comparison.quantity, row.words(comparison)


def refused(comparisons: Iterable[SourceComparison]) -> Iterator[tuple[Quantity, str]]:
    """The comparisons beyond the bound, in words."""
    for comparison in comparisons:
        row = TABLE[comparison.quantity]
        if row.refuses(comparison):
            yield comparison.quantity, row.words(comparison)
