"""Named scenarios: the pad's motion, the weather, the sensors' quality and faults, and what is a landing.

A scenario with a seed is one flight, repeatable to the bit. `companion` holds what the operator knows and
would set in the app: overrides of its settings. All else stays in the simulator.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field, model_validator

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import Vector3
from companion.base.magnetic_field import field_ned_ut
from companion.config import ConfigError, Shape, StrictModel, find_file, load_model, validate
from sitl.autopilot.control.attitude_control import RateGains
from sitl.autopilot.control.estimator import EstimatorName
from sitl.camera.exposure import DirtSettings, ExposureSettings
from sitl.camera.light import LightSettings
from sitl.faults.faults import AnyFault
from sitl.faults.lines import LinkSettings
from sitl.pad.motion import PadMotionSettings
from sitl.pad.paths import Angle, DeckSettings, Heading, HeaveMotion, StaticMotion
from sitl.scenario.as_built import AsBuiltSettings, BuiltVehicle, draw
from sitl.vehicle.quadrotor import QuadrotorParameters
from sitl.world.contact import ContactParameters
from sitl.world.wind import WindSettings

# latitude (deg), longitude (deg), altitude (m AMSL) at which the autopilots' own simulators start
USUAL_HOMES: Final[dict[AutopilotKind, Vector3]] = {
    "px4": (47.397742, 8.545594, 488.0),
    "ardupilot": (-35.363262, 149.165237, 584.0),
}
# of the magnetic model, whatever the date: the same seed gives the same flight
FIELD_YEAR: Final = 2026.0
_FIELD_DIGITS: Final = 2  # to 10 nT, as calculators of the model give it
_OPTION: Final = "--home"
_EXPECTED: Final = (
    "expected LAT,LON,ALT,HEADING (deg, deg, m above sea level, deg), as in 47.397742,8.545594,488,90"
)


class HomeSettings(StrictModel):
    """The world's origin."""

    latitude_deg: float = Field(
        ge=-85.0,
        le=85.0,
        description=(
            "Latitude of the world's origin. Without `home` it is where the autopilot's own simulator "
            "starts: 47.397742, 8.545594, 488 m (PX4), -35.363262, 149.165237, 584 m (ArduPilot). The "
            "magnetic field follows the place"
        ),
    )
    longitude_deg: float = Field(ge=-180.0, le=180.0, description="Longitude of the world's origin")
    altitude_m: float = Field(
        default=0.0, ge=-500.0, le=9000.0, description="Altitude of the world's origin above sea level"
    )

    @property
    def place(self) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m AMSL)."""
        return self.latitude_deg, self.longitude_deg, self.altitude_m


def magnetic_field_ned_ut(place: Vector3) -> Vector3:
    """The Earth's field (µT, NED) at a place (deg, deg, m), as one reads it from the magnetic model."""
    north, east, down = field_ned_ut(*place, FIELD_YEAR)
    return round(north, _FIELD_DIGITS), round(east, _FIELD_DIGITS), round(down, _FIELD_DIGITS)


def read_home(text: str) -> tuple[HomeSettings, float]:
    """Place and heading (deg) in LAT,LON,ALT,HEADING.

    Raises:
        ConfigError: it is something else, or there is no such place.
    """
    try:
        latitude, longitude, altitude, heading = (float(word) for word in text.split(","))
    except ValueError:
        raise ConfigError(f"{_OPTION}: {_EXPECTED}, found '{text}'") from None
    if not -360.0 <= heading <= 360.0:
        raise ConfigError(f"{_OPTION}: expected a heading of -360 to 360 degrees, found {heading:g}")
    place = {"latitude_deg": latitude, "longitude_deg": longitude, "altitude_m": altitude}
    return validate(HomeSettings, place, _OPTION), heading


# of a board as large as the shipped pads are; a larger one may dip an edge into the sea
LARGEST_HALF_DIAGONAL_M: Final = 1.0


Tilt = Annotated[float, Field(ge=-180.0, le=180.0)]
Shift = Annotated[float, Field(ge=-0.5, le=0.5)]


class AirframeConfig(StrictModel):
    """The plant's parameters (configs/airframes), and how the rate loops are tuned to it.

    Without `rates` the autopilot flies by its own defaults.
    """

    name: str
    body: QuadrotorParameters
    legs: ContactParameters
    rates: RateGains | None = None


