"""The Earth's field where and when a magnetometer is calibrated: by position and date, or by the settings."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from calibration.magnetometer.solve.calibrate import TrueField
from companion.base.clock import start_unix_s
from companion.base.geometry import Vector3
from companion.base.magnetic_field import FIRST_YEAR, LAST_YEAR, field_ned_ut
from companion.config import CompanionConfig, ConfigError
from companion.flightlog.replay.flight_record import RecordingPlace

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
    if config is not None and "magnetic_field_ned_ut" in settings.estimate.model_fields_set:
        return TrueField(
            settings.estimate.magnetic_field_ned_ut, f"estimate.magnetic_field_ned_ut of {config}"
        )
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
    return date.year + (date - start).total_seconds() / (365.2425 * 86_400.0)
