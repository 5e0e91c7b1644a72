"""Landings with what others own: one AprilTag, a fisheye lens, a camera on the network, a beacon on the pad.

    python -m benchmarks equipment
    python -m benchmarks equipment --case tag --px4 BIN --arducopter BIN --seeds 5

Rendered, in virtual time; give the same command again after an interruption, and it goes on. `tag`: one
AprilTag 36h11 of 40 cm from 12 m, standing and at 1 m/s. `fisheye`: 121 x 90 deg at 800x600. `network`:
frames 250 ms old, whose arrival scatters by 6 ms, with a delay that was measured 10 ms too short or too long.
`beacon`: the shipped scenario. `covered`: the same pad covered from the start, so that the beacon alone leads
there, by RTK on both sides, and then by ordinary GPS (no bar); the app must come over the pad and not land.
Even seeds fly with the behaviour of PX4, odd ones with ArduPilot's. With BIN the cases of the tag (or those
of `--case`) fly on that firmware instead, in lockstep.
"""

import argparse
import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Final

from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.campaign.bench_landing import fly, landed_share, unplanned_bar
from benchmarks.campaign.landing_cases import write_scenario
from benchmarks.firmware.bench_firmware import line, table
from benchmarks.report import BenchReport, watched
from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Outcome
from companion.config import CONFIG_FOLDER, find_file, merge, read_yaml
from companion.flightlog.record import FlightLog
from companion.sim.runner import fly as fly_here
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import Row
from sitl.campaign.tables import Bar, print_worst
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.as_built import NOTHING_ELSE

SMOKE: Final = ("--seeds", "1", "--case", "fisheye-line", "--jobs", "1")
OVER_PAD_M: Final = 1.5
OVER_PAD_S: Final = 2.0  # `plan.search.dwell_s`: as long as it stays over the pad's likely position
KINDS: Final[tuple[AutopilotKind, ...]] = ("px4", "ardupilot")
TAG_SEEDS: Final = 20
SEEDS: Final = 5
FISHEYE: Final = "fisheye_800x600"
LATENCY_S: Final = 0.25
SCATTER_S: Final = 0.006
DELAY_ERROR_S: Final = 0.01


@dataclass(frozen=True, slots=True)
class EquipmentCase:
    """A shipped scenario, and what is other than in its file."""

    name: str
    shipped: str
    seeds: int = SEEDS
    changes: dict[str, Any] = field(default_factory=dict)

    def content(self, kind: AutopilotKind) -> dict[str, Any]:
        """The scenario as its file has it, for an autopilot."""
        changed = merge(read_yaml(find_file("scenarios", self.shipped)), self.changes)
        return {**changed, "name": self.title(kind), "autopilot": kind}

    def title(self, kind: AutopilotKind) -> str:
        """The scenario's name."""
        return f"{self.name}-{kind}"


def _late(stamp_error_s: float) -> dict[str, Any]:
    """A stream: frames are dated by their arrival, less a delay that was measured with this error."""
    return {
        "camera": {
            "latency_s": LATENCY_S,
            "latency_jitter_s": SCATTER_S,
            "stamp_error_s": stamp_error_s,
        },
        "as_built": {**NOTHING_ELSE, "thrust_exponent": [1.0, 1.0], "exactly": {"stamp_jitter_s": SCATTER_S}},
        "companion": {"estimate": {"pad": {"exposure_jitter_s": SCATTER_S}}},
    }


_LINE: Final = {"kind": "line", "speed_m_s": 1.0, "meet": {"time_s": 24.0}}
_LENS: Final = {"camera": {"config": FISHEYE}, "companion": {"camera": FISHEYE}}
CASES: Final = (
    EquipmentCase("tag", "lone_tag", TAG_SEEDS),
    EquipmentCase("tag-line", "lone_tag", changes={"pad": {"motion": _LINE}}),
    *(EquipmentCase(f"fisheye-{name}", name, changes=_LENS) for name in ("static", "line", "circle")),
    EquipmentCase("network-delay-short", "line", changes=_late(DELAY_ERROR_S)),
    EquipmentCase("network-delay-long", "line", changes=_late(-DELAY_ERROR_S)),
    EquipmentCase("beacon", "beacon"),
)
_COVERED: Final = {"time_limit_s": 45.0, "faults": [{"kind": "pad_covered", "start_s": 0.0}]}
COVERED: Final = (
    EquipmentCase(
        "covered-rtk",
        "beacon",
        changes={
            **_COVERED,
            "sensors": {"gps_noise_factor": 0.1},
            "beacon": {"position_std_m": 0.02},
            "companion": {"estimate": {"ekf": {"gps_position_noise_m": 0.1, "gps_accuracy_factor": 0.03}}},
        },
    ),
    EquipmentCase("covered-gps", "beacon", changes=_COVERED),
)


# ---------------------------------------------------------------- landings


def write_flights(
    cases: Sequence[EquipmentCase],
    seeds: int | None,
    folder: Path,
    specs: Sequence[FirmwareSpec] = (),
) -> list[CampaignRun]:
    """Each case on the bundled autopilots in turn, or on each firmware; `seeds` instead of the case's own."""
    flights = list[CampaignRun]()
    for case in cases:
        numbers = range(case.seeds if seeds is None else seeds)
        flown_by: list[tuple[AutopilotKind, FirmwareSpec | None, range]]
        flown_by = [(spec.kind, spec, numbers) for spec in specs] or [
            (kind, None, numbers[turn :: len(KINDS)]) for turn, kind in enumerate(KINDS)
        ]
        for kind, spec, own in flown_by:
            flights += write_scenario(case.content(kind), own, folder, spec)
    return flights


