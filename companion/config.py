"""Settings: one typed tree, read from YAML, with a unit in every name and a bound on every number.

An unknown key, a wrong type or a value out of range stops the start with one line that names the file,
the key and what was expected.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

CONFIG_FOLDER = Path(__file__).resolve().parent.parent / "configs"


class ConfigError(Exception):
    """Something in a settings file that a user can mend; the text is the one line to show."""


class StrictModel(BaseModel):
    """Base of all settings: unknown keys are refused, values cannot change after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=BaseModel)
Vector = tuple[float, float, float]


# ---------------------------------------------------------------- reading


def find_file(folder: str, name: str | Path) -> Path:
    """Path of a settings file given by path, or by name within configs/<folder>.

    Raises:
        ConfigError: no such file; the line lists the names there are.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} and path.is_file():
        return path
    shipped = CONFIG_FOLDER / folder / f"{name}.yaml"
    if path.suffix == "" and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in (CONFIG_FOLDER / folder).glob("*.yaml")))
    raise ConfigError(f"{folder}: no '{name}'; expected the path of a .yaml file or one of: {names}")


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping.

    Raises:
        ConfigError: unreadable, not YAML (with line and column), or not a mapping.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text at byte {error.start}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not readable"
        raise ConfigError(f"{path}{where}: broken YAML: {problem}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected a mapping of keys to values, found {type(data).__name__}")
    return data


def validate(model: type[Model], data: dict[str, Any], source: str) -> Model:
    """Build a model from plain data.

    Raises:
        ConfigError: one line with the source, the key, what was expected and what was found.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(_one_line(error, source)) from error


def load_model(model: type[Model], path: Path) -> Model:
    """Read one settings file into its model.

    Raises:
        ConfigError: see `read_yaml` and `validate`.
    """
    return validate(model, read_yaml(path), str(path))


