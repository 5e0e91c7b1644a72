"""From a recording to a calibration: fit, scale, align, judge. Pure."""

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from calibration.clipping import clipped_axes
from calibration.magnetometer.ellipsoid import (
    Asked,
    EllipsoidFit,
    NoEllipsoidError,
    covered_share,
    fit_ellipsoid,
)
from calibration.magnetometer.quality import (
    FLATTEST,
    AxisMisalignment,
    Figures,
    align,
    beside_plane,
    dip_of,
    flatness,
    judge,
    suggest_next_rotation,
)
from calibration.magnetometer.recording import MagnetometerRecording, parameters_for
from companion.base.clock import start_unix_s
from companion.base.geometry import FloatArray, Vector3, vector3
from companion.base.magnetic_field import FIRST_YEAR, LAST_YEAR, field_ned_ut
from companion.config import CompanionConfig, ConfigError
from companion.config.calibration import Provenance
from companion.config.magnetometer import MagnetometerCalibration, MagnetometerQuality
from companion.flightlog.replay.flight_record import SECONDS_PER_YEAR, RecordingPlace

_LEAST_KEPT: Final = 0.1  # of the samples; fewer are what happened to lie near something
_LEAST_SPAN: Final = 0.2  # of the field there is: an ellipsoid smaller than that is one of the noise


class UnfitError(Exception):
    """No calibration can be made of these samples; the text says why."""


@dataclass(frozen=True, slots=True)
class TrueField:
    """The Earth's field (µT, NED) where and when the samples were taken, and who says so."""

    ned_ut: Vector3
    source: str

    @property
    def strength_ut(self) -> float:
        """Its size."""
        return math.hypot(*self.ned_ut)

    @property
    def dip_deg(self) -> float:
        """Its angle below the horizontal."""
        return math.degrees(math.asin(self.ned_ut[2] / self.strength_ut))


@dataclass(frozen=True, slots=True)
class Calibrated:
    """A calibration with what it was made of.

    `matrix` and `centre` are of the compass's raw readings, where the file's are of what is heard from an
    autopilot; `sphere` (n, 3) are all samples on the unit sphere.
    """

    file: MagnetometerCalibration
    recording: MagnetometerRecording
    fit: EllipsoidFit
    figures: Figures
    matrix: FloatArray
    centre: FloatArray
    sphere: FloatArray
    parameters: dict[str, float]


def calibrate(
    recording: MagnetometerRecording,
    rng: np.random.Generator,
    *,
    field: TrueField | None,
    aligned: bool,
    objective: Asked = "auto",
    tool: str,
    date: str,
) -> Calibrated:
    """Calibrate; the verdict is in the file, good or bad.

    Raises:
        UnfitError: there is no fit at all to judge.
    """
    fit = _fit(recording, rng, objective)
    sphere = fit.ellipsoid.apply(recording.raw)
    alignment = _alignment(recording, fit, sphere) if aligned else None
    rotation = np.eye(3) if alignment is None else alignment.rotation
    sphere = sphere @ rotation.T
    figures = _figures(recording, fit, sphere, field, alignment)
    if figures.strength_ratio is not None and figures.strength_ratio < _LEAST_SPAN:
        raise UnfitError(
            f"the samples span {figures.strength_ratio:.2f} times the field: was it turned about at all?"
        )
    symmetric = (fit.radius if field is None else field.strength_ut) * fit.ellipsoid.matrix
    parameters: dict[str, float] = {}
    if recording.onboard is not None:
        parameters = parameters_for(recording.onboard.autopilot_kind, symmetric, fit.ellipsoid.centre)
    matrix = rotation @ symmetric
    file = _file(recording, fit, figures, matrix, field, tool, date)
    return Calibrated(file, recording, fit, figures, matrix, fit.ellipsoid.centre, sphere, parameters)


def _alignment(recording: MagnetometerRecording, fit: EllipsoidFit, sphere: FloatArray) -> AxisMisalignment:
    """The rotation into the accelerometer's axes."""
    beside = _beside_gravity(recording, fit, sphere)
    found = None if beside is None else align(*beside)
    if found is None:
        raise UnfitError(
            "--align needs an accelerometer's samples beside the magnetometer's, at rest or slow"
        )
    return found


def _figures(
    recording: MagnetometerRecording,
    fit: EllipsoidFit,
    sphere: FloatArray,
    field: TrueField | None,
    alignment: AxisMisalignment | None,
) -> Figures:
    """What the verdict is made of."""
    beside = _beside_gravity(recording, fit, sphere)
    deviation = fit.ellipsoid.deviation(recording.raw)
    directions = _directions(sphere[fit.kept])
    return Figures(
        samples=len(recording.raw),
        kept=int(fit.kept.sum()),
        residual=_rms(deviation),
        residual_kept=_rms(deviation[fit.kept]),
        coverage=covered_share(directions),
        next_turn=suggest_next_rotation(directions, recording.body_from_sensor),
        strength_ratio=None
        if field is None or recording.unit == "counts"
        else fit.radius / field.strength_ut,
        dip=None if beside is None else dip_of(*beside),
        true_dip_deg=None if field is None else field.dip_deg,
        alignment=alignment,
        clipped=clipped_axes(recording.raw, recording.raw),
    )