class PadSettings(StrictModel):
    """Which pad, how high its surface is over the ground, how it moves and where it points."""

    name: str = Field(default="moving_1300", description="A name in configs/pads, or a path")
    surface_height_m: float = Field(
        default=0.1,
        ge=0.0,
        le=10.0,
        description="Height of the pad's surface over the ground; of a heaving pad over the mean sea level",
    )
    heading: Heading = Field(default="along", description="`along`: it points where it moves")
    motion: Annotated[PadMotionSettings, Field(discriminator="kind")] = StaticMotion(kind="static")
    deck: DeckSettings | None = None

    @model_validator(mode="after")
    def _over_the_ground(self) -> PadSettings:
        needed = self.motion.largest_excursion_m() if isinstance(self.motion, HeaveMotion) else 0.0
        if self.deck is not None:
            needed += self.deck.largest_excursion_m(LARGEST_HALF_DIAGONAL_M)
        if needed > self.surface_height_m:
            raise ValueError(
                f"surface_height_m is {self.surface_height_m:g}; expected at least {needed:.2f}, "
                "or the waves' troughs take the pad underground"
            )
        return self


class CameraSettings(StrictModel):
    """The simulated camera: its optics (configs/cameras) and its faults."""

    config: str = Field(
        default="sitl_640x480", description="Camera file: a name in configs/cameras, or a path"
    )
    latency_s: float = Field(
        default=0.045, ge=0.0, le=0.25, description="Latency from mid-exposure to delivery"
    )
    latency_jitter_s: float = Field(default=0.005, ge=0.0, le=0.05, description="Random part of the latency")
    exposure_s: float = Field(
        default=0.003,
        gt=0.0,
        le=0.03,
        description="Exposure of every row; with a `light`, automatic exposure sets it",
    )
    readout_s: float = Field(
        default=0.015,
        ge=0.0,
        le=0.03,
        description="Time from the first to the last row of the rolling shutter",
    )
    noise_grey: float = Field(
        default=3.0,
        ge=0.0,
        le=50.0,
        description="Standard deviation of a pixel; with a `light`, of a white pixel at gain 1",
    )
    calibration_error: float = Field(
        default=0.003, ge=0.0, le=0.1, description="Error of focal length and principal point"
    )
    mount_error_deg: tuple[Tilt, Tilt, Tilt] = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "Error of the camera's mounting against the vehicle's file: further roll, pitch and yaw about "
            "the body's axes"
        ),
    )
    mount_offset_m: tuple[Shift, Shift, Shift] = Field(
        default=(0.0, 0.0, 0.0), description="Error of its position: forward, right, down"
    )
    stamp_error_s: float = Field(
        default=0.0, ge=-0.04, le=0.1, description="Added to every frame's exposure time"
    )
    blur: bool = Field(default=True, description="Motion blur during the exposure")
    rate_hz: Annotated[float, Field(ge=1.0, le=120.0)] | None = Field(
        default=None, description="Frames per second; none: as its file says"
    )
    exposure: ExposureSettings = ExposureSettings()
    dirt: DirtSettings | None = None
    lost_share: float = Field(
        default=0.0, ge=0.0, lt=1.0, description="Share of the frames that the camera drops"
    )
    lost_burst_frames: float = Field(
        default=1.0, ge=1.0, le=300.0, description="Mean number of frames dropped in a row; 1: single frames"
    )


class SensorSettings(StrictModel):
    """Factors on each sensor's data-sheet noise, whether anybody has calibrated it, GPS delay, wiring."""

    calibrated: bool = Field(
        default=True,
        description="`false`: uncalibrated IMUs and magnetometers, with the vehicle's iron near them",
    )
    imu_noise_factor: float = Field(
        default=1.0,
        ge=0.0,
        le=20.0,
        description="Factor on the data sheet's noise of the IMU, vibration included",
    )
    vibration_factor: float = Field(
        default=1.0,
        ge=0.0,
        le=50.0,
        description="Factor on the rotors' vibration alone; 1 is a well damped mount, 4 a bad one",
    )
    mag_noise_factor: float = Field(
        default=1.0, ge=0.0, le=20.0, description="Factor on the magnetometer's noise"
    )
    gps_noise_factor: float = Field(
        default=1.0, ge=0.0, le=20.0, description="Factor on the GPS noise, its wander included"
    )
    range_noise_factor: float = Field(
        default=1.0, ge=0.0, le=20.0, description="Factor on the rangefinder's noise"
    )
    range_minimum_m: float = Field(
        default=0.03,
        ge=0.0,
        le=0.5,
        description="Distance that the rangefinder reports for anything nearer; a JSN-SR04T's is 0.2 to 0.25",
    )
    gps_delay_s: float = Field(default=0.12, ge=0.0, le=1.0, description="Delay from a fix to its message")
    gps_wake_baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] = Field(
        default=9600, description="Baud rate of the receiver until it is configured"
    )
    imu_interface: Literal["i2c", "spi"] = Field(default="i2c", description="How the MPU9250 is wired")
    ultrasonic: Literal["frames", "polled"] = Field(
        default="frames", description="Rangefinder that sends 4-byte frames, or a US-100 that is polled"
    )