def merge(base: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    """Deep merge of two plain trees; lists and scalars of the second replace the first's."""
    merged = dict(base)
    for key, value in overrides.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged


def _one_line(error: ValidationError, source: str) -> str:
    first = error.errors(include_url=False)[0]
    key = ".".join(str(part) for part in first["loc"]) or "(top)"
    if first["type"] == "extra_forbidden":
        return f"{source}: unknown key '{key}'"
    text = first["msg"].removeprefix("Value error, ").replace("Input should be", "expected")
    found = "" if first["type"] in {"missing", "value_error"} else f", found {first['input']!r}"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{source}: {key}: {text}{found}{more}"


# ---------------------------------------------------------------- what sits on the vehicle


class CameraConfig(StrictModel):
    """A calibrated camera, as `calibrate-camera` writes it (eqs. 2 and 3)."""

    name: str
    width_px: int = Field(ge=160, le=4096)
    height_px: int = Field(ge=120, le=3072)
    fx_px: float = Field(gt=50.0, lt=20000.0)
    fy_px: float = Field(gt=50.0, lt=20000.0)
    cx_px: float = Field(gt=0.0, lt=4096.0)
    cy_px: float = Field(gt=0.0, lt=3072.0)
    distortion: tuple[float, float, float, float, float]
    rate_hz: float = Field(ge=5.0, le=240.0)
    exposure_s: float = Field(default=0.004, ge=0.00002, le=0.05)  # short and fixed: see what moves sharply
    readout_s: float = Field(
        default=0.0, ge=0.0, le=0.05
    )  # first to last row of a rolling shutter; 0: global


class VehicleConfig(StrictModel):
    """Where things sit on the airframe (FRD from the centre of mass) and how it answers."""

    name: str
    camera_position_body_m: Vector
    camera_yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    camera_tilt_deg: float = Field(default=0.0, ge=-45.0, le=45.0)
    range_position_body_m: Vector
    leg_height_m: float = Field(ge=0.02, le=1.0)
    acceleration_time_constant_s: float = Field(ge=0.02, le=1.0)
    thrust_time_constant_s: float = Field(default=0.04, ge=0.01, le=1.0)
    hover_thrust: float = Field(ge=0.1, le=0.9)


# ---------------------------------------------------------------- sense


class ImuConfig(StrictModel):
    """MPU9250: its bus ("i2c:1", or "socket:PATH" for a simulator in another process), ranges and rates.

    `body_from_sensor_deg` (roll, pitch, yaw) turns sensor axes into body FRD. The default is a chip that
    lies face up with its x axis forward: z up and y left become z down and y right.
    """

    bus: str = "i2c:1"
    address: int = Field(default=0x68, ge=0x68, le=0x69)
    rate_hz: int = Field(default=200, ge=50, le=1000)
    poll_hz: int = Field(default=100, ge=20, le=500)
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 500
    accel_range_g: Literal[2, 4, 8, 16] = 8
    filter_hz: Literal[184, 92, 41, 20] = 92
    mag_rate_hz: Literal[8, 100] = 100
    body_from_sensor_deg: Vector = (180.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _rates_fit_the_chip(self) -> ImuConfig:
        if 1000 % self.rate_hz:
            raise ValueError(f"rate_hz {self.rate_hz}: expected a divisor of 1000")
        # the FIFO holds 36 samples: let one poll be skipped without a loss
        if 2 * self.rate_hz > 36 * self.poll_hz:
            raise ValueError(
                f"poll_hz {self.poll_hz}: expected at least {-(-self.rate_hz // 18)} for rate_hz"
            )
        return self


class GpsConfig(StrictModel):
    """NEO-6M on a serial port.

    `latency_s` is from the instant a fix is valid to the first bit of its first message, at the quickest.
    """

    port: str = "/dev/ttyAMA0"
    baud: Literal[9600, 38400, 57600, 115200] = 9600
    rate_hz: int = Field(default=5, ge=1, le=5)
    latency_s: float = Field(default=0.12, ge=0.0, le=0.5)
    antenna_position_body_m: Vector = (0.0, 0.0, -0.05)


class RangeConfig(StrictModel):
    """Downward ultrasonic on a serial port: JSN-SR04T in serial mode, A02YYUW or alike (4-byte frames)."""

    port: str = "/dev/ttyAMA1"
    baud: Literal[9600] = 9600
    minimum_m: float = Field(default=0.03, ge=0.02, le=0.5)
    maximum_m: float = Field(default=4.5, ge=0.5, le=10.0)


class VisionConfig(StrictModel):
    """Marker detection and pose."""

    source: str = "v4l2:0"  # "v4l2:N", or "socket:PATH" for frames from another process
    minimum_side_px: float = Field(default=12.0, ge=8.0, le=100.0)  # smaller markers are not looked for
    maximum_markers: int = Field(default=12, ge=1, le=100)  # refined and used in one frame
    region_margin_px: float = Field(default=14.0, ge=4.0, le=200.0)  # about where the pad is expected
    region_margin_sigma: float = Field(default=3.0, ge=1.0, le=10.0)  # of the expected position
    corner_noise_px: float = Field(default=0.2, gt=0.0, le=5.0)
    scale_error: float = Field(
        default=0.003, ge=0.0, le=0.1
    )  # of the calibration, as a share of the distance
    level_std_deg: float = Field(default=2.0, gt=0.0, le=30.0)  # of the pad and of our attitude together
    relative_speed_std_m_s: float = Field(default=1.0, gt=0.0, le=20.0)  # for a rolling shutter's shear
    turn_rate_std_rad_s: float = Field(default=0.4, gt=0.0, le=10.0)
    maximum_reprojection_error_px: float = Field(default=2.0, gt=0.0, le=10.0)


class SenseConfig(StrictModel):
    """All sensors."""

    imu: ImuConfig = ImuConfig()
    gps: GpsConfig = GpsConfig()
    range: RangeConfig = RangeConfig()
    vision: VisionConfig = VisionConfig()


# ---------------------------------------------------------------- estimate


class AlignmentConfig(StrictModel):
    """The first attitude and the gyroscope's bias, from standing still before arming."""

    still_s: float = Field(default=2.0, ge=0.5, le=20.0)
    timeout_s: float = Field(default=15.0, ge=1.0, le=120.0)  # then start without: larger uncertainty
    still_rate_rad_s: float = Field(default=0.02, gt=0.0, le=0.2)  # standard deviation that counts as still
    still_force_m_s2: float = Field(default=0.25, gt=0.0, le=2.0)


class OrientationConfig(StrictModel):
    """The orientation pre-filter (eqs. 14-16); error rates are of the quaternion: half of rad/s."""

    kind: Literal["complementary", "madgwick"] = "complementary"
    gyro_error_rate: float = Field(default=0.01, gt=0.0, le=1.0)
    heading_error_rate: float = Field(default=0.01, gt=0.0, le=1.0)
    accel_average_s: float = Field(default=2.0, ge=0.0, le=20.0)
    accel_gate_m_s2: float = Field(default=0.8, gt=0.0, le=10.0)
    mag_gate: float = Field(default=0.15, gt=0.0, le=1.0)  # share of the field's size
    dip_gate_deg: float = Field(default=10.0, gt=0.0, le=90.0)


class EkfConfig(StrictModel):
    """The 31-state EKF (Table 5): noises are standard deviations of one sample unless the name says more."""

    imu_samples_per_step: int = Field(default=2, ge=1, le=10)
    gyro_noise_rad_s: float = Field(default=0.005, gt=0.0, le=1.0)
    accel_noise_m_s2: float = Field(default=1.0, gt=0.0, le=20.0)
    mag_rate_hz: float = Field(default=25.0, ge=1.0, le=100.0)
    mag_noise_ut: float = Field(default=1.5, gt=0.0, le=20.0)
    orientation_rate_hz: float = Field(default=10.0, ge=0.5, le=50.0)
    orientation_tilt_noise_deg: float = Field(default=12.0, gt=0.0, le=90.0)
    orientation_heading_noise_deg: float = Field(default=20.0, gt=0.0, le=180.0)
    gps_position_noise_m: float = Field(default=3.0, gt=0.0, le=50.0)  # floor: a fix's error wanders, slowly
    gps_velocity_noise_m_s: float = Field(default=0.1, gt=0.0, le=5.0)  # floor
    gps_patience_s: float = Field(default=2.0, gt=0.0, le=60.0)  # refused for so long: start again from GPS
    gps_timeout_s: float = Field(default=2.0, gt=0.0, le=60.0)
    remember_s: float = Field(default=0.6, ge=0.1, le=3.0)  # how late a measurement may come
    rate_time_constant_s: float = Field(default=5.0, ge=0.05, le=100.0)
    angular_acceleration_rad_s2_rthz: float = Field(default=0.2, gt=0.0, le=50.0)
    acceleration_time_constant_s: float = Field(default=1.0, ge=0.05, le=100.0)
    jerk_m_s3_rthz: float = Field(default=4.0, gt=0.0, le=100.0)
    accel_bias_std_m_s2: float = Field(default=0.12, gt=0.0, le=2.0)
    accel_bias_walk_m_s2_rts: float = Field(default=0.002, ge=0.0, le=1.0)
    gyro_bias_walk_rad_s_rts: float = Field(default=2e-5, ge=0.0, le=0.1)
    field_std_ut: float = Field(default=0.3, gt=0.0, le=20.0)
    field_walk_ut_rts: float = Field(default=0.005, ge=0.0, le=5.0)
    mag_bias_std_ut: float = Field(default=1.0, gt=0.0, le=50.0)
    mag_bias_walk_ut_rts: float = Field(default=0.02, ge=0.0, le=5.0)


class PadFilterConfig(StrictModel):
    """The relative motion of the pad; `_rthz` is a density per root of hertz."""

    horizontal_jerk_m_s3_rthz: float = Field(default=1.0, gt=0.0, le=50.0)
    vertical_jerk_m_s3_rthz: float = Field(default=1.0, gt=0.0, le=50.0)
    horizontal_time_constant_s: float = Field(default=1.5, ge=0.1, le=100.0)  # of the pad's acceleration
    vertical_time_constant_s: float = Field(default=1.0, ge=0.1, le=100.0)
    vehicle_acceleration_noise_m_s2_rthz: float = Field(default=0.08, gt=0.0, le=5.0)
    heading_acceleration_rad_s2_rthz: float = Field(default=0.3, gt=0.0, le=20.0)
    heading_noise_deg: float = Field(default=0.5, ge=0.0, le=45.0)  # added to what the sighting says
    sighting_noise_scale: float = Field(default=1.5, ge=0.1, le=20.0)
    sighting_noise_floor_m: float = Field(default=0.001, ge=0.0, le=1.0)
    attitude_jitter_deg: float = Field(default=0.05, ge=0.0, le=10.0)  # the attitude error's fast part
    exposure_jitter_s: float = Field(default=0.005, ge=0.0, le=0.1)  # of the exposure against the IMU's clock
    first_speed_std_m_s: float = Field(default=2.0, gt=0.0, le=20.0)
    first_climb_std_m_s: float = Field(default=0.4, gt=0.0, le=20.0)  # pads drive, but hardly rise
    range_noise_m: float = Field(default=0.03, gt=0.0, le=1.0)
    range_maximum_height_m: float = Field(default=2.5, gt=0.0, le=10.0)
    range_maximum_tilt_deg: float = Field(default=20.0, gt=0.0, le=60.0)
    patience_s: float = Field(default=0.5, gt=0.0, le=10.0)  # sightings refused for so long: start again
    remember_s: float = Field(default=1.0, ge=0.1, le=5.0)
    forget_s: float = Field(default=10.0, ge=1.0, le=60.0)  # unseen for so long: no pad


class EstimateConfig(StrictModel):
    """Orientation filters, the 31-state EKF and the pad filter. Declination and dip follow from the field."""

    madgwick_gain: float = Field(default=0.06, ge=0.0, le=2.0)
    magnetic_field_ned_ut: Vector = (20.9, 0.6, 42.9)
    acceleration_filter_s: float = Field(default=0.02, ge=0.0, le=1.0)
    alignment: AlignmentConfig = AlignmentConfig()
    orientation: OrientationConfig = OrientationConfig()
    ekf: EkfConfig = EkfConfig()
    pad: PadFilterConfig = PadFilterConfig()

    @field_validator("magnetic_field_ned_ut")
    @classmethod
    def _has_a_north(cls, field: Vector) -> Vector:
        if math.hypot(field[0], field[1]) < 1.0:
            raise ValueError(f"expected a horizontal field of at least 1 µT to tell north by, found {field}")
        return field


# ---------------------------------------------------------------- plan


class PhaseTimesConfig(StrictModel):
    """How long each phase may last: every state ends by time."""

    connect_s: float = Field(default=90.0, ge=5.0, le=3600.0)
    arm_s: float = Field(default=25.0, ge=2.0, le=300.0)
    take_off_s: float = Field(default=40.0, ge=5.0, le=300.0)
    waypoint_s: float = Field(default=60.0, ge=5.0, le=1800.0)
    search_s: float = Field(default=60.0, ge=5.0, le=600.0)
    approach_s: float = Field(default=30.0, ge=5.0, le=300.0)
    descend_s: float = Field(default=30.0, ge=5.0, le=300.0)
    touchdown_s: float = Field(default=45.0, ge=5.0, le=300.0)
    hold_s: float = Field(default=10.0, ge=1.0, le=300.0)


class MissionConfig(StrictModel):
    """The flight: where to look for the pad, when to ask again, when to give up."""

    take_off_height_m: float = Field(default=7.0, ge=1.0, le=50.0)
    waypoint_ned_m: tuple[float, float] = (10.0, 0.0)
    arrival_radius_m: float = Field(default=1.5, ge=0.2, le=20.0)
    arrival_speed_m_s: float = Field(default=0.8, ge=0.1, le=5.0)
    align_heading: bool = True
    fence_m: float = Field(default=150.0, ge=10.0, le=2000.0)  # from home; no beacon is followed beyond
    largest_speed_std_m_s: float = Field(default=1.0, gt=0.0, le=10.0)  # of our velocity, away from the pad
    total_timeout_s: float = Field(default=180.0, ge=10.0, le=3600.0)
    action_retry_s: float = Field(default=2.0, ge=0.2, le=30.0)
    action_answer_s: float = Field(default=6.0, ge=0.5, le=60.0)
    action_attempts: int = Field(default=4, ge=1, le=20)
    phases: PhaseTimesConfig = PhaseTimesConfig()


class GuidanceConfig(StrictModel):
    """What the reference may ask for, relative to the pad: a fixed camera must keep it in view."""

    minimum_time_s: float = Field(default=1.0, ge=0.3, le=5.0)  # T_min of eq. 37
    horizontal_speed_m_s: float = Field(default=3.0, gt=0.0, le=10.0)
    vertical_speed_m_s: float = Field(default=1.2, gt=0.0, le=5.0)
    horizontal_acceleration_m_s2: float = Field(default=2.0, gt=0.0, le=5.0)
    vertical_acceleration_m_s2: float = Field(default=0.8, gt=0.0, le=5.0)
    heading_rate_deg_s: float = Field(default=30.0, gt=0.0, le=180.0)
    stray_m: float = Field(default=0.8, ge=0.1, le=5.0)  # reference to estimate, beyond it starts afresh


class SearchConfig(StrictModel):
    """Looking for the pad; Algorithm 1's other branch."""

    stream_s: float = Field(default=0.5, ge=0.1, le=5.0)  # setpoints before control is asked for
    hold_s: float = Field(default=0.7, ge=0.0, le=30.0)
    request_s: float = Field(default=1.5, ge=1.0, le=60.0)
    dwell_s: float = Field(default=2.0, ge=0.0, le=30.0)  # over the pad's likely place, before the spiral
    spacing_m: float = Field(default=4.0, ge=0.5, le=30.0)
    radius_m: float = Field(default=12.0, ge=1.0, le=200.0)
    trust_s: float = Field(default=12.0, ge=1.0, le=120.0)  # a word of where the pad is, until it is stale
    lead_s: float = Field(default=5.0, ge=0.0, le=30.0)  # and how far its velocity is carried on
    climb_m: float = Field(default=6.0, ge=0.0, le=30.0)
    floor_m: float = Field(default=1.5, ge=0.5, le=10.0)  # over home and the last echoes, the pad unseen
    sightings: int = Field(default=5, ge=1, le=100)
    sightings_window_s: float = Field(default=0.5, ge=0.1, le=5.0)
    velocity_std_m_s: float = Field(default=0.5, gt=0.0, le=5.0)  # the pad's velocity, to take it up
    stopping_m_s2: float = Field(default=2.0, gt=0.0, le=10.0)  # braking over the pad, it shall stay in view:
    view_slope: float = Field(default=0.4, gt=0.0, le=2.0)  # metres aside for each metre of height


class LandingConfig(StrictModel):
    """Approach and descent over the pad; heights are of the feet over the pad."""

    approach_height_m: float = Field(default=3.0, ge=1.0, le=20.0)
    approach_slope: float = Field(default=0.35, gt=0.0, le=3.0)  # metres aside for each metre of height
    cone_slope: float = Field(default=0.2, gt=0.0, le=1.0)
    cone_floor_m: float = Field(default=0.10, gt=0.0, le=1.0)
    wait_height_m: float = Field(default=0.35, ge=0.1, le=2.0)
    retry_height_m: float = Field(default=1.5, ge=0.3, le=5.0)
    retries: int = Field(default=3, ge=0, le=20)
    pause_unseen_s: float = Field(default=0.5, gt=0.0, le=5.0)
    lost_unseen_s: float = Field(default=3.0, gt=0.0, le=10.0)
    ground_near_m: float = Field(default=1.5, gt=0.0, le=4.0)  # echoes this near, and the pad thought to lie
    ground_doubt_m: float = Field(default=0.8, gt=0.1, le=4.0)  # so much lower: break off, climb and search


class TouchdownConfig(StrictModel):
    """The last third of a metre: when to commit, how fast, and what counts as contact."""

    lateral_m: float = Field(default=0.06, gt=0.0, le=0.5)
    lateral_speed_m_s: float = Field(default=0.12, gt=0.0, le=1.0)
    settled_s: float = Field(default=0.2, ge=0.0, le=5.0)
    gentle_horizontal_m_s2: float = Field(default=0.7, gt=0.0, le=5.0)
    gentle_vertical_m_s2: float = Field(default=0.2, gt=0.0, le=5.0)
    patience_s: float = Field(default=5.0, ge=0.5, le=60.0)
    contact_speed_m_s: float = Field(default=0.22, ge=0.05, le=0.4)
    fastest_contact_m_s: float = Field(default=0.35, ge=0.05, le=1.0)  # sinking faster, higher up than this:
    break_off_above_m: float = Field(default=0.1, ge=0.03, le=1.0)  # rise and wait again
    blend_s: float = Field(default=0.8, ge=0.2, le=3.0)
    blind_s: float = Field(default=1.5, ge=0.1, le=5.0)
    overdue_s: float = Field(default=1.5, ge=0.3, le=10.0)
    escape_lateral_m: float = Field(default=0.18, gt=0.0, le=1.0)
    contact_margin_m: float = Field(default=0.02, gt=0.0, le=0.2)
    contact_s: float = Field(default=0.15, ge=0.0, le=1.0)
    land_after_s: float = Field(default=2.0, ge=0.5, le=30.0)


class PlanConfig(StrictModel):
    """The planner."""

    rate_hz: float = Field(default=30.0, ge=10.0, le=100.0)
    fuzzy: str = "landing"
    mission: MissionConfig = MissionConfig()
    guidance: GuidanceConfig = GuidanceConfig()
    search: SearchConfig = SearchConfig()
    landing: LandingConfig = LandingConfig()
    touchdown: TouchdownConfig = TouchdownConfig()


# ---------------------------------------------------------------- control


class LimitsConfig(StrictModel):
    """The last gate: nothing beyond these leaves for the autopilot."""

    horizontal_speed_m_s: float = Field(default=6.0, gt=0.0, le=20.0)
    climb_speed_m_s: float = Field(default=1.5, gt=0.0, le=5.0)
    descent_speed_m_s: float = Field(default=1.5, gt=0.0, le=5.0)
    horizontal_acceleration_m_s2: float = Field(default=4.0, gt=0.0, le=10.0)
    vertical_acceleration_m_s2: float = Field(default=3.0, gt=0.0, le=8.0)
    tilt_deg: float = Field(default=25.0, gt=0.0, le=45.0)
    jerk_m_s3: float = Field(default=20.0, gt=0.0, le=200.0)
    heading_rate_deg_s: float = Field(default=45.0, gt=0.0, le=180.0)
    minimum_thrust: float = Field(default=0.05, ge=0.0, le=0.5)
    maximum_thrust: float = Field(default=0.9, gt=0.5, le=1.0)


class TrackingConfig(StrictModel):
    """The MPC's weights along one direction, each as the deviation that costs 1 (eq. 39)."""

    position_m: float = Field(gt=0.0, le=10.0)
    velocity_m_s: float = Field(gt=0.0, le=10.0)
    acceleration_m_s2: float = Field(gt=0.0, le=100.0)
    effort_m_s2: float = Field(gt=0.0, le=100.0)  # command off what the reference needs
    effort_change_m_s2: float = Field(gt=0.0, le=100.0)  # the same, from one step to the next


class ControlConfig(StrictModel):
    """The MPC and what it sends."""

    setpoint: Literal["velocity", "attitude"] = "velocity"
    rate_hz: float = Field(default=30.0, ge=10.0, le=100.0)
    horizon_steps: int = Field(default=20, ge=5, le=100)
    step_s: float = Field(default=0.1, ge=0.01, le=0.5)
    command_delay_s: float = Field(default=0.03, ge=0.0, le=0.2)  # from the decision to the autopilot's loop
    velocity_lookahead_s: float = Field(default=0.02, ge=0.0, le=0.5)  # beyond the delay
    autopilot_velocity_gain_1_s: float = Field(default=2.2, ge=0.5, le=10.0)
    autopilot_climb_gain_1_s: float = Field(default=4.0, ge=0.5, le=10.0)
    acceleration_estimate_lag_s: float = Field(default=0.035, ge=0.001, le=0.2)  # sensor and its filters
    lasting_disturbance_s: float = Field(default=1.0, ge=0.1, le=20.0)  # what lasts so long is for v_sp
    maximum_disturbance_m_s2: float = Field(default=3.0, ge=0.0, le=8.0)
    maximum_velocity_correction_m_s: float = Field(default=0.6, ge=0.0, le=3.0)
    horizontal_reach_m: float = Field(default=2.0, gt=0.0, le=20.0)  # a reference farther off is drawn nearer
    vertical_reach_m: float = Field(default=0.7, gt=0.0, le=20.0)
    pad_acceleration_decay_s: float = Field(default=1.0, ge=0.05, le=10.0)
    ground_descent_m_s: float = Field(default=0.6, ge=0.1, le=1.5)
    ground_acceleration_m_s2: float = Field(default=0.5, ge=0.0, le=3.0)
    ground_thrust: float = Field(default=0.1, ge=0.0, le=0.3)
    maximum_iterations: int = Field(default=400, ge=50, le=10000)
    horizontal: TrackingConfig = TrackingConfig(
        position_m=0.15, velocity_m_s=0.5, acceleration_m_s2=4.0, effort_m_s2=1.2, effort_change_m_s2=0.8
    )
    vertical: TrackingConfig = TrackingConfig(
        position_m=0.1, velocity_m_s=0.5, acceleration_m_s2=4.0, effort_m_s2=1.8, effort_change_m_s2=1.5
    )
    limits: LimitsConfig = LimitsConfig()


# ---------------------------------------------------------------- link


CONNECTION_FORM = re.compile(
    r"(?P<kind>udp|udpin):(?P<host>[^:\s]+):(?P<port>\d{1,5})|serial:(?P<path>/\S+):(?P<baud>\d{4,7})"
)


class LinkConfig(StrictModel):
    """The autopilot's port, who we are on it, and how patient we are.

    `connection` is serial:PATH:BAUD, udp:HOST:PORT (we call) or udpin:HOST:PORT (we listen). `system_id` is
    the vehicle's and so ours; 0 takes the first autopilot heard. `component_id` is ours; MAVSDK, which speaks
    beside us, is another component. `force_disarm` allows disarming by force after a
    touchdown that several signs have confirmed for seconds while the autopilot's land detector still
    believes itself in the air, as it may on a pad that moves; never elsewhere. The pad's beacon is taken from
    `ground_system_id` alone, and only when it is not faster than `maximum_pad_speed_m_s`. `set_parameters`
    allows setting the one autopilot parameter that we need: bit 3 of ArduPilot's GUID_OPTIONS, for attitude
    setpoints; without it control is refused while the bit is missing.
    """

    connection: str = "udpin:127.0.0.1:14540"
    actions: Literal["mavsdk", "pymavlink"] = "mavsdk"
    system_id: int = Field(default=1, ge=0, le=255)
    component_id: int = Field(default=191, ge=2, le=255)
    mavsdk_component_id: int = Field(default=192, ge=2, le=255)
    ground_system_id: int = Field(default=255, ge=1, le=255)
    maximum_pad_speed_m_s: float = Field(default=8.0, gt=0.0, le=30.0)
    heartbeat_timeout_s: float = Field(default=3.0, ge=1.0, le=30.0)
    command_patience_s: float = Field(default=0.5, ge=0.1, le=5.0)
    command_tries: int = Field(default=4, ge=1, le=10)
    force_disarm: bool = True
    set_parameters: bool = False

    @field_validator("connection")
    @classmethod
    def _has_a_known_form(cls, value: str) -> str:
        form = CONNECTION_FORM.fullmatch(value)
        if form is None or not 1 <= int(form["port"] or 1) <= 65535:
            raise ValueError(
                "expected serial:PATH:BAUD, udp:HOST:PORT or udpin:HOST:PORT with a port of 1..65535, "
                f"found '{value}'"
            )
        return value

    @model_validator(mode="after")
    def _has_a_component_for_each(self) -> LinkConfig:
        if self.component_id == self.mavsdk_component_id:
            raise ValueError(
                f"expected mavsdk_component_id to differ from component_id, found {self.component_id} twice"
            )
        return self


class ComputeConfig(StrictModel):
    """How long things take on a Raspberry Pi; virtual time holds results back for as long."""

    vision_s: float = Field(default=0.025, ge=0.0, le=0.5)
    control_s: float = Field(default=0.003, ge=0.0, le=0.1)


class CompanionConfig(StrictModel):
    """The whole tree."""

    pad: str = "moving_1300"
    camera: str = "sitl_640x480"
    vehicle: str = "x500"
    sense: SenseConfig = SenseConfig()
    estimate: EstimateConfig = EstimateConfig()
    plan: PlanConfig = PlanConfig()
    control: ControlConfig = ControlConfig()
    link: LinkConfig = LinkConfig()
    compute: ComputeConfig = ComputeConfig()


def load_config(path: Path, overrides: dict[str, Any] | None = None) -> CompanionConfig:
    """Read the app's settings file, with `overrides` laid over it.

    Raises:
        ConfigError: one line that says what, where and what was expected.
    """
    return validate(CompanionConfig, merge(read_yaml(path), overrides or {}), str(path))