def _beside_gravity(
    recording: MagnetometerRecording, fit: EllipsoidFit, sphere: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Directions (n, 3) of what is kept that has a specific force (n, 3) beside it; None: not measured."""
    if recording.force is None:
        return None
    used = fit.kept & np.isfinite(recording.force).all(axis=1)
    return _directions(sphere[used]), recording.force[used]


def _directions(sphere: FloatArray) -> FloatArray:
    return np.asarray(sphere / np.linalg.norm(sphere, axis=1)[:, None])


def _fit(recording: MagnetometerRecording, rng: np.random.Generator, objective: Asked) -> EllipsoidFit:
    raw, mounting = recording.raw, recording.body_from_sensor
    try:
        fit = fit_ellipsoid(raw, rng, objective)
    except NoEllipsoidError as error:
        raise UnfitError(f"{error}; next: {beside_plane(raw, mounting)}") from error
    if fit.kept.mean() < _LEAST_KEPT or not np.isfinite(fit.covariance).all():
        raise UnfitError("the samples are on no ellipsoid: was it turned about at all?")
    if flatness(raw[fit.kept]) < FLATTEST:
        turns = beside_plane(raw[fit.kept], mounting)
        raise UnfitError(f"the samples lie in one plane or on a narrow band; next: {turns}")
    return fit


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _file(
    recording: MagnetometerRecording,
    fit: EllipsoidFit,
    figures: Figures,
    matrix: FloatArray,
    field: TrueField | None,
    tool: str,
    date: str,
) -> MagnetometerCalibration:
    verdict, reasons = judge(fit, figures)
    centre, onboard = fit.ellipsoid.centre, recording.onboard
    if onboard is not None:
        matrix, centre = onboard.on_top(matrix, centre)
    rows = [vector3(row) for row in matrix.tolist()]
    return MagnetometerCalibration(
        kind="magnetometer",
        sensor=recording.sensor,
        axes=recording.axes,
        form="calibrated = soft_iron (raw - hard_iron)",
        raw_unit=recording.unit,
        calibrated_unit="uT" if field is not None or recording.unit == "uT" else "raw",
        hard_iron=vector3(centre.tolist()),
        soft_iron=(rows[0], rows[1], rows[2]),
        aligned=figures.alignment is not None,
        field_strength=fit.radius if field is None else field.strength_ut,
        field_source="as measured" if field is None else field.source,
        quality=MagnetometerQuality(
            verdict=verdict,
            reasons=reasons,
            residual=figures.residual,
            residual_kept=figures.residual_kept,
            noise=fit.noise,
            coverage=figures.coverage,
            condition=fit.condition,
            hard_iron_std=vector3(fit.centre_std.tolist()),
            soft_iron_std=fit.matrix_std,
        ),
        provenance=Provenance(
            tool=tool,
            source=recording.source,
            date=date,
            samples=figures.kept,
            dropped=figures.samples - figures.kept,
        ),
        autopilot_parameters={} if onboard is None else onboard.parameters,
    )


# ---------------------------------------------------------------- true field

_CARRIED_ON_YEARS: Final = 10.0  # the model errs by a degree or so as far beyond its years
_POSITION: Final = re.compile(r"\s*([-+\d.]+)\s*,\s*([-+\d.]+)\s*(?:,\s*([-+\d.]+)\s*)?")


def field_by(
    position: str | None, year: float | None, settings: CompanionConfig, config: Path | None
) -> TrueField | None:
    """By the position, else by the settings where they say it themselves; None: neither.

    Raises:
        ConfigError: the position is none.
    """
    if position is not None:
        return field_at(_place(position), year, "--position")
    if config is not None and settings.estimate.magnetic_field_ned_ut is not None:
        told = settings.estimate.magnetic_field_ned_ut
        return TrueField(told, f"estimate.magnetic_field_ned_ut of {config}")
    return None


def field_at(place: RecordingPlace, year: float | None, source: str) -> TrueField:
    """By the World Magnetic Model; without a year the place's own, else today."""
    when = year or place.year or _decimal(datetime.fromtimestamp(start_unix_s(virtual=True), UTC))
    field: Vector3 = field_ned_ut(place.latitude_deg, place.longitude_deg, place.altitude_m, when)
    return TrueField(field, f"World Magnetic Model {when:.1f}, {source}")


def _place(text: str) -> RecordingPlace:
    form = _POSITION.fullmatch(text)
    try:
        numbers = [float(group or 0.0) for group in form.groups()] if form else []
    except ValueError:
        numbers = []
    good = len(numbers) == 3 and abs(numbers[0]) <= 90.0 and abs(numbers[1]) <= 180.0
    if not good or not math.isfinite(numbers[2]) or abs(numbers[2]) > 100_000.0:
        raise ConfigError(f"--position {text}: expected latitude,longitude[,altitude] in degrees and metres")
    return RecordingPlace(numbers[0], numbers[1], numbers[2], None)


def year_of(date: str | None) -> float | None:
    """A date as a decimal year.

    Raises:
        ConfigError: it is none, or so far off that the model knows nothing of it.
    """
    if date is None:
        return None
    try:
        year = _decimal(datetime.fromisoformat(date).replace(tzinfo=UTC))
    except ValueError:
        year = math.nan
    if not FIRST_YEAR - _CARRIED_ON_YEARS <= year <= LAST_YEAR + _CARRIED_ON_YEARS:
        first, last = FIRST_YEAR - _CARRIED_ON_YEARS, LAST_YEAR + _CARRIED_ON_YEARS
        raise ConfigError(f"--date {date}: expected YYYY-MM-DD, from {first:.0f} to {last:.0f}")
    return year


def _decimal(date: datetime) -> float:
    start = datetime(date.year, 1, 1, tzinfo=UTC)
    return date.year + (date - start).total_seconds() / SECONDS_PER_YEAR