class BeaconSettings(StrictModel):
    """The pad's own GPS, which the ground station sends on."""

    available: bool = Field(
        default=True, description="`false`: the ground station answers that it has no pad position"
    )
    position_std_m: float = Field(
        default=1.5,
        ge=0.0,
        le=50.0,
        description="Error of the pad's own GPS, which the ground station forwards on request",
    )
    velocity_std_m_s: float = Field(
        default=0.1, ge=0.0, le=5.0, description="Error of its velocity, each axis"
    )
    rate_hz: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        default=None,
        description="Rate of its fixes; an answer has the newest; none: each answer has a fresh fix",
    )
    delay_s: float = Field(default=0.5, ge=0.0, le=5.0, description="Delay from the request to the answer")


class PassBounds(StrictModel):
    """What a landing has to keep at touchdown, relative to the pad."""

    lateral_error_m: float = Field(
        default=0.15, gt=0.0, le=5.0, description="Largest lateral offset from the pad's centre at touchdown"
    )
    vertical_speed_m_s: float = Field(
        default=0.4,
        gt=0.0,
        le=5.0,
        description="Largest speed at touchdown, relative to the pad and along its normal",
    )
    horizontal_speed_m_s: float = Field(
        default=0.3,
        gt=0.0,
        le=5.0,
        description="Largest speed at touchdown, relative to the pad and along its surface",
    )
    tilt_deg: float = Field(
        default=10.0, gt=0.0, le=90.0, description="Largest angle from the pad's normal at touchdown"
    )


class Scenario(StrictModel):
    """One named flight."""

    model_config = ConfigDict(populate_by_name=True)

    name: str = Field(min_length=1, description="Name of the scenario")
    description: str = Field(min_length=1, description="One line")
    time_limit_s: float = Field(
        default=120.0,
        ge=5.0,
        le=900.0,
        description="The flight ends and is judged at this time at the latest",
    )
    autopilot: AutopilotKind = Field(
        default="px4", description="Autopilot profile of the simulated autopilot"
    )
    autopilot_parameters: dict[str, float] = Field(
        default_factory=dict,
        description=(
            "Parameters of the bundled autopilot by name, instead of its defaults: for example a wrong "
            "MOT_THST_HOVER"
        ),
    )
    airframe: str = Field(default="x500", description="A name in configs/airframes, or a path")
    estimator: EstimatorName = Field(
        default="typical",
        description=(
            "Quality of the autopilot's own estimate: typical, exact, or as in PX4's or ArduPilot's own "
            "simulator"
        ),
    )
    mass_factor: float = Field(
        default=1.0,
        ge=0.5,
        le=1.6,
        description="Factor on the mass, unknown to the app and the autopilot; 1.1 is 10 % heavier",
    )
    home: HomeSettings | None = None
    start_heading_deg: Angle = Field(default="random", description="Heading of the vehicle on the ground")
    pad: PadSettings = PadSettings()
    obstacles: tuple[Shape, ...] = Field(
        default=(),
        description=(
            "Obstacles in the world: a list as in obstacles and waypoints (docs/how-to/obstacles.md); the "
            "app knows of none unless `companion` lists them too"
        ),
    )
    wind: WindSettings = WindSettings()
    light: LightSettings | None = None
    camera: CameraSettings = CameraSettings()
    sensors: SensorSettings = SensorSettings()
    beacon: BeaconSettings = BeaconSettings()
    link: LinkSettings = LinkSettings()
    as_built: AsBuiltSettings | None = None
    faults: tuple[Annotated[AnyFault, Field(discriminator="kind")], ...] = Field(
        default=(), description="Faults and their times: a list, see below"
    )
    pass_bounds: PassBounds = Field(default=PassBounds(), alias="pass")
    companion: dict[str, Any] = Field(
        default_factory=dict,
        description="Settings of the app for this scenario, as in docs/reference/settings.md",
    )

    @property
    def place(self) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m AMSL) of the world's origin."""
        return USUAL_HOMES[self.autopilot] if self.home is None else self.home.place

    def built(self, seed: int) -> BuiltVehicle:
        """What was built, against what this file and the app's say: by `as_built`, under a seed."""
        return draw(self.as_built, seed)


def load_scenario(name: str | Path) -> Scenario:
    """Read a scenario by name (from configs/scenarios) or path.

    Raises:
        ConfigError: the file is missing, not YAML, or breaks a rule.
    """
    return load_model(Scenario, find_file("scenarios", name))


def load_airframe(name: str | Path) -> AirframeConfig:
    """Read an airframe by name (from configs/airframes) or path.

    Raises:
        ConfigError: the file is missing, not YAML, or breaks a rule.
    """
    return load_model(AirframeConfig, find_file("airframes", name))
