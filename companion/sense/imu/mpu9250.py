"""The MPU9250's driver: registers to rates, specific forces and magnetic field in body axes.

Accelerometer, temperature and gyroscope come through the FIFO, so that no sample is lost between polls, or
from the output registers (`ImuConfig.read`); the magnetometer through the chip or past it (`mag_path`, see
`ak8963_path`). The same over I2C and SPI. Registers: RM-MPU-9250A-00 rev. 1.6; scales: PS-MPU-9250A-01
rev. 1.1. Sensor axes: right-handed, z out of the chip's top, turned into FRD by
`ImuConfig.body_from_sensor_deg`. The driver never sleeps: waits of the bring-up pass between polls.

Faults cost as little as they can: a bus transaction that fails is made up for by the next poll (the FIFO
holds the samples), a magnetometer that fails costs magnetometer samples alone, and only what lasts has the
chip set up anew.
"""

import math
import struct
from collections.abc import Callable
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, Vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import ImuConfig
from companion.config.magnetometer import MagnetometerCalibration
from companion.config.mounting import InertialCalibration
from companion.sense.imu.ak8963 import Ak8963, BringUp
from companion.sense.imu.ak8963_path import BypassPath, MasterPath, Waits
from companion.sense.imu.fifo import (
    FIFO_ENABLE,
    FIFO_OVERFLOW,
    FRAME_BYTES,
    SMPLRT_DIV,
    USER_CTRL,
    Fifo,
    OutputRegisters,
    SamplesLostError,
)
from companion.sense.imu.i2c import RegisterBus, SensorError
from companion.sense.imu.mounting import BodyAxes, body_axes
from companion.sense.imu.sample_clock import SampleClock

IDENTITIES: Final = {0x71: "MPU9250", 0x73: "MPU9255"}

# filter_hz -> DLPF_CFG and the gyroscope's delay (s), register map table of CONFIG. The accelerometer's
# delay differs from it by about 1 ms, less than matters to one time stamp for both.
_FILTER: Final = {184: (1, 0.0029), 92: (2, 0.0039), 41: (3, 0.0059), 20: (4, 0.0099)}
_GYRO_RANGE: Final = {250: 0, 500: 1, 1000: 2, 2000: 3}
_ACCEL_RANGE: Final = {2: 0, 4: 1, 8: 2, 16: 3}

_FIFO_EN, _I2C_MST_CTRL, _INT_PIN_CFG = 0x23, 0x24, 0x37
_PWR_MGMT_1, _PWR_MGMT_2 = 0x6B, 0x6C
WHO_AM_I: Final = 0x75

_RESET: Final = 0x80
_CLOCK_PLL: Final = 0x01
_FIFO_STOPS_WHEN_FULL: Final = 0x40
_FIFO_ACCEL_TEMP_GYRO: Final = 0xF8
_BYPASS: Final = 0x02
# USER_CTRL
_USER_MASTER: Final = 0x20
_I2C_OFF: Final = 0x10  # on SPI, or what passes on the lines may be taken for I2C
# stop between reads, 400 kHz; not waiting for the external data: a dead magnetometer holds nothing up
_MASTER_400_KHZ: Final = 0x1D

# The flag is set whether or not it is enabled on most chips; enabled it is on all. The pin is not used.
_INT_ENABLE: Final = 0x38
_COUNTS_PER_DEG_C: Final = 333.87
# A chip's temperature follows its surroundings over seconds. From one sample to the next a jump like this is
# a word that is no temperature: the frames are shifted.
_MOST_TEMPERATURE_STEP_C: Final = 5.0
_SILENT_S: Final = 0.25
_STUCK_S: Final = 0.5
_REPEATED_S: Final = 0.05  # and what repeats for longer than this is not handed on: it says nothing new
_RANGE_ENDS: Final = (-32768, 32767)  # counts; what lies beyond reads as these
_BUS_PATIENCE_POLLS: Final = 5  # so many polls may fail in a row: 100 ms at 50 Hz, of the FIFO's 180 ms
# centre of an AK8963 measurement (7.2 ms long) before its end, and the mean wait until it is copied
_MAG_MEASUREMENT_S: Final = 0.0036


