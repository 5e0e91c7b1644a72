"""Live samples: from the MPU9250 by the app's own driver, and from an autopilot over MAVLink.

Which of an autopilot's messages is heard is the app's own choice
(`companion.link.telemetry.autopilot_sensors`): RAW_IMU of ArduPilot, HIGHRES_IMU of PX4; both carry the
autopilot's own calibration, which its parameters tell and which is taken off again.
"""

from __future__ import annotations

import asyncio
import math
from typing import Final, Protocol

import numpy as np

from calibration.magnetometer.logs import HEARD, Telemetry
from calibration.magnetometer.recording import NAMES, MagnetometerRecording, paired
from companion.base.clock import Clock
from companion.base.geometry import FloatArray
from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError, ImuConfig
from companion.link.codec import Codec, heartbeat, mavlink
from companion.link.commands import ParameterRequest, ParameterRequests, set_message_interval
from companion.link.streams import TelemetryRates
from companion.link.telemetry.autopilot_sensors import IMU_MESSAGES
from companion.link.transport import Transport
from companion.sense.imu.i2c import RegisterBus, SensorError
from companion.sense.imu.mounting import mounting_matrix
from companion.sense.imu.mpu9250 import Mpu9250

BATCH_S: Final = 0.1
PATIENCE_S: Final = 8.0  # without a sample for so long there is something wrong
_RATE_HZ: Final = 50.0
_PLACE_RATE_HZ: Final = 1.0
_HEARTBEAT_S: Final = 1.0


class LiveCompass(Protocol):
    """A magnetometer that is being turned about."""

    body_from_sensor: FloatArray

    async def more(self) -> tuple[list[MagSample], list[ImuSample]]:
        """All samples so far, after some more have come.

        Raises:
            ConfigError: none come.
        """

    def recording(self) -> MagnetometerRecording:
        """All that has been measured."""


class Mpu9250Compass:
    """An MPU9250's magnetometer and accelerometer, uncalibrated, in the sensor's own axes."""

    def __init__(self, bus: RegisterBus, config: ImuConfig) -> None:
        unturned = config.model_copy(update={"body_from_sensor_deg": (0.0, 0.0, 0.0)})
        self.body_from_sensor = mounting_matrix(config.body_from_sensor_deg)
        self._driver = Mpu9250(bus, unturned)
        self._name = f"MPU9250 on {config.bus}"
        self._poll_s = 1.0 / config.poll_hz
        self._clock = Clock()
        self._heard_s = self._clock.now_s()
        self._mags: list[MagSample] = []
        self._imus: list[ImuSample] = []
        self._fault: str | None = None

    async def more(self) -> tuple[list[MagSample], list[ImuSample]]:
        end_s = self._clock.now_s() + BATCH_S
        while (now_s := self._clock.now_s()) < end_s:
            await self._poll()
            await self._clock.sleep_until(now_s + self._poll_s)
        if now_s - self._heard_s > PATIENCE_S:
            problem = self._driver.problem or self._fault or "no samples"
            raise ConfigError(f"{self._name}: {problem}; expected its magnetometer's samples")
        return self._mags, self._imus

    async def _poll(self) -> None:
        try:
            # a bus transaction blocks
            imus, mags = await self._clock.run(self._driver.poll, self._clock.now_s, modelled_s=0.0)
        except SensorError as error:
            # the driver sets the chip up anew
            self._fault = str(error)
            return
        if mags:
            self._heard_s = self._clock.now_s()
        self._mags += mags
        self._imus += imus

    def recording(self) -> MagnetometerRecording:
        raw, force = paired(self._mags, self._imus)
        turn = self.body_from_sensor
        return MagnetometerRecording(self._name, "mpu9250", raw, force=force, body_from_sensor=turn).checked()


class AutopilotCompass:
    """An autopilot's compass, as the app would hear it."""

    def __init__(self, transport: Transport, connection: str) -> None:
        self.body_from_sensor: FloatArray = np.eye(3)
        self._transport, self._connection = transport, connection
        self._clock = Clock()
        self._telemetry = Telemetry(connection)
        self._codec = Codec(1, wanted=HEARD)
        self._rates = TelemetryRates({})
        self._parameters = ParameterRequests()
        self._asked = False
        self._count = 0
        self._heard_s, self._beat_s = self._clock.now_s(), -math.inf
        self._reader = asyncio.create_task(self._read())

    def close(self) -> None:
        self._reader.cancel()

    async def more(self) -> tuple[list[MagSample], list[ImuSample]]:
        await asyncio.sleep(BATCH_S)
        now_s = self._clock.now_s()
        if self._reader.done() and (error := self._reader.exception()) is not None:
            raise ConfigError(f"{self._connection}: {error}") from error
        self._speak(now_s)
        mags, imus = self._telemetry.newest
        if len(mags) > self._count:
            self._count, self._heard_s = len(mags), now_s
        if now_s - self._heard_s > PATIENCE_S:
            heard = "no heartbeat" if not self._telemetry.system_id else "no magnetometer's samples"
            raise ConfigError(f"{self._connection}: {heard} for {PATIENCE_S:g} s; expected an autopilot's")
        return mags, imus

    async def _read(self) -> None:
        while True:
            for message in self._codec.decode(await self._transport.read()):
                self._telemetry.take(message)
                self._rates.heard(message.get_msgId())
                if message.get_msgId() == mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
                    self._parameters.heard(message, self._telemetry.autopilot_kind)

    def _speak(self, now_s: float) -> None:
        """Heartbeats, the rates that are wanted, and the compass's parameters."""
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self._transport.write(self._codec.encode(heartbeat()))
        autopilot_kind, system_id = self._telemetry.autopilot_kind, self._telemetry.system_id
        if autopilot_kind is None:
            return
        if not self._asked:
            self._asked = True
            place = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
            self._rates.want({IMU_MESSAGES[autopilot_kind][0]: _RATE_HZ, place: _PLACE_RATE_HZ})
            for name in NAMES[autopilot_kind]:
                self._parameters.submit(ParameterRequest(name))
        for message_id, rate_hz in self._rates.to_ask(now_s):
            ask = set_message_interval(message_id, rate_hz, system_id).message(0)
            self._transport.write(self._codec.encode(ask))
        for message in self._parameters.to_send(now_s, system_id):
            self._transport.write(self._codec.encode(message))

    def recording(self) -> MagnetometerRecording:
        return self._telemetry.recording().checked()
