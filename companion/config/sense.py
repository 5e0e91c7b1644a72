"""Settings of the sensors: buses, ports, rates and vision."""

from __future__ import annotations

import re
from typing import Final, Literal

from pydantic import Field, field_serializer, model_validator

from companion.config.reading import OPERATOR, StrictModel, Vector

# of a URL, the password (which may hold an @) and all that is asked of a camera after the path
_PASSWORD: Final = re.compile(r"(?<=://)([^\s:/]*):\S*(?=@)")
_ASKED: Final = re.compile(r"(?<=\w)\?\S+")


def without_password(source: str) -> str:
    """A source as it may be shown and recorded: without the password of a URL."""
    return _ASKED.sub("?***", _PASSWORD.sub(r"\1:***", source)) if "://" in source else source


class ImuConfig(StrictModel):
    """MPU9250: its bus, ranges and rates. The default is a chip face up, x forward: its z up and y left."""

    bus: str = Field(default="i2c:1", json_schema_extra=OPERATOR)
    """`i2c:N` for /dev/i2c-N; `spi:B.C` for /dev/spidevB.C; `socket:PATH` or `spi-socket:PATH` for a
    simulator in another process; set it as wired"""
    address: int = Field(default=0x68, ge=0x68, le=0x69, json_schema_extra=OPERATOR)
    """I²C address: 0x68 (104), or 0x69 (105) with AD0 high; set it to the board's"""
    rate_hz: int = Field(default=200, ge=50, le=1000)
    """Sample rate of gyroscope and accelerometer; a divisor of 1000; lower it for a slow bus or computer"""
    poll_hz: int = Field(default=50, ge=20, le=500)
    """How often the chip is read, magnetometer included; its FIFO holds 36 samples; raise it for a faster
    `rate_hz`, lower it to save CPU"""
    read: Literal["fifo", "registers"] = Field(default="fifo")
    """Read samples from the FIFO, or from the output registers as soon as they hold a new sample; change it
    only for a chip whose FIFO does not work"""
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = Field(default=500)
    """Full scale of the gyroscope; raise it only if it saturates in flight"""
    accel_range_g: Literal[2, 4, 8, 16] = Field(default=8)
    """Full scale of the accelerometer; raise it if vibration makes it clip"""
    filter_hz: Literal[184, 92, 41, 20] = Field(default=92)
    """The chip's digital low-pass filter; lower it against vibration, at the price of delay"""
    mag_path: Literal["master", "bypass"] = Field(default="master")
    """How the magnetometer is read: through the chip's own I2C master, or directly on the bus (not on SPI);
    change it for chips whose master does not work"""
    mag_rate_hz: Literal[8, 100] = Field(default=100)
    """Magnetometer rate; lower it on a slow bus"""
    body_from_sensor_deg: Vector = Field(default=(180.0, 0.0, 0.0), json_schema_extra=OPERATOR)
    """Roll, pitch, yaw that turn the chip's axes into the body's (FRD); [180, 0, 0] lies face up, x forward.
    Set it to how the chip is mounted"""
    magnetometer_calibration: str | None = Field(default=None, json_schema_extra=OPERATOR)
    """File that `calibrate-magnetometer` (docs/how-to/calibrate-magnetometer.md) wrote for this chip; none:
    readings are used uncalibrated; set it once you have calibrated"""
    inertial_calibration: str | None = Field(default=None, json_schema_extra=OPERATOR)
    """File of `calibrate-mount accelerometer` or `gyro`; none: readings are used uncalibrated; set it once
    you have calibrated"""

    @property
    def over_spi(self) -> bool:
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
    """NEO-6M on a serial port: its rate is found, and then set to `baud`."""

    port: str = Field(default="/dev/ttyAMA0", json_schema_extra=OPERATOR)
    """Serial port of the NEO-6M; set it as wired"""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = Field(default=38400)
    """Baud rate to set; the receiver's present rate is found first. Lower it only on a line that loses
    bytes"""
    rate_hz: int = Field(default=5, ge=1, le=5)
    """Requested fixes per second; lower it for a receiver or line that cannot keep it"""
    latency_s: float = Field(default=0.12, ge=0.0, le=0.5)
    """Shortest time from the moment for which a fix is valid to the first bit of its first message; set it
    for another receiver"""
    maximum_hdop: float = Field(default=6.0, ge=1.0, le=50.0)
    """A fix with a larger horizontal dilution of precision is refused; lower it among buildings, where such
    fixes are wrong; raise it if the app never gets a fix"""
    antenna_position_body_m: Vector = Field(default=(0.0, 0.0, -0.05), json_schema_extra=OPERATOR)
    """Position of the antenna from the centre of mass, FRD; measure it on your vehicle"""


# Data sheets: they report whatever is nearer than this as about this. A JSN-SR04T's is "20 cm" to "25 cm".
_FLOORS_M: Final = {"A02YYUW": 0.03, "JSN-SR04T": 0.25, "US-100": 0.03, "HC-SR04": 0.03}