class Mpu9250:
    """One MPU9250 on a register bus. Poll it at `config.poll_hz`.

    Calibrations are in the chip's own axes; None leaves its readings as they come.
    """

    def __init__(
        self,
        bus: RegisterBus,
        config: ImuConfig,
        magnetometer: MagnetometerCalibration | None = None,
        inertial: InertialCalibration | None = None,
    ) -> None:
        self._bus = bus
        self._address = config.address
        self._name = f"MPU9250 at 0x{config.address:02x}"
        self._config = config
        self._user_control = _user_control(config)
        self._mag = self._make_magnetometer()
        self._settings = _settings(config)
        self._samples: Fifo | OutputRegisters = Fifo(bus, config.address, self._user_control)
        if config.read == "registers":
            self._samples = OutputRegisters(bus, config.address, self._user_control, self._settings)
        self._clock = SampleClock(1.0 / config.rate_hz)
        self._delay_s = _FILTER[config.filter_hz][1]
        self._gyro, self._accel, self._field = _to_body(config, magnetometer, inertial)
        self._bring_up: BringUp | None = None
        self._ready = False
        self._failed_polls = 0
        self._last_sample_s = self._within_range_s = -math.inf
        self._last_frame = b""
        self._same_frames = 0
        self._last_temperature: int | None = None

    def _make_magnetometer(self) -> Ak8963:
        if self._config.mag_path == "bypass":
            return Ak8963(BypassPath(self._bus), self._config.mag_rate_hz)
        # while the FIFO fills, a restart of the master must not stop it
        filling = FIFO_ENABLE if self._config.read == "fifo" else 0
        path = MasterPath(self._bus, self._address, self._user_control | filling)
        return Ak8963(path, self._config.mag_rate_hz)

    @property
    def ready(self) -> bool:
        """Whether the bring-up is through and inertial samples flow."""
        return self._ready

    @property
    def problem(self) -> str | None:
        """What is wrong beside flowing samples, in one line: the magnetometer's fault."""
        return None if self._mag.problem is None else f"{self._name}: {self._mag.problem}"

    def configure(self) -> None:
        """Check the chip's identity and have the polls that follow set it up from a reset.

        Raises:
            SensorError: no answer, or another chip.
        """
        try:
            self._check_identity()
        except (OSError, SensorError) as error:
            raise self._failed(error) from error
        self._begin_bring_up()

    def poll(self, now: Callable[[], float]) -> tuple[list[ImuSample], list[MagSample]]:
        """All samples since the last poll, oldest first, stamped with when they were measured.

        A saturated sample is passed on for 50 ms at most, and not at all if all six axes are. Empty while the
        chip is being set up (about 0.2 s after `configure` or a fault), and when a bus transaction has failed
        that the next poll makes up for. The magnetometer follows some 0.3 s later, or never: see `problem`.

        Args:
            now: tells the time (s). It is asked here, on whatever thread this runs, at the moment that the
                samples' times hang on.

        Raises:
            SamplesLostError: the FIFO was full or out of step and has been emptied; sampling goes on.
            SensorError: the bus fails again and again, silence, stuck data, or saturation for 0.25 s; the
                next poll begins to set the chip up anew.
        """
        try:
            if self._ready:
                samples = self._drain(now)
                self._failed_polls = 0
                return samples
            self._continue_bring_up(now())
        except SamplesLostError as error:
            self._clock.restart()
            raise SamplesLostError(f"{self._name}: {error}") from error
        except OSError as error:
            self._failed_polls += 1
            if not self._ready or self._failed_polls > _BUS_PATIENCE_POLLS:
                raise self._failed(error) from error
        except SensorError as error:
            raise self._failed(error) from error
        return [], []

    # ------------------------------------------------------------ bring-up

    def _begin_bring_up(self) -> None:
        self._bring_up = BringUp(self._steps())
        self._ready = False

    def _failed(self, error: Exception) -> SensorError:
        self._bring_up = None
        self._ready = False
        reason = error.strerror or str(error) if isinstance(error, OSError) else str(error)
        return SensorError(f"{self._name}: {reason}")

    def _continue_bring_up(self, now_s: float) -> None:
        if self._bring_up is None:
            self._begin_bring_up()
        assert self._bring_up is not None
        if self._bring_up.advance(now_s):
            self._ready = True
            self._failed_polls = 0
            self._last_sample_s = self._within_range_s = now_s

    def _check_identity(self) -> None:
        identity = self._read(WHO_AM_I, 1)[0]
        if identity not in IDENTITIES:
            raise SensorError(f"identity 0x{identity:02x}, expected 0x71 (MPU9250) or 0x73 (MPU9255)")

    def _steps(self) -> Waits:
        self._check_identity()
        self._write(_PWR_MGMT_1, _RESET)
        yield 0.1
        self._write(_PWR_MGMT_1, _CLOCK_PLL)
        self._write(_PWR_MGMT_2, 0x00)
        yield 0.05
        self._write(USER_CTRL, self._user_control)
        self._write_settings()
        self._write(_INT_PIN_CFG, _BYPASS if self._config.mag_path == "bypass" else 0x00)
        self._write(_I2C_MST_CTRL, _MASTER_400_KHZ)
        self._write(_INT_ENABLE, FIFO_OVERFLOW if self._config.read == "fifo" else 0x00)
        self._write(_FIFO_EN, _FIFO_ACCEL_TEMP_GYRO if self._config.read == "fifo" else 0x00)
        self._samples.reset()
        self._clock.restart()
        self._mag.restart()
        self._last_temperature = None

    def _write_settings(self) -> None:
        for offset, value in enumerate(self._settings):
            self._write(SMPLRT_DIV + offset, value)
        taken = self._read(SMPLRT_DIV, len(self._settings))
        if taken != self._settings:
            raise SensorError(f"settings not taken: wrote {self._settings.hex()}, read {taken.hex()}")

    # ------------------------------------------------------------ samples

    def _drain(self, now: Callable[[], float]) -> tuple[list[ImuSample], list[MagSample]]:
        now_s = now()
        try:
            frames = self._samples.waiting()
        except SamplesLostError:
            self._last_sample_s = self._within_range_s = now_s
            raise
        if not frames and now_s - self._last_sample_s > _SILENT_S:
            raise SensorError(f"no sample for {now_s - self._last_sample_s:.2f} s")
        imu_samples = self._read_imu(now_s, frames) if frames else []
        decoded = self._mag.poll(now_s, copied=frames > 0)
        return imu_samples, [] if decoded is None else [self._mag_sample(now_s, *decoded)]

    def _read_imu(self, now_s: float, waiting: int) -> list[ImuSample]:
        data = self._samples.read(waiting)
        frames = len(data) // FRAME_BYTES
        self._check_alive(data, frames)
        self._last_sample_s = now_s
        words = struct.unpack(f">{7 * frames}h", data)
        self._check_in_step(words[3::7])
        # what a bus fault has left in the FIFO is newer than what was read
        read_s = now_s - (waiting - frames) * self._clock.period_s
        if self._config.read == "fifo":
            times = self._clock.stamp(read_s, frames)
        else:
            times = [self._clock.stamp_newest(read_s)]
        saturated = [_saturated(words, 7 * k) for k in range(len(times))]
        if 0 in saturated:
            self._within_range_s = now_s
        lasts_s = now_s - self._within_range_s
        if lasts_s > _SILENT_S:
            raise SensorError(f"saturated for {lasts_s:.2f} s")
        if self._same_frames > _REPEATED_S * self._config.rate_hz:
            return []
        # in a shock the end of the range is nearest to the truth; all axes at once, or for long, are a fault
        most = 0 if lasts_s > _REPEATED_S else 5
        return [self._sample(t, words, 7 * k) for k, t in enumerate(times) if saturated[k] <= most]

    def _check_alive(self, data: bytes, frames: int) -> None:
        newest = data[-FRAME_BYTES:]
        # a live sensor's noise spans many steps: the same 14 bytes again and again are a dead one's
        if newest != self._last_frame or data != newest * frames:
            self._same_frames = 0
            self._last_frame = newest
            return
        self._same_frames += frames
        if self._same_frames > _STUCK_S * self._config.rate_hz:
            # set up anew it begins with the same, as often as not
            self._same_frames = 1 + math.ceil(_REPEATED_S * self._config.rate_hz)
            raise SensorError(f"stuck: the same sample for {_STUCK_S} s")

    def _check_in_step(self, temperatures: tuple[int, ...]) -> None:
        """Whether the word that is the temperature behaves like one.

        Raises:
            SamplesLostError: it does not; the frames have been thrown away.
        """
        before = temperatures[0] if self._last_temperature is None else self._last_temperature
        self._last_temperature = temperatures[-1]
        step = max(abs(b - a) for a, b in zip((before, *temperatures), temperatures, strict=False))
        if step > _MOST_TEMPERATURE_STEP_C * _COUNTS_PER_DEG_C:
            self._last_temperature = None
            self._samples.reset()
            degrees = step / _COUNTS_PER_DEG_C
            raise SamplesLostError(f"out of step, the temperature jumps by {degrees:.0f} °C, samples lost")

    def _sample(self, time_s: float, words: tuple[int, ...], at: int) -> ImuSample:
        ax, ay, az, temperature, gx, gy, gz = words[at : at + 7]
        return ImuSample(
            time_s - self._delay_s,
            self._gyro.of(gx, gy, gz),
            self._accel.of(ax, ay, az),
            temperature / _COUNTS_PER_DEG_C + 21.0,
        )

    def _mag_sample(self, now_s: float, field_ut: Vector3, newest: bool) -> MagSample:
        if self._config.mag_path == "bypass":
            # it came at any time since the last poll, or the measurement before
            age_s = 0.5 / max(self._config.poll_hz, self._config.mag_rate_hz)
        else:
            # copied at the newest sample, or at the one before; measured up to one sample earlier than that
            age_s = (1.0 if newest else 2.0) * self._clock.period_s
        time_s = now_s - age_s - _MAG_MEASUREMENT_S
        return MagSample(time_s, self._field.of(*field_ut))

    # ------------------------------------------------------------ bus

    def _read(self, register: int, length: int) -> bytes:
        return self._bus.read(self._address, register, length)

    def _write(self, register: int, value: int) -> None:
        self._bus.write(self._address, register, value)


