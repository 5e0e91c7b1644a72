"""A magnetometer's calibration, as `calibrate-magnetometer` writes it and the app reads it (eq. 12).

    calibrated = soft_iron (raw - hard_iron)

The hard iron is taken off first, in the raw reading's own unit and axes; the soft-iron matrix then makes the
ellipsoid a sphere and brings the unit with it. The equation's other form, C raw - o', has o' = C o.
`axes` says which axes those are: the sensor's own (the MPU9250's, before the mounting rotation) or the
vehicle's body axes (FRD, as an autopilot's telemetry has them).
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from companion.base.errors import ConfigError
from companion.base.geometry import FloatArray
from companion.config.calibration import Provenance
from companion.config.reading import StrictModel, Vector, load_model

Sensor = Literal["mpu9250", "autopilot", "other"]
Axes = Literal["sensor", "body"]
RawUnit = Literal["uT", "counts"]
Verdict = Literal["good", "usable", "refused"]
Matrix = tuple[Vector, Vector, Vector]
AXES_OF: dict[Sensor, Axes] = {"mpu9250": "sensor", "autopilot": "body", "other": "sensor"}


class MagnetometerQuality(StrictModel):
    """How good the fit is; nothing is reckoned with it. Shares are of the field's strength."""

    verdict: Verdict
    reasons: tuple[str, ...] = ()  # why not better
    forced: bool = False  # written on the user's word though it was refused
    residual: float = Field(ge=0.0)  # RMS of (|B| - F) / F over all samples
    residual_kept: float = Field(ge=0.0)  # the same without the outliers
    noise: float = Field(ge=0.0)  # of one axis, as a share of the field
    coverage: float = Field(ge=0.0, le=1.0)  # share of the sphere that has samples
    condition: float = Field(ge=1.0)  # of the fit's normal equations
    hard_iron_std: Vector  # share of the field, along the raw axes
    soft_iron_std: float = Field(ge=0.0)  # largest of the matrix's elements, its mean scale being 1


class MagnetometerCalibration(StrictModel):
    """The calibration and where it comes from."""

    kind: Literal["magnetometer"]
    sensor: Sensor
    axes: Axes
    form: Literal["calibrated = soft_iron (raw - hard_iron)"]
    raw_unit: RawUnit
    calibrated_unit: Literal["uT", "raw"]  # raw: scaled as measured, for no field strength was given
    hard_iron: Vector
    soft_iron: Matrix
    aligned: bool = False  # to the accelerometer's axes; soft_iron then holds a rotation too
    field_strength: float = Field(gt=0.0)  # what |calibrated| is, in its unit
    field_source: str
    quality: MagnetometerQuality
    provenance: Provenance
    autopilot_parameters: dict[str, float] = Field(default_factory=dict)  # those it was made under

    @model_validator(mode="after")
    def _turns_nothing_over(self) -> MagnetometerCalibration:
        if np.linalg.det(np.array(self.soft_iron)) <= 0.0:
            raise ValueError("soft_iron: expected a matrix of positive determinant")
        return self

    @property
    def matrix(self) -> FloatArray:
        return np.array(self.soft_iron)

    def apply(self, raw: FloatArray) -> FloatArray:
        """Calibrated fields (n, 3) of raw ones (n, 3)."""
        calibrated: FloatArray = (raw - np.array(self.hard_iron)) @ self.matrix.T
        return calibrated

    def undo(self, calibrated: FloatArray) -> FloatArray:
        """Raw fields (n, 3) of calibrated ones (n, 3)."""
        raw: FloatArray = calibrated @ np.linalg.inv(self.matrix).T + np.array(self.hard_iron)
        return raw


def load_magnetometer_calibration(path: str, sensor: Sensor, key: str) -> MagnetometerCalibration:
    """Read the calibration that the setting `key` names, for this sensor.

    Raises:
        ConfigError: no such file, not one, or one of another sensor, other axes or without a unit.
    """
    found = load_model(MagnetometerCalibration, Path(path))
    wanted = (sensor, AXES_OF[sensor], "uT")
    if (found.sensor, found.axes, found.raw_unit) != wanted:
        raise ConfigError(
            f"{key}: {path} is of sensor {found.sensor} in {found.axes} axes, raw in {found.raw_unit}; "
            f"expected sensor {sensor} in {wanted[1]} axes, raw in uT"
        )
    return found
