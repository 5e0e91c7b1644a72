"""Landings on the real PX4 and the real ArduCopter, in lockstep with the bundled world.

    python -m benchmarks firmware --px4 BIN --arducopter BIN --seeds 10

Every seed flies a vehicle about which its builder is wrong (`sitl.scenario.as_built`); with `--as-believed`
it is what the files say, but for the hover thrust, of which the firmware has its own default.

`--out DIR` says where the flights are kept (default: flights/bench-firmware).

BIN is each firmware's SITL build. Give the same command again after an interruption, and it goes on.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.campaign.bench_landing import fly, landed_share, unplanned_bar
from benchmarks.campaign.landing_cases import BOUNDS, MEET, PLACE_NED_M, write_scenario
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError, Kind
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import Row
from sitl.campaign.tables import Bar, at_most, print_worst, values
from sitl.firmware.spec import FirmwareSpec

SMOKE: Final = ("--seeds", "1", "--jobs", "1")
NEEDS: Final = "PX4 or ARDUCOPTER"
LEAST_LANDED: Final = 0.98
AS_BUILT_LANDED: Final = 0.97
CALM_MEDIAN_CM: Final = 5.0
WINDY_MEDIAN_CM: Final = 8.0


def median_bar(name: str, case: FirmwareCase, rows: Sequence[Row]) -> Bar:
    """The bar on a case's median lateral error."""
    limit = WINDY_MEDIAN_CM if case.windy else CALM_MEDIAN_CM
    lateral = values(rows, "touchdown_lateral_m")
    median = 100.0 * float(np.median(lateral)) if lateral else float("inf")
    return at_most(f"{name} lateral p50", median, limit, "cm")


def line(name: str, rows: Sequence[Row]) -> list[str]:
    """A row of the table."""
    columns = ("touchdown_lateral_m", "vertical_speed_m_s", "horizontal_speed_m_s")
    figures = [values(rows, column) for column in columns]
    cells = [
        f"{factor * float(np.median(v)):.{digits}f} {factor * max(v):.{digits}f}" if v else "-"
        for v, factor, digits in zip(figures, (100.0, 1.0, 1.0), (1, 2, 2), strict=True)
    ]
    ends = ", ".join(sorted({row.outcome for row in rows if not row.landed}))
    return [name, f"{sum(row.landed for row in rows)}/{len(rows)}", *cells, ends]


def table(lines: Sequence[Sequence[str]]) -> Table:
    """All lines."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column("firmware, setpoint, case", no_wrap=True)
    for heading in ("landed", "lateral cm\np50 worst", "down m/s\np50 worst", "sideways m/s\np50 worst"):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("other ends")
    for cells in lines:
        shown.add_row(*cells)
    return shown


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--px4", type=Path, help="the program px4")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--case", default="", help="cases whose name begins so, alone")
    parser.add_argument(
        "--setpoint", choices=get_args(Kind), default="", help="this kind alone, instead of those shipped"
    )
    parser.add_argument(
        "--sensors",
        choices=("boards", "autopilot"),
        default="boards",
        help="IMU, compass and GPS of whom the app flies by",
    )
    parser.add_argument("--as-believed", action="store_true", help="vehicles that are as their files say")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=Path("flights/bench-firmware"))
    options = parser.parse_args(arguments)
    paths: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    specs = [spec for kind, path in paths.items() if path and (spec := FirmwareSpec.of(kind, path))]
    if not specs:
        raise ConfigError("bench-firmware: expected --px4 BIN, --arducopter BIN or both")
    return judge(specs, options, BenchReport())


def judge(specs: Sequence[FirmwareSpec], options: argparse.Namespace, report: BenchReport) -> BenchReport:
    """Fly what has no row yet."""
    options.out.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.seeds)
    cases = tuple(case for case in CASES if case.name.startswith(options.case))
    kinds = [
        (spec, setpoint)
        for spec in specs
        for setpoint in ((options.setpoint,) if options.setpoint else SETPOINTS[spec.kind])
    ]
    as_built = not options.as_believed
    flights = [
        flight
        for spec, setpoint in kinds
        for flight in write_flights(
            spec, setpoint, options.sensors, cases, seeds, options.out, as_built=as_built
        )
    ]
    report.show(f"{len(flights)} flights")
    rows = fly(flights, options.out, options.jobs, report)
    lines, bars = [], []
    for spec, setpoint in kinds:
        of_kind: list[Row] = []
        for case in cases:
            name = case.title(spec.kind, setpoint, options.sensors, as_built=as_built)
            of_case = [row for row in rows if row.scenario == name]
            of_kind += of_case
            lines.append(line(name, of_case))
            bars.append(median_bar(name, case, of_case))
        least = AS_BUILT_LANDED if as_built else LEAST_LANDED
        bars.append(landed_share(f"{spec.kind} {setpoint} landed", of_kind, least))
        bars.append(unplanned_bar(f"{spec.kind} {setpoint}", of_kind))
    report.show(table(lines))
    print_worst(report, rows)
    return report.judge(bars)


# ---------------------------------------------------------------- firmware cases
# The flights of `bench_firmware`: landings on the real PX4 and the real ArduCopter.
#
# Calm air and lines, a circle and a figure-8; 8 m/s of wind with Dryden turbulence of moderate intensity
# (MIL-F-8785C); a sea. Each under both kinds of setpoint that the autopilot may be sent.
#
# As built, the firmware is told the hover thrust that the builder believed; as believed, it is told none and
# begins with its own default, so that neither bench gives it the truth.

Sensors = Literal["boards", "autopilot"]
WIND: Final = {"mean_m_s": 8.0, "turbulence": "moderate"}
CALM: Final[dict[str, Any]] = {"mean_m_s": 0.0}
# what each is sent by default first; velocities to ArduPilot are no part of what has to land
SETPOINTS: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "px4": ("acceleration", "attitude"),
    "ardupilot": ("attitude",),
}


@dataclass(frozen=True, slots=True)
class FirmwareCase:
    """Landings that are judged together."""

    name: str
    windy: bool
    pad: dict[str, Any]

    def scenario(
        self, kind: AutopilotKind, setpoint: str, sensors: Sensors = "boards", *, as_built: bool = False
    ) -> dict[str, Any]:
        """The scenario as its file has it; `sensors`: IMU, compass and GPS of whom the app flies by."""
        return {
            **({"as_built": {}} if as_built else {}),
            "name": self.title(kind, setpoint, sensors, as_built=as_built),
            "description": f"{self.name} on the real {kind}, by {setpoint} setpoints",
            "time_limit_s": 120.0,
            "autopilot": kind,
            "pad": self.pad,
            "wind": WIND if self.windy else CALM,
            "pass": BOUNDS,
            "companion": {
                "sense": {"source": sensors, "autopilot": {"range_source": "boards"}},
                "control": {"setpoint": setpoint},
                "plan": {"mission": {"waypoint_ned_m": PLACE_NED_M}},
            },
        }

    def title(self, kind: AutopilotKind, setpoint: str, sensors: Sensors, *, as_built: bool = False) -> str:
        """The scenario's name."""
        said = (*(["telemetry"] if sensors == "autopilot" else ()), *(["as_built"] if as_built else ()))
        return "-".join((kind, setpoint, *said, self.name))


