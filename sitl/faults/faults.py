"""What fails in flight, and when: faults as data of a scenario.

A fault acts on a sensor's input, its chip, its line or on a frame's transport (`sitl.faults.injection`),
never on anything the app computes. Every sensor can be lost, freeze, step aside (a bias) and spike. Axes are
the body's (FRD). When a fault begins: `sitl.faults.times`; what is no sensor:
`sitl.faults.non_sensor_faults`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sitl.faults.non_sensor_faults import NonSensorFault
from sitl.faults.times import FaultTimes

Component = Annotated[float, Field(ge=-1000.0, le=1000.0)]
LinkDirection = Literal["both", "to_app", "to_vehicle"]
BodyVector = tuple[Component, Component, Component]


Share = Annotated[float, Field(gt=0.0, le=1.0)]


# ---------------------------------------------------------------- IMU


class ImuLost(FaultTimes):
    """Its cable is off: nothing on the bus answers."""

    kind: Literal["imu_lost"]


class ImuBusError(FaultTimes):
    """The IMU does not acknowledge now and then."""

    kind: Literal["imu_bus_error"]
    every: int = Field(
        default=40, ge=1, le=10000, description="One transaction in so many; 1 is a cable that is off"
    )


class ImuStuck(FaultTimes):
    """It repeats its last rates and forces."""

    kind: Literal["imu_stuck"]


class ImuSaturated(FaultTimes):
    """Every axis of both is at the end of its range."""

    kind: Literal["imu_saturated"]


class GyroBiasStep(FaultTimes):
    """The gyroscope's zero moves at once, as after a knock."""

    kind: Literal["gyro_bias_step"]
    rate_body_deg_s: BodyVector = Field(
        default=(1.15, 1.15, 1.15), description="Added to every reading; by default 2 °/s in all"
    )


class GyroSpikes(FaultTimes):
    """Some rates are garbled."""

    kind: Literal["gyro_spikes"]
    share: Share = Field(default=0.01, description="Share of the readings")
    size_deg_s: float = Field(
        default=100.0, gt=0.0, le=2000.0, description="Off by up to so much, on one axis"
    )


class AccelBiasStep(FaultTimes):
    """The accelerometer's zero moves at once."""

    kind: Literal["accel_bias_step"]
    force_body_m_s2: BodyVector = Field(default=(0.5, 0.5, 0.0), description="Added to every reading")


class AccelSpikes(FaultTimes):
    """Some forces are garbled."""

    kind: Literal["accel_spikes"]
    share: Share = Field(default=0.01, description="Share of the readings")
    size_m_s2: float = Field(default=30.0, gt=0.0, le=160.0, description="Off by up to so much, on one axis")


class AccelClips(FaultTimes):
    """The accelerometer's element saturates, before any filter, under stronger vibration."""

    kind: Literal["accel_clips"]
    range_g: float = Field(default=1.2, ge=0.2, le=16.0, description="Each axis feels no more than this")
    vibration_factor: float = Field(
        default=4.0, ge=1.0, le=20.0, description="On the rotors' vibration meanwhile"
    )


class ImuTurned(FaultTimes):
    """The board with IMU and magnetometer lies otherwise than its file says, or slips in flight."""

    kind: Literal["imu_turned"]
    rotation_body_deg: BodyVector = Field(
        default=(0.0, 12.0, 0.0), description="Angles by which it is turned about forward, right and down"
    )
    slips_for_s: float = Field(
        default=0.0, ge=0.0, le=10.0, description="How long it takes to slip; 0: it lay so"
    )


class Vibration(FaultTimes):
    """A propeller is chipped, a frame resonates: the rotors' vibration grows, on the autopilot's IMU too."""

    kind: Literal["vibration"]
    factor: float = Field(default=4.0, ge=1.0, le=20.0, description="On the rotors' vibration")


# ---------------------------------------------------------------- magnetometer


class MagLost(FaultTimes):
    """It acknowledges nothing."""

    kind: Literal["mag_lost"]


class MagStuck(FaultTimes):
    """It repeats its last field."""

    kind: Literal["mag_stuck"]


class MagDisturbed(FaultTimes):
    """A field in addition to the earth's: a current, a steel tool, a loudspeaker's magnet."""

    kind: Literal["mag_disturbed"]
    field_body_ut: BodyVector = Field(default=(0.0, 30.0, 0.0), description="Added to the earth's")


class MagSpikes(FaultTimes):
    """Some fields are garbled."""

    kind: Literal["mag_spikes"]
    share: Share = Field(default=0.05, description="Share of the readings")
    size_ut: float = Field(default=100.0, gt=0.0, le=4900.0, description="Off by up to so much, on one axis")


# ---------------------------------------------------------------- GPS


class GpsLost(FaultTimes):
    """The receiver has too few satellites, or its line is disconnected."""

    kind: Literal["gps_lost"]
    unplugged: bool = Field(
        default=False, description="Nothing on the line at all, instead of messages without a fix"
    )


class GpsStuck(FaultTimes):
    """It repeats its last fix, with advancing time."""

    kind: Literal["gps_stuck"]


class GpsJump(FaultTimes):
    """The fix jumps, with unchanged accuracies: multipath, or another set of satellites."""

    kind: Literal["gps_jump"]
    position_ned_m: BodyVector = Field(default=(5.0, -5.0, 0.0), description="Added to every fix")


