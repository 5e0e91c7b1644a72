"""How an autopilot answers setpoints, beside what the vehicle's file says of it.

    python -m benchmarks response --px4 BIN --arducopter BIN

Flies jumps at random (`response_flight`) on the real firmware in lockstep, or without BIN on the bundled
autopilots. A dead time, a second order and the gains of acceleration and velocity are fitted to the tilt that
truly followed, along down to the acceleration. What the file has of integrals is by the parameters.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from rich.table import Table
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from benchmarks.autopilot.response_flight import AnswerRecord, fly
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray
from companion.config import Kind, VehicleConfig, find_file, load_model
from sitl.firmware.spec import FirmwareSpec

SMOKE: Final = ()
FINER: Final = 4  # dead times fall between rows
SETTLING_ROWS: Final = 240
KINDS: Final[dict[AutopilotKind, tuple[Kind, ...]]] = {
    "px4": ("acceleration", "attitude"),
    "ardupilot": ("attitude", "velocity"),
}
DOWN: Final = 2
HEADING: Final = 3


def answer(command: FloatArray, period_s: float, dead_time_s: float, w: float, zeta: float) -> FloatArray:
    """A held command after a dead time and at second order; it begins settled."""
    step_s = period_s / FINER
    fine = np.repeat(command, FINER)
    rows = np.arange(len(fine)) - dead_time_s / step_s
    late = np.interp(rows, np.arange(len(fine)), fine)
    b, a, _ = cont2discrete(([w * w], [1.0, 2.0 * zeta * w, w * w]), step_s, "zoh")
    flown: FloatArray = lfilter(b[0], a, late, zi=lfilter_zi(b[0], a) * late[0])[0][::FINER]
    return flown


def smoothed(column: FloatArray) -> FloatArray:
    """Without most of the rotors' vibration; what is compared is smoothed alike."""
    mean: FloatArray = np.convolve(column, np.ones(9) / 9.0, "same")
    return mean


def fit(columns: list[FloatArray], flown: FloatArray, free: list[FloatArray], period_s: float) -> list[float]:
    """Dead time (s), frequency (rad/s), damping, share explained, and the gains of all columns.

    `columns` pass the response, `free` (what counts at once: drag, a bias) do not; gains enter linearly.
    """

    def parts(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        dead_time_s, w, zeta = np.abs(x)
        basis = [smoothed(answer(column, period_s, dead_time_s, w, zeta)) for column in columns]
        stacked = np.column_stack([*basis, *free, np.ones(len(flown))])[SETTLING_ROWS:]
        gains = np.asarray(np.linalg.lstsq(stacked, flown[SETTLING_ROWS:], rcond=None)[0], dtype=np.float64)
        left: FloatArray = flown[SETTLING_ROWS:] - stacked @ gains
        return gains, left

    starts = [(0.03, 12.0, 0.7), (0.015, 45.0, 1.0), (0.12, 25.0, 1.0)]
    found = [
        least_squares(lambda x: parts(x)[1], start, x_scale=(0.03, 5.0, 0.3), ftol=1e-6) for start in starts
    ]
    best = min(found, key=lambda each: float(each.cost))
    gains, left = parts(best.x)
    explained = 1.0 - float(np.std(left) / np.std(flown[SETTLING_ROWS:]))
    return [*np.abs(best.x).tolist(), explained, *gains[: len(columns)].tolist()]


def along(record: AnswerRecord, axis: int, kind: Kind) -> list[float]:
    """The fit along one axis while it was excited."""
    rows = record.axis == axis
    period_s = float(np.median(np.diff(record.time_s)))
    if axis == HEADING:
        return fit([record.command_heading_rad[rows]], np.unwrap(record.heading_rad[rows]), [], period_s)
    a, v = record.command_acceleration_m_s2[rows, axis], record.command_velocity_m_s[rows, axis]
    speed = record.velocity_m_s[rows, axis]
    heard = kind == "velocity" or (axis == DOWN and kind != "attitude")
    flown = (record.acceleration_m_s2 if axis == DOWN else record.tilt_m_s2)[rows, axis]
    free = [smoothed(speed)] if axis == DOWN else []
    return fit([a, v - speed] if heard else [a], smoothed(flown), free, period_s)


def rows_of(
    vehicle: VehicleConfig, autopilot_kind: AutopilotKind, kind: Kind, record: AnswerRecord
) -> list[list[str]]:
    """Found beside what is believed."""
    believed, rows = vehicle.responses.of(autopilot_kind, kind), []
    for name, axis in (("north", 0), ("east", 1), ("down", DOWN)):
        response = believed.down if axis == DOWN else believed.sideways
        dead_s, w, zeta, explained, *gains = along(record, axis, kind)
        rows.append(
            [
                f"{autopilot_kind} {kind} {name}",
                f"{dead_s:.3f} ({response.dead_time_s:.3f})",
                f"{w:.1f} ({response.frequency_rad_s:.1f})",
                f"{zeta:.2f} ({response.damping:.2f})",
                f"{dead_s + 2.0 * zeta / w:.3f} ({response.delay_s:.3f})",
                f"{gains[0]:.2f} ({response.gain:.2f})",
                f"{gains[1]:.2f} ({response.velocity_gain_1_s:.2f})" if len(gains) > 1 else "",
                f"{100.0 * explained:.0f} %",
            ]
        )
    dead_s, w, zeta, explained, gain = along(record, HEADING, kind)
    found = (f"{dead_s:.3f}", f"{w:.1f}", f"{zeta:.2f}", f"{dead_s + 2.0 * zeta / w:.3f}", f"{gain:.2f}")
    rows.append([f"{autopilot_kind} {kind} heading", *found, "", f"{100.0 * explained:.0f} %"])
    return rows


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, fit and show."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--px4", type=Path, help="the program px4")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--vehicle", default="x500", help="the airframe, and whose file to hold it against")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    vehicle = load_model(VehicleConfig, find_file("vehicles", options.vehicle))
    programs: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    alone = any(programs.values())
    shown = Table(title=f"{options.vehicle}: found (believed)")
    for heading in ("", "dead time s", "frequency rad/s", "damping", "delay s", "gain", "K 1/s", "explained"):
        shown.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for autopilot_kind, path in programs.items():
        spec = FirmwareSpec.of(autopilot_kind, path) if path else None
        for kind in KINDS[autopilot_kind] if spec or not alone else ():
            record = fly(autopilot_kind, options.vehicle, kind, options.seed, spec)
            for cells in rows_of(vehicle, autopilot_kind, kind, record):
                shown.add_row(*cells)
    report = BenchReport()
    report.show(shown)
    return report