def _line(speed_m_s: float) -> dict[str, Any]:
    return {"surface_height_m": 0.3, "motion": {"kind": "line", "speed_m_s": speed_m_s, "meet": MEET}}


_CIRCLE: Final = {"kind": "circle", "speed_m_s": 1.5, "radius_m": 5.0, "meet": MEET}
_FIGURE_8: Final = {"kind": "figure_8", "speed_m_s": 2.0, "half_length_m": 12.0, "meet": MEET}
_HEAVE: Final = {
    "kind": "heave", "significant_height_m": 0.5, "peak_period_s": 5.0, "surge_share": 0.3,
    "drift_speed_m_s": 0.2, "meet": MEET,
}  # fmt: skip

# as the firmwares come, for vehicles that are as believed: nobody gives the bench the truth
OWN_HOVER_THRUST: Final[dict[AutopilotKind, tuple[str, float]]] = {
    "px4": ("MPC_THR_HOVER", 0.5),
    "ardupilot": ("MOT_THST_HOVER", 0.35),
}

CASES: Final = (
    FirmwareCase("static", False, {"surface_height_m": 0.1, "motion": {"kind": "static", "meet": MEET}}),
    FirmwareCase("line_1", False, _line(1.0)),
    FirmwareCase("line_4.2", False, _line(4.2)),
    FirmwareCase("circle_1.5", False, {"surface_height_m": 0.3, "motion": _CIRCLE}),
    FirmwareCase("figure_8_2", False, {"surface_height_m": 0.3, "motion": _FIGURE_8}),
    FirmwareCase("line_2_wind_8", True, _line(2.0)),
    FirmwareCase("circle_1.5_wind_8", True, {"surface_height_m": 0.3, "motion": _CIRCLE}),
    FirmwareCase("heave", False, {"surface_height_m": 1.0, "motion": _HEAVE}),
)


def write_flights(
    firmware: FirmwareSpec,
    setpoint: str,
    sensors: Sensors,
    cases: tuple[FirmwareCase, ...],
    seeds: range,
    folder: Path,
    *,
    as_built: bool = False,
) -> Iterator[CampaignRun]:
    """The flights of one firmware by one kind of setpoint; their scenarios are left in a folder."""
    if not as_built:
        told = (OWN_HOVER_THRUST[firmware.kind], *firmware.parameters)
        firmware = replace(firmware, parameters=told)
    for case in cases:
        content = case.scenario(firmware.kind, setpoint, sensors, as_built=as_built)
        yield from write_scenario(content, seeds, folder, firmware)