def _to_body(
    config: ImuConfig, magnetometer: MagnetometerCalibration | None, inertial: InertialCalibration | None
) -> tuple[BodyAxes, BodyAxes, BodyAxes]:
    """From counts of gyroscope and accelerometer, and from the magnetometer's µT, to the body's axes."""
    mounting = config.body_from_sensor_deg
    gyro = body_axes(mounting, math.radians(config.gyro_range_deg_s) / 32768.0)
    accel = body_axes(mounting, config.accel_range_g * GRAVITY_M_S2 / 32768.0)
    field = body_axes(mounting, 1.0)
    if magnetometer is not None:
        field = field.corrected(magnetometer.soft_iron, magnetometer.hard_iron)
    if inertial is not None:
        gyro = gyro.corrected(None, inertial.gyro.bias_rad_s)
        if (found := inertial.accelerometer) is not None:
            accel = accel.corrected(found.matrix, found.offset_m_s2)
    return gyro, accel, field


def _saturated(words: tuple[int, ...], at: int) -> int:
    """How many of the six axes of the frame that begins at this word lie at an end of their range."""
    return sum(word in _RANGE_ENDS for word in (*words[at : at + 3], *words[at + 4 : at + 7]))


def _user_control(config: ImuConfig) -> int:
    """USER_CTRL without the FIFO's bits."""
    return (_I2C_OFF if config.over_spi else 0) | (_USER_MASTER if config.mag_path == "master" else 0)


def _settings(config: ImuConfig) -> bytes:
    """SMPLRT_DIV and the registers after it: CONFIG, GYRO_CONFIG, ACCEL_CONFIG and ACCEL_CONFIG2."""
    dlpf = _FILTER[config.filter_hz][0]
    return bytes(
        (
            1000 // config.rate_hz - 1,
            _FIFO_STOPS_WHEN_FULL | dlpf,
            _GYRO_RANGE[config.gyro_range_deg_s] << 3,
            _ACCEL_RANGE[config.accel_range_g] << 3,
            dlpf,
        )
    )