class RangeConfig(StrictModel):
    """Downward ultrasonic: a JSN-SR04T or A02YYUW (`frames`), a US-100 (`polled`), an HC-SR04 (`gpio`)."""

    sensor: Literal["A02YYUW", "JSN-SR04T", "US-100", "HC-SR04"] = Field(
        default="A02YYUW", json_schema_extra=OPERATOR
    )
    """The rangefinder's model, for the least distance that it measures: 0.25 m for a JSN-SR04T, else 0.03;
    set it to the sensor that is mounted, the nearest one in that for another"""
    kind: Literal["frames", "polled", "gpio"] = Field(default="frames", json_schema_extra=OPERATOR)
    """`frames`: a serial port with 4-byte frames; `polled`: a US-100, polled over a serial port; `gpio`:
    trigger and echo pins; set it to the sensor that is mounted"""
    port: str = Field(default="/dev/ttyAMA1", json_schema_extra=OPERATOR)
    """Serial port of the rangefinder (frames, polled); set it as wired"""
    trigger_pin: int = Field(default=23, ge=0, le=27, json_schema_extra=OPERATOR)
    """Trigger pin, Broadcom number (gpio); set it as wired"""
    echo_pin: int = Field(default=24, ge=0, le=27, json_schema_extra=OPERATOR)
    """Echo pin, Broadcom number, behind a divider to 3.3 V (gpio); set it as wired"""
    rate_hz: float = Field(default=12.5, ge=2.0, le=16.0)
    """Polling rate (polled, gpio); lower it if the echo of one pulse arrives after the next pulse"""
    air_temperature_c: float = Field(default=20.0, ge=-30.0, le=50.0)
    """Air temperature, for the speed of sound (gpio); an error of 10 °C makes the height wrong by nearly 2
    %. Set it to the day's temperature"""
    minimum_m: float | None = Field(default=None, ge=0.02, le=0.5)
    """This distance and shorter ones are not used: a sensor that reports them tells only that something is
    nearer; none: the sensor's least distance. Raise it if legs give false ones"""
    maximum_m: float = Field(default=4.5, ge=0.5, le=10.0)
    """Longer distances are refused; set it to the sensor's range"""
    maximum_speed_m_s: float = Field(default=3.0, ge=0.5, le=20.0)
    """A distance that changes faster counts as a spike unless the next one confirms it; raise it for a pad
    that moves up and down faster than this"""

    @model_validator(mode="after")
    def _pins_differ(self) -> RangeConfig:
        if self.trigger_pin == self.echo_pin:
            raise ValueError(f"echo_pin {self.echo_pin}: expected another than trigger_pin")
        return self

    @model_validator(mode="after")
    def _measures_something(self) -> RangeConfig:
        if self.floor_m >= self.maximum_m:
            raise ValueError(f"maximum_m {self.maximum_m:g}: expected more than minimum_m")
        return self

    @property
    def floor_m(self) -> float:
        """Up to where a reported distance tells only that something is nearer."""
        return _FLOORS_M[self.sensor] if self.minimum_m is None else self.minimum_m

    def measures(self, distance_m: float) -> bool:
        """Whether a reported distance is one."""
        return self.floor_m < distance_m <= self.maximum_m


class AutopilotSensorsConfig(StrictModel):
    """The autopilot's own sensors, by its telemetry: what is asked of it, and how old its stamps make them.

    Axes are the autopilot's body axes (FRD): the mounting rotations are its own parameters. The antenna's
    place stays `sense.gps.antenna_position_body_m`, the rangefinder's stays in the vehicle's file, and
    `sense.range` still bounds what is believed.
    """

    imu_rate_hz: float = Field(default=200.0, ge=50.0, le=400.0)
    """Requested IMU rate, at least 50; lower it on a slow serial line"""
    imu_latency_s: float | None = Field(default=None, ge=0.0, le=0.1)
    """Age of an IMU sample at its stamp, from the autopilot's filters; none: 0.004 for PX4, 0.011 for
    ArduPilot. Set it when you changed those filters"""
    gps_rate_hz: float = Field(default=5.0, ge=1.0, le=20.0)
    """Requested GPS rate; lower it on a slow serial line"""
    gps_latency_s: float = Field(default=0.12, ge=0.0, le=0.5)
    """Age of a GPS fix at its stamp; raise it for a slow receiver"""
    range_source: Literal["autopilot", "boards"] = Field(default="autopilot", json_schema_extra=OPERATOR)
    """`autopilot`: its rangefinder; `boards`: the rangefinder on the companion computer; change it if the
    autopilot has no rangefinder"""
    range_rate_hz: float = Field(default=20.0, ge=1.0, le=100.0)
    """Requested rangefinder rate; lower it on a slow serial line"""
    magnetometer_calibration: str | None = Field(default=None, json_schema_extra=OPERATOR)
    """File of `calibrate-magnetometer` (docs/how-to/calibrate-magnetometer.md), applied on top of the
    autopilot's own calibration; none: readings are used as received; set it if the heading is wrong with
    the autopilot's own calibration"""