def landing_bars(name: str, rows: Sequence[Row]) -> list[Bar]:
    """All landed, and nothing was touched before."""
    return [landed_share(name, rows, 1.0), unplanned_bar(name, rows)]


# ---------------------------------------------------------------- the beacon alone


@dataclass(frozen=True, slots=True)
class CoveredFlight:
    """How near the pad it came (m, horizontally), how long at once it was over it, and whether it landed."""

    nearest_m: float
    over_pad_s: float
    landed: bool


def covered_flight(asked: CampaignRun) -> CoveredFlight:
    """Fly to a pad that no camera sees; distances are by the truth."""
    trial = Trial.load(asked.source, asked.seed)
    log = FlightLog(None, start_unix_s=0.0)
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    report = fly_here(settings, trial, log, lambda _status: None, fast=True).report
    away = [
        (truth.time_s, math.dist(truth.vehicle_position_ned_m[:2], truth.pad_position_ned_m[:2]))
        for truth in report.truth
    ]
    touched = report.outcome is Outcome.LANDED or report.touchdown is not None
    return CoveredFlight(min(distance for _, distance in away), longest_within(away, OVER_PAD_M), touched)


def longest_within(away: Sequence[tuple[float, float]], limit_m: float) -> float:
    """The longest time at once within a distance, of samples (s, m)."""
    longest_s, since_s = 0.0, math.nan
    for time_s, distance_m in away:
        if distance_m > limit_m:
            since_s = math.nan
            continue
        since_s = time_s if math.isnan(since_s) else since_s
        longest_s = max(longest_s, time_s - since_s)
    return longest_s


def covered_bar(name: str, flights: Sequence[CoveredFlight]) -> Bar:
    """Each came over the pad, for as long as the search waits there, and did not land."""
    good = sum(flight.over_pad_s >= OVER_PAD_S and not flight.landed for flight in flights)
    text = f"{good} of {len(flights)} within {OVER_PAD_M:g} m for {OVER_PAD_S:g} s"
    return Bar(name, text, good == len(flights) > 0)


def fly_covered(
    cases: Sequence[EquipmentCase], seeds: int | None, folder: Path, report: BenchReport
) -> list[Bar]:
    """Fly them, and show a table; ordinary GPS on both sides has no bar."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    headings = ("pad covered, beacon alone", "nearest m\np50 worst", "s at once\nwithin 1.5 m", "landed")
    for heading in headings:
        shown.add_column(heading, no_wrap=True)
    bars = []
    for case in cases:
        asked = write_flights([case], seeds, folder)
        flights = [covered_flight(each) for each in watched(asked, case.name)]
        nearest = [flight.nearest_m for flight in flights]
        shown.add_row(
            case.name,
            f"{median(nearest):.2f} {max(nearest):.2f}",
            " ".join(f"{flight.over_pad_s:.1f}" for flight in flights),
            str(sum(flight.landed for flight in flights)),
        )
        if case.name == "covered-rtk":
            bars.append(covered_bar(case.name, flights))
    report.show(shown)
    return bars


# ---------------------------------------------------------------- the whole


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the tables, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--seeds", type=int, help="of each case; else 20 of the standing tag and 5 of the others"
    )
    parser.add_argument("--case", default="", help="cases whose name begins so, alone")
    parser.add_argument("--px4", type=Path, help="the program px4")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=Path("flights/bench-equipment"))
    options = parser.parse_args(arguments)
    paths: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    specs = [spec for kind, path in paths.items() if path and (spec := FirmwareSpec.of(kind, path))]
    prefix = options.case or ("tag" if specs else "")
    return judge([case for case in CASES if case.name.startswith(prefix)], specs, options, BenchReport())


def judge(
    cases: Sequence[EquipmentCase],
    specs: Sequence[FirmwareSpec],
    options: argparse.Namespace,
    report: BenchReport,
) -> BenchReport:
    """Fly what has no row yet."""
    # rows of a firmware stay apart from the bundled autopilot's, which have the same names
    folder = options.out / "firmware" if specs else options.out
    folder.mkdir(parents=True, exist_ok=True)
    flights = write_flights(cases, options.seeds, folder, specs)
    report.show(f"{len(flights)} landings")
    rows = fly(flights, folder, options.jobs, report) if flights else []
    lines, bars = [], list[Bar]()
    # by firmware; with the bundled autopilots the two of a case together
    groups: list[tuple[AutopilotKind, ...]] = [(spec.kind,) for spec in specs] or [KINDS]
    for case, kinds in itertools.product(cases, groups):
        of_case = [row for row in rows if row.scenario in {case.title(kind) for kind in kinds}]
        name = case.title(kinds[0]) if specs else case.name
        lines.append(line(name, of_case))
        bars += landing_bars(name, of_case)
    if lines:
        report.show(table(lines))
        print_worst(report, rows)
    covered = [case for case in COVERED if case.name.startswith(options.case) and not specs]
    if covered:
        bars += fly_covered(covered, options.seeds, folder, report)
    return report.judge(bars)
