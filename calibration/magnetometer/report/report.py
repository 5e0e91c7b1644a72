"""A calibration in words: the table on the terminal, the autopilot's parameters, the YAML file."""

from __future__ import annotations

from typing import Final

import yaml
from rich.table import Table

from calibration.magnetometer.solve.calibrate import Calibrated, TrueField
from companion.config.magnetometer import MagnetometerCalibration

_HEAD: Final = """# A magnetometer's calibration: calibrated = soft_iron (raw - hard_iron),
# raw in {unit}, {axes} axes. Written by calibrate-magnetometer. {use}
"""
_USE: Final = {
    "mpu9250": "The app's settings name it as sense.imu.magnetometer_calibration.",
    "autopilot": "The app's settings name it as sense.autopilot.magnetometer_calibration.",
    "other": "The app refuses it: of no sensor that it reads (--sensor).",
}


def yaml_text(file: MagnetometerCalibration) -> str:
    """The file's text."""
    head = _HEAD.format(unit=file.raw_unit, axes=file.axes, use=_USE[file.sensor])
    plain = file.model_dump(mode="json")
    return head + str(yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, width=100))


def result_table(done: Calibrated, field: TrueField | None) -> Table:
    """The figures beside what they ought to be."""
    file, fit, figures, quality = done.file, done.fit, done.figures, done.file.quality
    unit = "µT" if file.raw_unit == "uT" else "counts"
    table = Table(title=f"Magnetometer: {done.recording.source}", show_header=False)
    table.add_row(
        "samples", f"{figures.samples}, of them {figures.samples - figures.kept} dropped as outliers"
    )
    table.add_row("sphere covered", f"{figures.coverage:.0%}")
    table.add_row(
        "hard iron", f"{_numbers(done.centre)} {unit} ({_shares(quality.hard_iron_std)} of the field)"
    )
    for name, row in zip(
        ("soft iron", "", ""), done.matrix / (file.field_strength / fit.radius), strict=True
    ):
        table.add_row(name, f"{_numbers(row, '8.4f')}" + (f"  (± {fit.matrix_std:.2%})" if name else ""))
    table.add_row("field as measured", f"{fit.radius:.4g} {unit}")
    if field is not None:
        found = f"{field.strength_ut:.2f} µT, dip {field.dip_deg:.1f}°: {field.source}"
        table.add_row("field there is", found)
    if figures.dip is not None:
        spread = f"± {figures.dip.spread_deg:.1f}° over {figures.dip.samples} calm samples"
        table.add_row("dip", f"{figures.dip.median_deg:.1f}° {spread}")
    if figures.alignment is not None:
        turned = f"turned by {figures.alignment.angle_deg:.2f}° ± {figures.alignment.std_deg:.2f}°"
        table.add_row("accelerometer's axes", turned)
    kept = f"{figures.residual_kept:.3%} without the outliers"
    table.add_row("residual (|B| - F) / F", f"RMS {figures.residual:.3%} over all samples, {kept}")
    table.add_row("noise of one axis", f"{fit.noise:.2%} of the field")
    table.add_row("fit", f"{fit.objective}; condition {fit.condition:.3g}")
    table.add_row("verdict", quality.verdict.upper())
    return table


def lines(done: Calibrated, *, refused: bool = False) -> list[str]:
    """What else there is to say: notes, parameters and, unless it ends `refused` for them, reasons."""
    quality = done.file.quality
    said = [] if refused else [f"{quality.verdict}: {reason}" for reason in quality.reasons]
    said += [f"note: {note}" for note in done.recording.notes]
    usable = done.file.quality.verdict != "refused"  # a wrong one would be set by hand
    if usable and done.parameters and done.recording.onboard is not None:
        name = {"ardupilot": "ArduPilot", "px4": "PX4"}[done.recording.onboard.autopilot_kind]
        # its matrix is symmetric: a rotation has no place in it
        same = "the same but the alignment" if done.file.aligned else "the same"
        said.append(f"{name}: {same} as parameters of its own (set these, or use the file: not both):")
        said += [f"  {key} {value:.5f}" for key, value in done.parameters.items()]
    return said


def _numbers(values: object, form: str = "8.3f") -> str:
    return " ".join(f"{float(value):{form}}" for value in values)  # type: ignore[attr-defined]


def _shares(values: tuple[float, float, float]) -> str:
    return "± " + " ".join(f"{value:.2%}" for value in values)