# roads and loading areas slope by a few degrees; a deck that rolls by 15 deg from side to side tilts up to 13
_TILT_STD_DEG: Final = {"fixed": 0.0, "vehicle": 3.0, "ship": 6.0}


class VisionConfig(StrictModel):
    """Marker detection and pose."""

    source: str = Field(default="v4l2:0", json_schema_extra=OPERATOR)
    """The camera (docs/how-to/cameras.md): `v4l2:N` for /dev/videoN, `v4l2:/dev/v4l/by-id/NAME` for one whose
    number changes, `picamera2:N` for a Raspberry Pi's, `rtsp://...` or `http://...` for one on the network,
    `gstreamer:PIPELINE`, `video:FILE` or `images:FOLDER` for a recording; `socket:PATH` or `tcp:HOST:PORT`
    for frames from another process (docs/reference/camera-frames.md); set it to the camera that is mounted"""
    unstamped_latency_s: float = Field(default=0.045, ge=0.0, le=0.5)
    """Assumed age on arrival of a frame without a time stamp (from a network camera, or from another
    process without a clock); set it to the measured value (docs/how-to/cameras.md)"""
    pose: Literal["joint", "paper"] = Field(default="joint")
    """`joint`: one fit to all corners; `paper`: the mean of single-marker poses (eq. 1). Change it for
    comparison only"""
    minimum_side_px: float = Field(default=12.0, ge=8.0, le=100.0)
    """Smaller markers are not searched; raise it to save CPU"""
    maximum_markers: int = Field(default=8, ge=1, le=100)
    """Largest number of markers refined and used in one frame; lower it to save CPU"""
    corner_noise_px: float = Field(default=0.005, gt=0.0, le=5.0)
    """Noise of a corner, each axis, in addition to the scatter of its marker's sides; raise it for a
    blurred lens or a creased print"""
    scale_error: float = Field(default=0.003, ge=0.0, le=0.1)
    """Calibration error as a share of the distance; raise it for a poor calibration"""
    pad_on: Literal["fixed", "vehicle", "ship"] = Field(default="fixed", json_schema_extra=OPERATOR)
    """What the pad lies on: the ground (`fixed`), a car or a trailer (`vehicle`, tilts by 3° standard
    deviation) or a ship (`ship`, by 6°); set it to yours. A pad tilted by more than four standard
    deviations is refused"""
    level_std_deg: float = Field(default=2.0, gt=0.0, le=30.0)
    """Standard deviation of pad tilt and horizon error together; raise it for a pad that is not level"""
    relative_speed_std_m_s: float = Field(default=0.5, gt=0.0, le=20.0)
    """Plausible speed over the pad, for the rolling-shutter correction; raise it for pads faster than this"""
    relative_climb_std_m_s: float = Field(default=0.2, gt=0.0, le=20.0)
    """Plausible speed towards the pad, for the rolling shutter; a fifth of the distance per second is added;
    raise it with the speed over the pad"""
    turn_rate_std_rad_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """Plausible turn rate beyond the gyroscope's, for the rolling shutter; raise it for a faster turn"""
    vibration_mrad: float = Field(default=0.035, gt=0.0, le=10.0)
    """Rotor vibration of the camera within a frame, rms; raise it for a badly damped mount"""

    @field_serializer("source", when_used="json")
    def _to_be_recorded(self, source: str) -> str:
        return without_password(source)

    @property
    def shown_source(self) -> str:
        """The source as messages have it."""
        return without_password(self.source)

    @property
    def tilt_std_deg(self) -> float:
        """Standard deviation of the pad's tilt against our horizon."""
        return max(self.level_std_deg, _TILT_STD_DEG[self.pad_on])


class SenseConfig(StrictModel):
    """All sensors. `boards` are our own: MPU9250, NEO-6M and ultrasonic; the camera is always ours."""

    source: Literal["boards", "autopilot"] = Field(default="boards", json_schema_extra=OPERATOR)
    """Source of IMU, magnetometer, GPS and range: `boards` on the companion computer, or `autopilot` by
    telemetry (docs/how-to/telemetry-sensors.md); set it to `autopilot` if the companion computer has no
    sensors"""
    autopilot: AutopilotSensorsConfig = AutopilotSensorsConfig()
    imu: ImuConfig = ImuConfig()
    gps: GpsConfig = GpsConfig()
    range: RangeConfig = RangeConfig()
    vision: VisionConfig = VisionConfig()

    @property
    def range_by_telemetry(self) -> bool:
        return self.source == "autopilot" and self.autopilot.range_source == "autopilot"