class GpsSpikes(FaultTimes):
    """Some fixes are far off."""

    kind: Literal["gps_spikes"]
    share: Share = Field(default=0.1, description="Share of the fixes")
    size_m: float = Field(
        default=30.0, gt=0.0, le=1000.0, description="Off by up to so much, north, east or down"
    )


# ---------------------------------------------------------------- ultrasonic


class RangeLost(FaultTimes):
    """It receives no echo, or its line is disconnected."""

    kind: Literal["range_lost"]
    share: Share = Field(default=1.0, description="Share of the pings")
    unplugged: bool = Field(
        default=False, description="Nothing on the line at all, instead of frames without an echo"
    )


class RangeStuck(FaultTimes):
    """It shows one distance whatever is below: something hangs before it."""

    kind: Literal["range_stuck"]
    distance_m: Annotated[float, Field(ge=0.0, le=4.5)] | None = Field(
        default=None, description="None: the last one it had"
    )


class RangeBiasStep(FaultTimes):
    """It shows too much at once, or too little: air of another temperature, a mount that slipped."""

    kind: Literal["range_bias_step"]
    distance_m: float = Field(default=0.1, ge=-2.0, le=2.0, description="Added to every echo")


class RangeSpikes(FaultTimes):
    """The ultrasonic receives wrong echoes."""

    kind: Literal["range_spikes"]
    share: float = Field(
        default=0.3, ge=0.0, le=1.0, description="Share of the pings: an echo from anywhere in between"
    )


class RangeOtherEcho(FaultTimes):
    """Something nearer than the floor answers now and then: a cable, a strap, grass."""

    kind: Literal["range_other_echo"]
    distance_m: float = Field(default=0.4, ge=0.0, le=4.5, description="Where it hangs")
    share: Share = Field(default=0.7, description="Share of the pings")


# ---------------------------------------------------------------- camera


class FrameLate(FaultTimes):
    """A frame is held up on its way; frames taken after it may overtake it."""

    kind: Literal["frame_late"]
    extra_s: float = Field(default=0.25, gt=0.0, le=5.0, description="On top of the camera's own latency")
    every: int = Field(default=10, ge=1, le=1000, description="One frame in so many; 1 is each")


class FrameLost(FaultTimes):
    """Frames do not come."""

    kind: Literal["frame_lost"]
    share: float = Field(
        default=1.0, gt=0.0, le=1.0, description="Share of the frames; 1 is a camera that has stalled"
    )
    burst_frames: float = Field(
        default=1.0, ge=1.0, le=300.0, description="Frames in a row on average; 1: singly"
    )


class FrameStuck(FaultTimes):
    """The same picture comes again and again, with new stamps."""

    kind: Literal["frame_stuck"]


class FrameGarbled(FaultTimes):
    """Frames are garbage from some row on, as of a loose cable."""

    kind: Literal["frame_garbled"]
    share: Share = Field(default=0.3, description="Share of the frames")


class FrameBlack(FaultTimes):
    """Frames come, but black: a cap on the lens."""

    kind: Literal["frame_black"]


class FrameGarbage(FaultTimes):
    """Every frame is random data."""

    kind: Literal["frame_garbage"]


# ---------------------------------------------------------------- link and motors


class LinkBlackout(FaultTimes):
    """Nothing gets through between vehicle and app."""

    kind: Literal["link_blackout"]
    way: LinkDirection = Field(default="both", description="Which direction")


class LinkLoss(FaultTimes):
    """Datagrams are lost between vehicle and app."""

    kind: Literal["link_loss"]
    share: Share = Field(default=0.5, description="Share of the datagrams")
    way: LinkDirection = Field(default="both", description="Which direction")


class LinkDelay(FaultTimes):
    """Datagrams come late, in their order."""

    kind: Literal["link_delay"]
    extra_s: float = Field(default=0.5, gt=0.0, le=10.0, description="On top of the line's own delay")
    way: LinkDirection = Field(default="both", description="Which direction")


class MotorWeak(FaultTimes):
    """A motor gives less thrust than commanded; all of them: the battery's voltage sags."""

    kind: Literal["motor_weak"]
    motor: Literal[1, 2, 3, 4, "all"] = Field(default=1, description="1 front, 2 right, 3 back, 4 left")
    thrust_factor: float = Field(default=0.85, ge=0.0, le=1.0, description="What is left of its thrust")


Fault = (
    ImuLost
    | ImuBusError
    | ImuStuck
    | ImuSaturated
    | GyroBiasStep
    | GyroSpikes
    | AccelBiasStep
    | AccelSpikes
    | AccelClips
    | ImuTurned
    | Vibration
    | MagLost
    | MagStuck
    | MagDisturbed
    | MagSpikes
    | GpsLost
    | GpsStuck
    | GpsJump
    | GpsSpikes
    | RangeLost
    | RangeStuck
    | RangeBiasStep
    | RangeSpikes
    | RangeOtherEcho
    | FrameLate
    | FrameLost
    | FrameStuck
    | FrameGarbled
    | FrameBlack
    | FrameGarbage
    | LinkBlackout
    | LinkLoss
    | LinkDelay
    | MotorWeak
    | NonSensorFault
)
