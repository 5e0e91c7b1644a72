"""Settings: one typed tree, read from YAML, with a unit in every name and a bound on every number.

An unknown key, a wrong type or a value out of range stops the start with one line that names the file,
the key and what was expected.
"""

from pathlib import Path
from typing import Any, Final

from pydantic import Field

from companion.base.errors import ConfigError
from companion.base.files import CONFIG_FOLDER, YAML_SUFFIXES, find_file
from companion.config.control import ControlConfig, LimitsConfig, PidConfig, PidGains, TrackingConfig
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
    MOST_OBSTACLES,
    Box,
    Cylinder,
    GuidanceConfig,
    LandingConfig,
    MissionConfig,
    PhaseTimesConfig,
    PlanConfig,
    SearchConfig,
    Shape,
    TouchdownConfig,
)
from companion.config.reading import (
    OPERATOR,
    StrictModel,
    load_model,
    merge,
    read_yaml,
    validate,
    validate_recorded,
)
from companion.config.sense import (
    AutopilotSensorsConfig,
    GpsConfig,
    ImuConfig,
    RangeConfig,
    SenseConfig,
    VisionConfig,
    without_password,
)
from companion.config.service import OrdersConfig, RecordConfig, ServeConfig
from companion.config.vehicle import (
    ARDUPILOT,
    PX4,
    AxisResponse,
    CameraConfig,
    CaptureConfig,
    Kind,
    KindResponse,
    ModelConfig,
    VehicleConfig,
)

# settings that may be paths
NAMED_FILES: Final = (
    ("pad",),
    ("camera",),
    ("vehicle",),
    ("mount",),
    ("sense", "imu", "magnetometer_calibration"),
    ("sense", "imu", "inertial_calibration"),
    ("sense", "autopilot", "magnetometer_calibration"),
    ("plan", "fuzzy"),
)


class ComputeConfig(StrictModel):
    """How long things take on a Raspberry Pi; virtual time holds results back for as long."""

    vision_s: float = Field(default=0.025, ge=0.0, le=0.5)
    """Virtual time only: how long a frame takes on a Raspberry Pi; set it to your computer's"""
    control_s: float = Field(default=0.003, ge=0.0, le=0.1)
    """Virtual time only: how long a control step takes; set it to what `make bench-cpu` measured on the
    vehicle's computer"""


class CompanionConfig(StrictModel):
    """The whole tree."""

    pad: str = Field(default="moving_1300", json_schema_extra=OPERATOR)
    """Layout of the pad: a name in configs/pads, or the path of a .yaml file; set it to the pad that you
    printed"""
    camera: str = Field(default="sitl_640x480", json_schema_extra=OPERATOR)
    """Calibrated camera: a name in configs/cameras, or a path; set it to the file that `calibrate-camera`
    wrote"""
    vehicle: str = Field(default="x500", json_schema_extra=OPERATOR)
    """Geometry and response of the airframe: a name in configs/vehicles, or a path; set it to a copy with the
    measures of your own vehicle"""
    mount: str | None = Field(default=None, json_schema_extra=OPERATOR)
    """File of `calibrate-mount camera`: the camera's rotation, position and time offset; overrides the
    vehicle's file; set it once the camera's mounting is calibrated"""
    sense: SenseConfig = SenseConfig()
    estimate: EstimateConfig = EstimateConfig()
    plan: PlanConfig = PlanConfig()
    control: ControlConfig = ControlConfig()
    link: LinkConfig = LinkConfig()
    orders: OrdersConfig = OrdersConfig()
    compute: ComputeConfig = ComputeConfig()
    record: RecordConfig = RecordConfig()
    serve: ServeConfig = ServeConfig()


def load_config(path: Path, overrides: dict[str, Any] | None = None) -> CompanionConfig:
    """Read the app's settings file, with `overrides` laid over it.

    A file that it names by a relative path is looked for beside it first, then in the current folder.

    Raises:
        ConfigError: one line that says what, where and what was expected.
    """
    data = read_yaml(path)
    for keys in NAMED_FILES:
        _look_beside(path.parent, data, keys)
    return validate(CompanionConfig, merge(data, overrides or {}), str(path))


def _look_beside(folder: Path, data: dict[str, Any], keys: tuple[str, ...]) -> None:
    """Make the path at `keys` one that starts from `folder`, if there is such a file."""
    *above, last = keys
    for key in above:
        inner = data.get(key)
        if not isinstance(inner, dict):
            return
        data = inner
    name = data.get(last)
    if isinstance(name, str) and Path(name).suffix in YAML_SUFFIXES and (folder / name).is_file():
        data[last] = str(folder / name)
