"""Our vehicle beside real autopilots: one recorded setpoint stream, two flights, the same figures of both.

    python -m benchmarks sitl FOLDER        (or: make bench-sitl DATA=FOLDER)

FOLDER holds `arducopter.tlog` and `px4.tlog`: ArduCopter 4.6 and PX4 1.16 in their own simulators, flown by
setpoints at 20 Hz. Ours flies the bytes of the same client at the same times, in the airframe of the
simulator that was recorded and with an estimator as good as its was, under several seeds.

A row holds when ours, the mean over the seeds, is within 15 % (ArduCopter) or 25 % (PX4) of the recorded
figure; or within what a recording can resolve (its sample period; overshoot to a percent of the step); or,
where the estimator's wander limits it, within twice our own scatter from seed to seed: the recording is one
draw of as many, its own scatter being judged by the "hover" rows. A figure that wanders by more than its own
size, or that one of the flights never showed, is lost in the wander and marked so. Answers to commands, modes
and landed states have to be the same, mode changes within the second that a heartbeat takes.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, stdev
from typing import Final

from rich.table import Table

from benchmarks.autopilot.answers import Figures, Saying, figures, fly, sayings
from benchmarks.autopilot.autopilot_record import AutopilotRecord, read_tlog
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.base.errors import ConfigError

SMOKE: Final = ("--seeds", "1")
NEEDS: Final = "DATA: recordings of PX4 and ArduCopter"
FILES: Final[dict[AutopilotKind, str]] = {"ardupilot": "arducopter.tlog", "px4": "px4.tlog"}
SHARES: Final[dict[AutopilotKind, float]] = {"ardupilot": 0.15, "px4": 0.25}
SEEDS: Final[dict[AutopilotKind, int]] = {"ardupilot": 6, "px4": 6}
# what a recording resolves, by the unit in a row's name
RESOLUTION: Final = {"(s)": 0.03, "(m)": 0.02, "(m/s)": 0.02, "(%)": 1.0}
SCATTERS: Final = 2.0
HOVER: Final = "hover"


@dataclass(frozen=True)
class ComparisonRow:
    """One figure: recorded, ours over the seeds, how far apart they may be, and by which rule."""

    name: str
    recorded: float | None
    ours: float | None
    limit: float
    rule: str

    @property
    def holds(self) -> bool | None:
        """None when there is nothing to judge."""
        if self.recorded is None or self.ours is None or self.rule == "lost":
            return None
        return abs(self.ours - self.recorded) <= self.limit


def row(name: str, recorded: float | None, ours: Sequence[float | None], share: float) -> ComparisonRow:
    """Judge one figure."""
    shown = [value for value in ours if value is not None]
    if recorded is None or len(shown) < len(ours):
        return ComparisonRow(name, recorded, fmean(shown) if shown else None, 0.0, "lost")
    mean = fmean(shown)
    # the hover rows say whether ours scatters as much, so they may not rest on that scatter
    wanders = len(shown) > 1 and not name.startswith(HOVER)
    scatter = SCATTERS * stdev(shown) if wanders else 0.0
    resolution = RESOLUTION[name[name.rindex("(") :]]
    limits = {f"{share:.0%}": share * abs(recorded), "resolution": resolution, "scatter": scatter}
    rule = max(limits, key=lambda key: limits[key])
    if rule == "scatter" and scatter > abs(recorded):
        return ComparisonRow(name, recorded, mean, scatter, "lost")
    return ComparisonRow(name, recorded, mean, limits[rule], rule)


def compare(
    autopilot_kind: AutopilotKind, recorded: AutopilotRecord, seeds: int
) -> tuple[list[ComparisonRow], list[Saying]]:
    """Fly and judge one autopilot."""
    flights = [fly(autopilot_kind, recorded, seed) for seed in range(seeds)]
    theirs, ours = figures(recorded, autopilot_kind), [figures(flight, autopilot_kind) for flight in flights]
    return _rows(theirs, ours, SHARES[autopilot_kind]), sayings(autopilot_kind, recorded, flights[0])


def _rows(theirs: Figures, ours: Sequence[Figures], share: float) -> list[ComparisonRow]:
    return [row(name, value, [figure[name] for figure in ours], share) for name, value in theirs.items()]


# ---------------------------------------------------------------- printing


def show(
    report: BenchReport, autopilot_kind: AutopilotKind, rows: Sequence[ComparisonRow], said: Sequence[Saying]
) -> None:
    """One table an autopilot."""
    table = Table(title=f"{autopilot_kind}: recorded, and ours by the same setpoints")
    for heading in ("", "recorded", "ours", "ratio", "may differ by", "why", "holds"):
        table.add_column(heading, justify="left" if heading in ("", "why", "holds") else "right")
    for r in rows:
        both = r.recorded is not None and r.ours is not None and abs(r.recorded) > r.limit > 0.0
        ratio = f"{(r.ours or 0.0) / (r.recorded or 1.0):.2f}" if both else ""
        limit = "" if r.rule == "lost" else f"{r.limit:.2f}"
        table.add_row(r.name, _number(r.recorded), _number(r.ours), ratio, limit, r.rule, _word(r.holds))
    for s in said:
        table.add_row(s.name, s.recorded, s.ours, "", "", "same", _word(s.holds))
    report.show(table)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _word(holds: bool | None) -> str:
    return "-" if holds is None else "yes" if holds else "NO"


def verdict(
    autopilot_kind: AutopilotKind, rows: Sequence[ComparisonRow], said: Sequence[Saying]
) -> tuple[str, bool]:
    """A few words about what holds, and whether all does."""
    judged: list[tuple[str, bool | None]] = [(r.name, r.holds) for r in rows]
    judged += [(s.name, s.holds) for s in said]
    failed = [name for name, holds in judged if holds is False]
    counted = sum(holds is not None for _, holds in judged)
    words = f"{autopilot_kind}: {counted - len(failed)} of {counted} rows hold"
    return words + (f" (not: {'; '.join(failed)})" if failed else ""), not failed


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Show the comparison; the bars hold when every row does.

    Raises:
        ConfigError: there is no recording.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path, help="folder with arducopter.tlog and px4.tlog")
    parser.add_argument("--seeds", type=int, default=0, help="flights of ours each; 0: as many as it takes")
    chosen = parser.parse_args(arguments)
    report, bars = BenchReport(), list[tuple[str, bool]]()
    for autopilot_kind, file in FILES.items():
        try:
            recorded = read_tlog(chosen.folder / file)
            rows, said = compare(autopilot_kind, recorded, chosen.seeds or SEEDS[autopilot_kind])
        except (OSError, ValueError) as error:
            raise ConfigError(str(error)) from error
        show(report, autopilot_kind, rows, said)
        bars.append(verdict(autopilot_kind, rows, said))
    return report.judge(dict(bars))
