"""What fails in flight, and when: faults as data of a scenario.

A fault works on what a sensor feels, on its chip, on its line or on a frame's way (`sitl.breaking`), never on
anything the app computes. Times count from the start of the simulation (s), axes are the body's (FRD).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from companion.config import StrictModel

Component = Annotated[float, Field(ge=-1000.0, le=1000.0)]
BodyVector = tuple[Component, Component, Component]


class FaultTimes(StrictModel):
    """When a fault is there."""

    start_s: float = Field(ge=0.0, le=900.0)  # From the start of the simulation
    duration_s: float = Field(default=900.0, gt=0.0, le=900.0)  # By default to the end of the flight

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.duration_s


class GpsLost(FaultTimes):
    """The receiver sees too little sky, or its line is broken."""

    kind: Literal["gps_lost"]
    unplugged: bool = False  # Nothing on the line at all, instead of messages without a fix


class MagDisturbed(FaultTimes):
    """A field besides the earth's: a current, a steel tool, a loudspeaker's magnet."""

    kind: Literal["mag_disturbed"]
    field_body_ut: BodyVector = (0.0, 30.0, 0.0)  # Added to the earth's


class GyroBiasStep(FaultTimes):
    """The gyroscope's zero moves at once, as after a knock."""

    kind: Literal["gyro_bias_step"]
    rate_body_deg_s: BodyVector = (1.15, 1.15, 1.15)  # Added to every reading; by default 2 °/s in all


class AccelClips(FaultTimes):
    """The accelerometer's element saturates, before any filter, under stronger vibration."""

    kind: Literal["accel_clips"]
    range_g: float = Field(default=1.2, ge=0.2, le=16.0)  # Each axis feels no more than this
    vibration_factor: float = Field(default=4.0, ge=1.0, le=20.0)  # On the rotors' vibration meanwhile


class RangeSpikes(FaultTimes):
    """The ultrasonic hears something else."""

    kind: Literal["range_spikes"]
    share: float = Field(default=0.3, ge=0.0, le=1.0)  # Of the pings: an echo from anywhere in between


class FrameLate(FaultTimes):
    """A frame is held up on its way; frames taken after it may overtake it."""

    kind: Literal["frame_late"]
    extra_s: float = Field(default=0.25, gt=0.0, le=5.0)  # On top of the camera's own latency
    every: int = Field(default=10, ge=1, le=1000)  # One frame in so many; 1 is each


class FrameLost(FaultTimes):
    """Frames do not come."""

    kind: Literal["frame_lost"]
    share: float = Field(default=1.0, gt=0.0, le=1.0)  # Of the frames; 1 is a camera that has stalled


class ImuBusError(FaultTimes):
    """The IMU does not acknowledge."""

    kind: Literal["imu_bus_error"]
    every: int = Field(default=40, ge=1, le=10000)  # One transaction in so many; 1 is a cable that is off


Fault = GpsLost | MagDisturbed | GyroBiasStep | AccelClips | RangeSpikes | FrameLate | FrameLost | ImuBusError
