"""A calibration in words: the table on the terminal, the autopilot's parameters, the YAML file."""

import textwrap
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from rich.table import Table

from calibration.command_line import listed
from calibration.magnetometer.calibrate import Calibrated, TrueField
from calibration.magnetometer.ellipsoid import BoolArray
from companion.base.files import save_figure
from companion.base.geometry import FloatArray
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
    stds = " ".join(f"{std:.2%}" for std in quality.hard_iron_std)
    table.add_row("hard iron", f"{listed(done.centre, '8.3f')} {unit} (± {stds} of the field)")
    for name, row in zip(
        ("soft iron", "", ""), done.matrix / (file.field_strength / fit.radius), strict=True
    ):
        table.add_row(name, listed(row, "8.4f") + (f"  (± {fit.matrix_std:.2%})" if name else ""))
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


# ---------------------------------------------------------------- pictures
# Above in three dimensions and by planes, all in shares of the field; below the residuals' histograms, before
# (about the best sphere) and after.

_MOST_POINTS: Final = 3000
_RAW, _CALIBRATED, _DROPPED = "tab:red", "tab:blue", "black"
_TEXT_WIDTH: Final = 44
_AXES: Final = "xyz"


def write_picture(path: Path, done: Calibrated) -> None:
    """Write the figure, by its suffix as PNG, PDF or SVG."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import, and not always needed

    chosen = np.unique(np.linspace(0, len(done.sphere) - 1, _MOST_POINTS).astype(int))
    raw, sphere = done.recording.raw[chosen] / done.fit.radius, done.sphere[chosen]
    kept = done.fit.kept[chosen]
    figure = Figure(figsize=(13, 8.5))
    _draw_solid(figure.add_subplot(2, 3, 1, projection="3d"), raw[kept], sphere[kept])
    for place, (i, j) in zip((2, 3, 5), ((0, 1), (0, 2), (1, 2)), strict=True):
        _draw_plane(figure.add_subplot(2, 3, place), raw, sphere, kept, i, j)
    _draw_centre_text(figure.add_subplot(2, 3, 4), done)
    _draw_residuals(figure.add_subplot(2, 3, 6), done)
    figure.suptitle(f"{done.recording.source}: raw ellipsoid and calibrated sphere", fontsize=11)
    figure.tight_layout()
    save_figure(figure, path, dpi=110)


def _draw_solid(axes: Any, raw: FloatArray, sphere: FloatArray) -> None:
    longitude, latitude = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    ring = np.sin(latitude)
    axes.plot_wireframe(
        np.cos(longitude) * ring, np.sin(longitude) * ring, np.cos(latitude), lw=0.4, color="0.6", alpha=0.6
    )
    axes.scatter(*raw.T, s=2, color=_RAW, alpha=0.4)
    axes.scatter(*sphere.T, s=2, color=_CALIBRATED, alpha=0.4)
    axes.set_box_aspect([1, 1, 1])
    axes.set_aspect("equal")
    axes.set(xlabel="x", ylabel="y", zlabel="z")


def _draw_plane(axes: Any, raw: FloatArray, sphere: FloatArray, kept: BoolArray, i: int, j: int) -> None:
    axes.plot(raw[kept, i], raw[kept, j], ".", ms=1.5, color=_RAW, alpha=0.5, label="raw")
    axes.plot(sphere[kept, i], sphere[kept, j], ".", ms=1.5, color=_CALIBRATED, alpha=0.5, label="calibrated")
    if not kept.all():
        axes.plot(raw[~kept, i], raw[~kept, j], "x", ms=4, color=_DROPPED, label="outliers, raw")
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    axes.plot(np.cos(angle), np.sin(angle), lw=0.8, color="0.4")
    low, high = np.percentile(np.vstack([raw[kept], sphere[kept]])[:, [i, j]], [0.0, 100.0], axis=0)
    margin = 0.1
    axes.set_xlim(min(low[0], -1.0) - margin, max(high[0], 1.0) + margin)
    axes.set_ylim(min(low[1], -1.0) - margin, max(high[1], 1.0) + margin)
    axes.set_aspect("equal")
    axes.set(xlabel=f"{_AXES[i]} (shares of the field)", ylabel=_AXES[j])
    axes.legend(loc="upper right", fontsize=7, markerscale=4)


def _draw_centre_text(axes: Any, done: Calibrated) -> None:
    """The figures, where the eye looks for them."""
    quality = done.file.quality
    texts = [
        f"verdict: {quality.verdict}",
        f"samples {done.figures.samples}, dropped {done.figures.samples - done.figures.kept}",
        f"sphere covered {quality.coverage:.0%}",
        f"residual {quality.residual:.2%} (kept {quality.residual_kept:.2%})",
        "hard iron ± " + ", ".join(f"{std:.2%}" for std in quality.hard_iron_std),
        f"soft iron ± {quality.soft_iron_std:.2%}",
        *(textwrap.fill(reason, _TEXT_WIDTH) for reason in quality.reasons),
    ]
    axes.axis("off")
    axes.text(0.0, 1.0, "\n".join(texts), va="top", fontsize=9, transform=axes.transAxes)


def _draw_residuals(axes: Any, done: Calibrated) -> None:
    raw = done.recording.raw[done.fit.kept]
    # the best sphere: what hard iron alone would leave
    design = np.column_stack([2.0 * raw, np.ones(len(raw))])
    solution = np.linalg.lstsq(design, np.sum(raw**2, axis=1), rcond=None)[0]
    size = np.linalg.norm(raw - solution[:3], axis=1)
    before, after = size / size.mean() - 1.0, done.fit.ellipsoid.deviation(raw)
    low, high = np.percentile(np.concatenate([before, after]), [0.2, 99.8]).tolist()
    bins = np.linspace(100.0 * low, 100.0 * high, 80)
    for values, colour, name in ((before, _RAW, "hard iron alone"), (after, _CALIBRATED, "calibrated")):
        axes.hist(100.0 * values, bins.tolist(), color=colour, alpha=0.6, label=name)
    axes.set(xlabel="(|B| - F) / F (%)", ylabel="samples")
    axes.legend(fontsize=8)
