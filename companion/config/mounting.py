"""What `calibrate-mount` writes and the app reads: how the camera and the inertial sensor really sit.

Body axes are FRD, sensor axes the chip's own, camera axes OpenCV's. SI units.
"""

from pathlib import Path
from typing import Literal

from pydantic import Field

from companion.base.errors import ConfigError
from companion.base.files import find_file
from companion.config.calibration import Provenance
from companion.config.reading import Model, StrictModel, Vector, load_model, read_yaml, validate
from companion.config.sense import SenseConfig
from companion.config.vehicle import CameraConfig, VehicleConfig

Matrix = tuple[Vector, Vector, Vector]


class MountStd(StrictModel):
    """Standard deviations of a mount calibration; the rotation's are about the body's axes."""

    rotation_deg: Vector
    position_m: Vector
    time_offset_s: float = Field(gt=0.0)


class MountCalibration(StrictModel):
    """Where the camera sits, and when its frames were really exposed; goes before the vehicle's file.

    The angles are those of the vehicle's file (see `VehicleConfig`). `time_offset_s` is added to every
    frame's stamp, which gives the exposure on the inertial samples' time scale: stamps that are 20 ms late
    have -0.02.
    """

    kind: Literal["mount"] = "mount"
    camera: str  # its name, in its file
    camera_roll_deg: float = Field(ge=-180.0, le=180.0)
    camera_tilt_deg: float = Field(ge=-90.0, le=90.0)
    camera_yaw_deg: float = Field(ge=-180.0, le=180.0)
    camera_position_body_m: Vector
    time_offset_s: float = Field(ge=-0.5, le=0.5)
    std: MountStd
    residual: float = Field(ge=0.0)  # of the sightings, in their own standard deviations
    forced: tuple[str, ...] = ()  # what it would have been refused for
    provenance: Provenance

    def applied_to(self, vehicle: VehicleConfig) -> VehicleConfig:
        """The vehicle with the camera as it was found to be."""
        return vehicle.model_copy(
            update={
                "camera_roll_deg": self.camera_roll_deg,
                "camera_tilt_deg": self.camera_tilt_deg,
                "camera_yaw_deg": self.camera_yaw_deg,
                "camera_position_body_m": self.camera_position_body_m,
                "camera_time_offset_s": self.time_offset_s,
            }
        )


class AccelerometerCalibration(StrictModel):
    """True specific force = `matrix` (measured - `offset_m_s2`), in sensor axes."""

    offset_m_s2: Vector
    matrix: Matrix
    residual_m_s2: float = Field(ge=0.0)  # root mean square of |a| - g over the rests
    faces: int = Field(ge=0, le=6)  # of the six, that were down


class GyroCalibration(StrictModel):
    """True rate = measured - `bias_rad_s`, in sensor axes, at the temperature at which it was at rest."""

    bias_rad_s: Vector
    std_rad_s: float = Field(ge=0.0)  # of the bias: what it changed from one rest to the next
    temperature_c: float


class InertialCalibration(StrictModel):
    """The MPU9250's accelerometer and gyroscope, in the chip's own axes (before `body_from_sensor_deg`)."""

    kind: Literal["inertial"] = "inertial"
    accelerometer: AccelerometerCalibration | None = None
    gyro: GyroCalibration
    forced: tuple[str, ...] = ()  # what it would have been refused for
    provenance: Provenance


def load_inertial(sense: SenseConfig) -> InertialCalibration | None:
    """The calibration of the inertial sensor in use; None when the settings name none for it.

    The file is the MPU9250's: an autopilot has calibrated its own samples before anybody hears them.

    Raises:
        ConfigError: the file is missing or wrong.
    """
    name = sense.imu.inertial_calibration
    if name is None or sense.source == "autopilot":
        return None
    return _written_by_the_tool(InertialCalibration, name, "sense.imu.inertial_calibration", "inertial")


def _written_by_the_tool(model: type[Model], name: str, key: str, kind: str) -> Model:
    """One of our files, of the setting `key`.

    Raises:
        ConfigError: it is missing, wrong, or of another kind; the line names the setting.
    """
    data = read_yaml(Path(name), key)
    if (found := data.get("kind", kind)) != kind:
        raise ConfigError(
            f"{key}: {name} is of kind '{found}'; expected '{kind}', as calibrate-mount writes it"
        )
    return validate(model, data, name)


def load_vehicle(vehicle: str, mount: str | None, camera: str) -> VehicleConfig:
    """The vehicle of the settings, with the camera's mount calibration laid over it if there is one.

    Raises:
        ConfigError: a file is missing or wrong, or the calibration is another camera's.
    """
    body = load_model(VehicleConfig, find_file("vehicles", vehicle))
    calibration = load_mount(mount, camera)
    return body if calibration is None else calibration.applied_to(body)


def load_mount(mount: str | None, camera: str) -> MountCalibration | None:
    """The camera's mount calibration, if the settings name one.

    Raises:
        ConfigError: a file is missing or wrong, or the calibration is another camera's.
    """
    if mount is None:
        return None
    calibration = _written_by_the_tool(MountCalibration, mount, "mount", "mount")
    name = load_model(CameraConfig, find_file("cameras", camera)).name
    if calibration.camera != name:
        raise ConfigError(f"{mount}: is for the camera '{calibration.camera}', expected '{name}'")
    return calibration
