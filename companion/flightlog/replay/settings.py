"""Under which settings a log is replayed.

A flight of ours holds its own. For an autopilot's log it is a settings file, and what that does not set
the log shows: the antenna's place, and the place and date by which the Earth's field is known.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from companion.base.geometry import ZERO3, Vector3, dot, norm
from companion.base.magnetic_field import field_here, field_ned_ut
from companion.base.messages import GpsFix, ImuSample, MagSample
from companion.config import CONFIG_FOLDER, CompanionConfig, load_config, load_vehicle
from companion.flightlog.replay.compare import FieldUsed
from companion.flightlog.replay.flight_record import FlightRecord, RecordedEvent, ReplaySetup
from companion.pad import load_pad

DEFAULT_SETTINGS: Final = CONFIG_FOLDER / "companion.yaml"
# for a log with a place and no date: in the middle of the models
YEAR_UNKNOWN: Final = 2020.0


@dataclass(frozen=True, slots=True)
class Choice:
    """What a log is replayed with, and how to name it to people; `repeats`: just as it was flown."""

    rig: ReplaySetup
    field: FieldUsed
    name: str
    repeats: bool


def choose(record: FlightRecord, config_path: Path | None) -> Choice:
    """The settings for a log; a file given goes before what the log holds."""
    if record.kind == "companion" and record.rig is not None and config_path is None:
        return Choice(record.rig, _field(record, record.rig.config), "the flight's own", repeats=True)
    path = config_path or DEFAULT_SETTINGS
    config = load_config(path)
    field = _field(record, config)
    if record.kind != "companion":
        config = _fitted(config, record, field.ned_ut)
    vehicle = load_vehicle(config.vehicle, config.mount, config.camera)
    return Choice(ReplaySetup(config, vehicle, load_pad(config.pad)), field, str(path), repeats=False)


def _fitted(config: CompanionConfig, record: FlightRecord, field: Vector3) -> CompanionConfig:
    """The settings with the Earth's field, and the antenna where the autopilot assumes it."""
    estimate = config.estimate.model_copy(update={"magnetic_field_ned_ut": field})
    sense = config.sense
    if "antenna_position_body_m" not in sense.gps.model_fields_set:
        antenna = {"antenna_position_body_m": record.antenna_position_body_m or ZERO3}
        sense = sense.model_copy(update={"gps": sense.gps.model_copy(update=antenna)})
    return config.model_copy(update={"estimate": estimate, "sense": sense})


def _field(record: FlightRecord, config: CompanionConfig) -> FieldUsed:
    """As the estimator takes it; by the date of another program's log, which may be from before the model."""
    if (told := config.estimate.magnetic_field_ned_ut) is not None:
        return FieldUsed(ned_ut=told, source="settings")
    if record.kind == "companion":
        fix = next((item for _, item in record.events if isinstance(item, GpsFix)), None)
        if fix is not None:
            here = field_here((fix.latitude_deg, fix.longitude_deg, fix.altitude_m))
            return FieldUsed(ned_ut=here, source="World Magnetic Model at the first fix")
    place = record.place
    if place is None:
        source = "the log's magnetometer (no GPS in it): heading counts from magnetic north"
        return FieldUsed(ned_ut=field_of_samples(record.events), source=source)
    year = YEAR_UNKNOWN if place.year is None else place.year
    field = field_ned_ut(place.latitude_deg, place.longitude_deg, place.altitude_m, year)
    date = "no date in the log, 2020 taken" if place.year is None else f"{year:.1f}"
    where = f"{place.latitude_deg:.3f}, {place.longitude_deg:.3f}"
    return FieldUsed(ned_ut=field, source=f"World Magnetic Model at {where}, {date}")


def field_of_samples(events: list[RecordedEvent]) -> Vector3:
    """Size and dip (µT, NED with magnetic north for north) by the medians over a log.

    The dip is the field's angle against the specific force: over minutes of flight that is gravity's.
    """
    sizes, dips = [], []
    force: Vector3 | None = None
    for _, item in events:
        if isinstance(item, ImuSample):
            force = item.specific_force_body_m_s2
        elif isinstance(item, MagSample) and force is not None:
            size = norm(item.field_body_ut)
            if size > 0.0 and norm(force) > 0.0:
                sizes.append(size)
                dips.append(-dot(item.field_body_ut, force) / (size * norm(force)))
    if not sizes:
        return ZERO3
    size, down = float(np.median(sizes)), float(np.median(dips))
    return (size * math.sqrt(max(1.0 - down * down, 0.0)), 0.0, size * down)
