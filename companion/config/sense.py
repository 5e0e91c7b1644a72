"""Settings of the sensors: buses, ports, rates and vision."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field, model_validator

from companion.config.reading import StrictModel, Vector


class ImuConfig(StrictModel):
    """MPU9250: its bus, ranges and rates.

    `bus` is "i2c:1", "spi:0.0", or "socket:PATH" / "spi-socket:PATH" for a simulated chip in another process,
    wired the one way or the other. `mag_path` is how its magnetometer is reached: by the chip's own I2C
    master, or past it, on our bus ("bypass"), which SPI cannot. `read` is how samples are taken: from the
    FIFO, or from the output registers when the chip says that there is a new one.

    `body_from_sensor_deg` (roll, pitch, yaw) turns sensor axes into body FRD. The default is a chip that
    lies face up with its x axis forward: z up and y left become z down and y right.
    """

    bus: str = "i2c:1"
    address: int = Field(default=0x68, ge=0x68, le=0x69)
    rate_hz: int = Field(default=200, ge=50, le=1000)
    poll_hz: int = Field(default=100, ge=20, le=500)
    read: Literal["fifo", "registers"] = "fifo"
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 500
    accel_range_g: Literal[2, 4, 8, 16] = 8
    filter_hz: Literal[184, 92, 41, 20] = 92
    mag_path: Literal["master", "bypass"] = "master"
    mag_rate_hz: Literal[8, 100] = 100
    body_from_sensor_deg: Vector = (180.0, 0.0, 0.0)
    magnetometer_calibration: str | None = None
    inertial_calibration: str | None = None

    @property
    def over_spi(self) -> bool:
        """Whether the chip is wired by SPI."""
        return self.bus.startswith("spi")

    @model_validator(mode="after")
    def _rates_fit_the_chip(self) -> ImuConfig:
        if 1000 % self.rate_hz:
            raise ValueError(f"rate_hz {self.rate_hz}: expected a divisor of 1000")
        # the FIFO holds 36 samples: let one poll be skipped without a loss
        if self.read == "fifo" and 2 * self.rate_hz > 36 * self.poll_hz:
            raise ValueError(
                f"poll_hz {self.poll_hz}: expected at least {-(-self.rate_hz // 18)} for rate_hz"
            )
        if self.read == "registers" and self.poll_hz < self.rate_hz:
            raise ValueError(
                f"poll_hz {self.poll_hz}: expected at least {self.rate_hz} (rate_hz) when read is registers, "
                "which hold one sample"
            )
        return self

    @model_validator(mode="after")
    def _magnetometer_can_be_reached(self) -> ImuConfig:
        if self.over_spi and self.mag_path == "bypass":
            raise ValueError("mag_path bypass: expected master on SPI, which has no way past the chip")
        return self


class GpsConfig(StrictModel):
    """NEO-6M on a serial port.

    It may talk at any rate when we come: it is found, and then set to `baud`. `latency_s` is from the
    instant a fix is valid to the first bit of its first message, at the quickest.
    """

    port: str = "/dev/ttyAMA0"
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 38400
    rate_hz: int = Field(default=5, ge=1, le=5)
    latency_s: float = Field(default=0.12, ge=0.0, le=0.5)
    maximum_hdop: float = Field(default=6.0, ge=1.0, le=50.0)
    antenna_position_body_m: Vector = (0.0, 0.0, -0.05)


class RangeConfig(StrictModel):
    """Downward ultrasonic.

    `kind`: "frames" for a serial port on which it talks by itself (JSN-SR04T in serial mode, A02YYUW or
    alike: 4-byte frames); "polled" for one on which it answers (US-100: 2 bytes); "gpio" for a trigger and an
    echo pin (HC-SR04, JSN-SR04T in mode 0), numbered as Broadcom does. `rate_hz` is how often the latter two
    are asked; `air_temperature_c` gives the speed of sound where we are the ones that reckon with it (gpio).
    """

    kind: Literal["frames", "polled", "gpio"] = "frames"
    port: str = "/dev/ttyAMA1"
    trigger_pin: int = Field(default=23, ge=0, le=27)
    echo_pin: int = Field(default=24, ge=0, le=27)
    rate_hz: float = Field(default=12.5, ge=2.0, le=16.0)
    air_temperature_c: float = Field(default=20.0, ge=-30.0, le=50.0)
    minimum_m: float = Field(default=0.03, ge=0.02, le=0.5)
    maximum_m: float = Field(default=4.5, ge=0.5, le=10.0)
    maximum_speed_m_s: float = Field(default=3.0, ge=0.5, le=20.0)

    @model_validator(mode="after")
    def _pins_differ(self) -> RangeConfig:
        if self.trigger_pin == self.echo_pin:
            raise ValueError(f"echo_pin {self.echo_pin}: expected another than trigger_pin")
        return self

    @model_validator(mode="after")
    def _measures_something(self) -> RangeConfig:
        if self.minimum_m >= self.maximum_m:
            raise ValueError(f"maximum_m {self.maximum_m:g}: expected more than minimum_m")
        return self


class AutopilotSensorsConfig(StrictModel):
    """The autopilot's own sensors, by its telemetry: what is asked of it, and how old its stamps make them.

    Axes are the autopilot's body axes (FRD): the mounting rotations are its own parameters. The antenna's
    place stays `sense.gps.antenna_position_body_m`, the rangefinder's stays in the vehicle's file, and
    `sense.range` still bounds what is believed.
    """

    imu_rate_hz: float = Field(default=200.0, ge=50.0, le=400.0)  # asked for; what comes counts
    imu_latency_s: float | None = Field(
        default=None, ge=0.0, le=0.1
    )  # age of a sample at its stamp, by the autopilot's filters; none: 0.004 for PX4, 0.011 for ArduPilot
    gps_rate_hz: float = Field(default=5.0, ge=1.0, le=20.0)  # asked for
    gps_latency_s: float = Field(default=0.12, ge=0.0, le=0.5)  # age of a fix at its stamp
    range_source: Literal["autopilot", "boards"] = "autopilot"  # boards: our ultrasonic all the same
    range_rate_hz: float = Field(default=20.0, ge=1.0, le=100.0)  # asked for
    magnetometer_calibration: str | None = (
        None  # file of `calibrate-magnetometer`, on top of the autopilot's own calibration; none: as it comes
    )


# roads and loading areas slope by a few degrees; a deck that rolls by 15 deg from side to side tilts up to 13
_TILT_STD_DEG: Final = {"fixed": 0.0, "vehicle": 3.0, "ship": 6.0}


class VisionConfig(StrictModel):
    """Marker detection and pose."""

    source: str = "v4l2:0"  # or picamera2:N, video:FILE, images:FOLDER, socket:PATH, tcp:HOST:PORT
    unstamped_latency_s: float = Field(
        default=0.045, ge=0.0, le=0.5
    )  # age, when it comes, of another process's frame that does not say when it was exposed
    pose: Literal["joint", "paper"] = "joint"
    minimum_side_px: float = Field(default=12.0, ge=8.0, le=100.0)  # smaller markers are not looked for
    maximum_markers: int = Field(default=8, ge=1, le=100)  # refined and used in one frame
    corner_noise_px: float = Field(default=0.005, gt=0.0, le=5.0)
    scale_error: float = Field(
        default=0.003, ge=0.0, le=0.1
    )  # of the calibration, as a share of the distance
    pad_on: Literal["fixed", "vehicle", "ship"] = "fixed"  # how far the pad may tilt
    level_std_deg: float = Field(default=2.0, gt=0.0, le=30.0)  # of a fixed pad and our attitude together
    relative_speed_std_m_s: float = Field(default=0.5, gt=0.0, le=20.0)  # for a rolling shutter's shear
    relative_climb_std_m_s: float = Field(default=0.2, gt=0.0, le=20.0)  # near the pad, for the same
    turn_rate_std_rad_s: float = Field(default=0.1, gt=0.0, le=10.0)
    vibration_mrad: float = Field(default=0.035, gt=0.0, le=10.0)

    @property
    def tilt_std_deg(self) -> float:
        """Standard deviation of the pad's tilt against our horizon."""
        return max(self.level_std_deg, _TILT_STD_DEG[self.pad_on])


class SenseConfig(StrictModel):
    """All sensors. `boards` are our own: MPU9250, NEO-6M and ultrasonic; the camera is always ours."""

    source: Literal["boards", "autopilot"] = "boards"  # of IMU, magnetometer, GPS and range
    autopilot: AutopilotSensorsConfig = AutopilotSensorsConfig()
    imu: ImuConfig = ImuConfig()
    gps: GpsConfig = GpsConfig()
    range: RangeConfig = RangeConfig()
    vision: VisionConfig = VisionConfig()

    @property
    def range_by_telemetry(self) -> bool:
        """Whether the range comes from the autopilot."""
        return self.source == "autopilot" and self.autopilot.range_source == "autopilot"
