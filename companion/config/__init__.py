"""Settings: one typed tree, read from YAML, with a unit in every name and a bound on every number.

An unknown key, a wrong type or a value out of range stops the start with one line that names the file,
the key and what was expected.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from companion.config.control import ControlConfig, LimitsConfig, TrackingConfig
from companion.config.estimate import (
    AlignmentConfig,
    EkfConfig,
    EstimateConfig,
    OrientationConfig,
    PadFilterConfig,
)
from companion.config.link import CONNECTION_FORM, LinkConfig
from companion.config.mounting import (
    AccelerometerCalibration,
    GyroCalibration,
    InertialCalibration,
    MountCalibration,
    MountStd,
    load_inertial,
    load_mount,
    load_vehicle,
)
from companion.config.plan import (
    GuidanceConfig,
    LandingConfig,
    MissionConfig,
    PhaseTimesConfig,
    PlanConfig,
    SearchConfig,
    TouchdownConfig,
)
from companion.config.reading import (
    CONFIG_FOLDER,
    ConfigError,
    Model,
    StrictModel,
    Vector,
    find_file,
    load_model,
    merge,
    read_yaml,
    validate,
)
from companion.config.sense import (
    AutopilotSensorsConfig,
    GpsConfig,
    ImuConfig,
    RangeConfig,
    SenseConfig,
    VisionConfig,
)
from companion.config.vehicle import CameraConfig, CaptureConfig, VehicleConfig

__all__ = [
    "CONFIG_FOLDER",
    "CONNECTION_FORM",
    "AccelerometerCalibration",
    "AlignmentConfig",
    "AutopilotSensorsConfig",
    "CameraConfig",
    "CaptureConfig",
    "CompanionConfig",
    "ComputeConfig",
    "ConfigError",
    "ControlConfig",
    "EkfConfig",
    "EstimateConfig",
    "GpsConfig",
    "GuidanceConfig",
    "GyroCalibration",
    "ImuConfig",
    "InertialCalibration",
    "LandingConfig",
    "LimitsConfig",
    "LinkConfig",
    "MissionConfig",
    "Model",
    "MountCalibration",
    "MountStd",
    "OrientationConfig",
    "PadFilterConfig",
    "PhaseTimesConfig",
    "PlanConfig",
    "RangeConfig",
    "SearchConfig",
    "SenseConfig",
    "StrictModel",
    "TouchdownConfig",
    "TrackingConfig",
    "Vector",
    "VehicleConfig",
    "VisionConfig",
    "find_file",
    "load_config",
    "load_inertial",
    "load_model",
    "load_mount",
    "load_vehicle",
    "merge",
    "read_yaml",
    "validate",
]


class ComputeConfig(StrictModel):
    """How long things take on a Raspberry Pi; virtual time holds results back for as long."""

    vision_s: float = Field(default=0.025, ge=0.0, le=0.5)
    control_s: float = Field(default=0.003, ge=0.0, le=0.1)


class CompanionConfig(StrictModel):
    """The whole tree."""

    pad: str = "moving_1300"
    camera: str = "sitl_640x480"
    vehicle: str = "x500"
    mount: str | None = None
    sense: SenseConfig = SenseConfig()
    estimate: EstimateConfig = EstimateConfig()
    plan: PlanConfig = PlanConfig()
    control: ControlConfig = ControlConfig()
    link: LinkConfig = LinkConfig()
    compute: ComputeConfig = ComputeConfig()

    @model_validator(mode="after")
    def _one_rate(self) -> CompanionConfig:
        ours, wanted = self.control.rate_hz, self.plan.rate_hz
        if ours != wanted:
            raise ValueError(f"control.rate_hz {ours:g}: expected that of plan.rate_hz, {wanted:g}")
        return self


def load_config(path: Path, overrides: dict[str, Any] | None = None) -> CompanionConfig:
    """Read the app's settings file, with `overrides` laid over it.

    Raises:
        ConfigError: one line that says what, where and what was expected.
    """
    return validate(CompanionConfig, merge(read_yaml(path), overrides or {}), str(path))
