"""What fails in flight, and when: each fault of a scenario is a class of its settings and of what it does.

A fault acts on a sensor's input, its chip, its line or on a frame's transport, on the pad, the autopilot or
the companion computer, never on anything the app computes. Every sensor can be lost, freeze, step aside (a
bias) and spike. Axes are the body's (FRD), SI units. `sitl.faults.schedule` begins and ends them.
"""

from __future__ import annotations

import inspect
import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, model_validator

from companion.base.geometry import GRAVITY_M_S2, add
from companion.config import ConfigError, StrictModel

if TYPE_CHECKING:  # a scenario is read without what it simulates
    from companion.base.geometry import Vector3
    from sitl.autopilot.flight.profile import AutopilotProfile
    from sitl.faults.targets import FaultTargets

FlownPhase = Literal[
    "arm", "take off", "waypoint", "route", "search", "approach", "descend", "touchdown", "hold", "abort"
]
Since = Annotated[float, Field(ge=0.0, le=900.0)]
Low = Annotated[float, Field(ge=0.0, le=50.0)]
Component = Annotated[float, Field(ge=-1000.0, le=1000.0)]
LinkDirection = Literal["both", "to_app", "to_vehicle"]
BodyVector = tuple[Component, Component, Component]
Share = Annotated[float, Field(gt=0.0, le=1.0)]
# the board's surface over the ground, for a pad that somebody has left there
TWIN_HEIGHT_M = 0.1
RESUMES_M_S2 = 3.0


class Fault(StrictModel):
    """When a fault is there: one of the four beginnings, and a duration.

    It begins at a time, when the app announces a phase, at a height over the pad, or after the app's first
    sighting of the pad. The simulator hears the phase and the sighting from outside, by the app's STATUSTEXT.
    What lasts is applied again whenever a fault starts or ends (`apply`), so that faults may overlap; what
    happens once has a beginning and, with some, an end.
    """

    if TYPE_CHECKING:
        kind: str

    start_s: Since | None = Field(
        default=None, description="It begins this long after the start of the simulation"
    )
    phase: FlownPhase | None = Field(
        default=None, description="It begins when the app first announces this phase"
    )
    below_m: Low | None = Field(
        default=None,
        description="It begins when the feet, over the pad, first come this low in flight; 0: they touch",
    )
    after_sighting_s: Since | None = Field(
        default=None, description="It begins this long after the first sighting"
    )
    delay_s: float = Field(default=0.0, ge=0.0, le=900.0, description="Further delay after that")
    duration_s: float = Field(
        default=900.0, gt=0.0, le=900.0, description="Duration; by default to the end of the flight"
    )

    def __init_subclass__(cls, *, kind: str = "", **settings: Any) -> None:
        """`kind` is the class's name in a scenario; without, none can name it."""
        super().__init_subclass__(**settings)
        if kind:
            cls.__annotations__ = {"kind": Literal[kind], **cls.__annotations__}

    @model_validator(mode="after")
    def _begins_once(self) -> Fault:
        ways = (self.start_s, self.phase, self.below_m, self.after_sighting_s)
        if sum(way is not None for way in ways) != 1:
            raise ValueError("expected one of start_s, phase, below_m and after_sighting_s")
        return self

    @property
    def lasts_s(self) -> float:
        return self.duration_s

    def check(self, targets: FaultTargets) -> None:
        """Raise ConfigError when there is nothing that it could act on."""

    def apply(self, targets: FaultTargets) -> None:
        """Act, on targets whose faults have been cleared."""

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        """What happens once, as it begins."""

    def end(self, targets: FaultTargets, now_s: float) -> None:
        """What happens once, as it ends."""


class AutopilotFault(Fault):
    """One of the bundled autopilot."""

    def check(self, targets: FaultTargets) -> None:
        if targets.autopilot is None:
            raise ConfigError(f"faults: {self.kind} needs the bundled autopilot, not a firmware")


class ComputerFault(Fault):
    """One of the companion computer. It acts in a harness that runs the app in the simulator's process."""

    def check(self, targets: FaultTargets) -> None:
        if targets.computer is None:
            raise ConfigError(
                f"faults: {self.kind} is the companion computer's, which make bench-faults simulates"
            )


# ---------------------------------------------------------------- IMU


class ImuLost(Fault, kind="imu_lost"):
    """Its cable is off: nothing on the bus answers."""

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.imu.fault = "nack"


class ImuBusError(Fault, kind="imu_bus_error"):
    """The IMU does not acknowledge now and then."""

    every: int = Field(
        default=40,
        ge=1,
        le=10000,
        description="One transaction in this number fails; 1: the cable is disconnected",
    )

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.imu.nack_every = self.every


class ImuStuck(Fault, kind="imu_stuck"):
    """It repeats its last rates and forces."""

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.inertial.gyro_glitches.stuck = targets.rack.inertial.accel_glitches.stuck = True


class ImuSaturated(Fault, kind="imu_saturated"):
    """Every axis of both is at the end of its range."""

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.imu.fault = "saturated"


class GyroBiasStep(Fault, kind="gyro_bias_step"):
    """The gyroscope's zero moves at once, as after a knock."""

    rate_body_deg_s: BodyVector = Field(
        default=(1.15, 1.15, 1.15), description="Added to every reading; by default 2 °/s in total"
    )

    def apply(self, targets: FaultTargets) -> None:
        x, y, z = self.rate_body_deg_s
        step = (math.radians(x), math.radians(y), math.radians(z))
        inertial = targets.rack.inertial
        inertial.rate_offset_rad_s = add(inertial.rate_offset_rad_s, step)


class GyroSpikes(Fault, kind="gyro_spikes"):
    """Some rates are garbled."""

    share: Share = Field(default=0.01, description="Share of the readings")
    size_deg_s: float = Field(default=100.0, gt=0.0, le=2000.0, description="Largest error, on one axis")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.inertial.gyro_glitches.spike(self.share, math.radians(self.size_deg_s))


class AccelBiasStep(Fault, kind="accel_bias_step"):
    """The accelerometer's zero moves at once."""

    force_body_m_s2: BodyVector = Field(default=(0.5, 0.5, 0.0), description="Added to every reading")

    def apply(self, targets: FaultTargets) -> None:
        inertial = targets.rack.inertial
        inertial.force_offset_m_s2 = add(inertial.force_offset_m_s2, self.force_body_m_s2)


class AccelSpikes(Fault, kind="accel_spikes"):
    """Some forces are garbled."""

    share: Share = Field(default=0.01, description="Share of the readings")
    size_m_s2: float = Field(default=30.0, gt=0.0, le=160.0, description="Largest error, on one axis")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.inertial.accel_glitches.spike(self.share, self.size_m_s2)


class AccelClips(Fault, kind="accel_clips"):
    """The accelerometer's element saturates, before any filter, under stronger vibration."""

    range_g: float = Field(
        default=1.2, ge=0.2, le=16.0, description="Largest acceleration that an axis measures"
    )
    vibration_factor: float = Field(
        default=4.0, ge=1.0, le=20.0, description="Factor on the rotors' vibration during the fault"
    )

    def apply(self, targets: FaultTargets) -> None:
        limit_m_s2 = self.range_g * GRAVITY_M_S2
        targets.rack.inertial.accel_limit_m_s2 = min(targets.rack.inertial.accel_limit_m_s2, limit_m_s2)
        targets.rack.inertial.vibration_factor *= self.vibration_factor


class ImuTurned(Fault, kind="imu_turned"):
    """The board with IMU and magnetometer lies otherwise than its file says, or slips in flight."""

    rotation_body_deg: BodyVector = Field(
        default=(0.0, 12.0, 0.0), description="Angles by which it is turned about forward, right and down"
    )
    slips_for_s: float = Field(
        default=0.0, ge=0.0, le=10.0, description="Duration of the slip; 0: turned from the beginning"
    )

    def apply(self, targets: FaultTargets) -> None:
        x, y, z = self.rotation_body_deg
        targets.rack.mount.target_rad = (math.radians(x), math.radians(y), math.radians(z))
        targets.rack.mount.slips_for_s = self.slips_for_s


class Vibration(Fault, kind="vibration"):
    """A propeller is chipped, a frame resonates: the rotors' vibration grows, on the autopilot's IMU too."""

    factor: float = Field(default=4.0, ge=1.0, le=20.0, description="Factor on the rotors' vibration")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.inertial.vibration_factor *= self.factor
        targets.autopilot_sensors.inertial.vibration_factor *= self.factor


# ---------------------------------------------------------------- magnetometer


class MagLost(Fault, kind="mag_lost"):
    """It acknowledges nothing."""

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.imu.magnetometer.silent = True


class MagStuck(Fault, kind="mag_stuck"):
    """It repeats its last field."""

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.magnetometer.glitches.stuck = True


class MagDisturbed(Fault, kind="mag_disturbed"):
    """A field in addition to the earth's: a current, a steel tool, a loudspeaker's magnet."""

    field_body_ut: BodyVector = Field(default=(0.0, 30.0, 0.0), description="Added to the Earth's field")

    def apply(self, targets: FaultTargets) -> None:
        for sensor in (targets.rack.magnetometer, targets.autopilot_sensors):
            sensor.stray_field_ut = add(sensor.stray_field_ut, self.field_body_ut)


class MagSpikes(Fault, kind="mag_spikes"):
    """Some fields are garbled."""

    share: Share = Field(default=0.05, description="Share of the readings")
    size_ut: float = Field(default=100.0, gt=0.0, le=4900.0, description="Largest error, on one axis")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.magnetometer.glitches.spike(self.share, self.size_ut)


# ---------------------------------------------------------------- GPS


class GpsLost(Fault, kind="gps_lost"):
    """The receiver has too few satellites, or its line is disconnected."""

    unplugged: bool = Field(default=False, description="Send nothing, instead of messages without a fix")

    def apply(self, targets: FaultTargets) -> None:
        if self.unplugged:
            targets.rack.gps.silent = True
        else:
            targets.rack.gps.has_fix = False
            targets.autopilot_sensors.has_sky = False


class GpsStuck(Fault, kind="gps_stuck"):
    """It repeats its last fix, with advancing time."""

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.position.stuck = True


class GpsJump(Fault, kind="gps_jump"):
    """The fix jumps, with unchanged accuracies: multipath, or another set of satellites."""

    position_ned_m: BodyVector = Field(default=(5.0, -5.0, 0.0), description="Added to every fix")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.position.jump_ned_m = add(targets.rack.position.jump_ned_m, self.position_ned_m)


class GpsSpikes(Fault, kind="gps_spikes"):
    """Some fixes are far off."""

    share: Share = Field(default=0.1, description="Share of the fixes")
    size_m: float = Field(default=30.0, gt=0.0, le=1000.0, description="Largest error, north, east or down")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.position.glitches.spike(self.share, self.size_m)


# ---------------------------------------------------------------- ultrasonic


class RangeLost(Fault, kind="range_lost"):
    """It receives no echo, or its line is disconnected."""

    share: Share = Field(default=1.0, description="Share of the pings")
    unplugged: bool = Field(default=False, description="Send nothing, instead of frames without an echo")

    def apply(self, targets: FaultTargets) -> None:
        if self.unplugged:
            targets.rack.range.silent = True
        else:
            targets.rack.echo.extra_lost = max(targets.rack.echo.extra_lost, self.share)


class RangeStuck(Fault, kind="range_stuck"):
    """It shows one distance whatever is below: something hangs before it."""

    distance_m: Annotated[float, Field(ge=0.0, le=4.5)] | None = Field(
        default=None, description="Distance that is repeated; none: the last one measured"
    )

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.echo.stuck, targets.rack.echo.stuck_m = True, self.distance_m


class RangeBiasStep(Fault, kind="range_bias_step"):
    """It shows too much at once, or too little: air of another temperature, a mount that slipped."""

    distance_m: float = Field(default=0.1, ge=-2.0, le=2.0, description="Added to every echo")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.echo.bias_m += self.distance_m


class RangeSpikes(Fault, kind="range_spikes"):
    """The ultrasonic receives wrong echoes."""

    share: float = Field(
        default=0.3,
        ge=0.0,
        le=1.0,
        description="Share of the pings that return an echo from a random shorter distance",
    )

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.echo.extra_spikes = max(targets.rack.echo.extra_spikes, self.share)


class RangeOtherEcho(Fault, kind="range_other_echo"):
    """Something nearer than the floor answers now and then: a cable, a strap, grass."""

    distance_m: float = Field(default=0.4, ge=0.0, le=4.5, description="Distance of the other object")
    share: Share = Field(default=0.7, description="Share of the pings")

    def apply(self, targets: FaultTargets) -> None:
        targets.rack.echo.other_m, targets.rack.echo.other_share = self.distance_m, self.share


# ---------------------------------------------------------------- camera


class FrameLate(Fault, kind="frame_late"):
    """A frame is held up on its way; frames taken after it may overtake it."""

    extra_s: float = Field(
        default=0.25, gt=0.0, le=5.0, description="In addition to the camera's own latency"
    )
    every: int = Field(default=10, ge=1, le=1000, description="One frame in this number; 1: each")

    def apply(self, targets: FaultTargets) -> None:
        targets.frames.late_s, targets.frames.late_every = self.extra_s, self.every


class FrameLost(Fault, kind="frame_lost"):
    """Frames do not come."""

    share: float = Field(
        default=1.0, gt=0.0, le=1.0, description="Share of the frames; 1 is a camera that has stalled"
    )
    burst_frames: float = Field(
        default=1.0, ge=1.0, le=300.0, description="Mean number of frames in a row; 1: single frames"
    )

    def apply(self, targets: FaultTargets) -> None:
        if self.share >= targets.frames.lost_share:
            targets.frames.lost_share, targets.frames.burst_frames = self.share, self.burst_frames


class FrameStuck(Fault, kind="frame_stuck"):
    """The same picture comes again and again, with new stamps."""

    def apply(self, targets: FaultTargets) -> None:
        targets.frames.stuck = True


class FrameGarbled(Fault, kind="frame_garbled"):
    """Frames are garbage from some row on, as of a loose cable."""

    share: Share = Field(default=0.3, description="Share of the frames")

    def apply(self, targets: FaultTargets) -> None:
        targets.frames.garbled_share = max(targets.frames.garbled_share, self.share)


class FrameBlack(Fault, kind="frame_black"):
    """Frames come, but black: a cap on the lens."""

    def apply(self, targets: FaultTargets) -> None:
        targets.frames.black = True


class FrameGarbage(Fault, kind="frame_garbage"):
    """Every frame is random data."""

    def apply(self, targets: FaultTargets) -> None:
        targets.frames.garbage = True


# ---------------------------------------------------------------- link and motors


class LinkBlackout(Fault, kind="link_blackout"):
    """Nothing gets through between vehicle and app."""

    way: LinkDirection = Field(default="both", description="Which direction")

    def apply(self, targets: FaultTargets) -> None:
        for way in targets.ways(self.way):
            way.cut = True


class LinkLoss(Fault, kind="link_loss"):
    """Datagrams are lost between vehicle and app."""

    share: Share = Field(default=0.5, description="Share of the datagrams")
    way: LinkDirection = Field(default="both", description="Which direction")

    def apply(self, targets: FaultTargets) -> None:
        for way in targets.ways(self.way):
            way.extra_loss = max(way.extra_loss, self.share)


class LinkDelay(Fault, kind="link_delay"):
    """Datagrams come late, in their order."""

    extra_s: float = Field(default=0.5, gt=0.0, le=10.0, description="In addition to the link's own delay")
    way: LinkDirection = Field(default="both", description="Which direction")

    def apply(self, targets: FaultTargets) -> None:
        for way in targets.ways(self.way):
            way.extra_delay_s += self.extra_s


class MotorWeak(Fault, kind="motor_weak"):
    """A motor gives less thrust than commanded; all of them: the battery's voltage sags."""

    motor: Literal[1, 2, 3, 4, 5, 6, 7, 8, "all"] = Field(
        default=1, description="From the front clockwise; of four: 1 front, 2 right, 3 back, 4 left"
    )
    thrust_factor: float = Field(default=0.85, ge=0.0, le=1.0, description="Remaining share of its thrust")

    def apply(self, targets: FaultTargets) -> None:
        targets.motors.weaken(None if self.motor == "all" else self.motor, self.thrust_factor)


# ---------------------------------------------------------------- the pad


class PadCovered(Fault, kind="pad_covered"):
    """A tarpaulin lies over the markers; the board is still there."""

    def apply(self, targets: FaultTargets) -> None:
        targets.camera.cover()


class PadWrongIds(Fault, kind="pad_wrong_ids"):
    """The board shows other markers than the pad's: another pad."""

    def apply(self, targets: FaultTargets) -> None:
        targets.camera.show_other_ids()


class PadResized(Fault, kind="pad_resized"):
    """The pad is printed larger or smaller than its file says, as A3 on A4."""

    scale: float = Field(default=0.71, ge=0.2, le=3.0, description="Factor on all lengths of the print")

    def apply(self, targets: FaultTargets) -> None:
        targets.camera.print_scale = self.scale


class PadTwin(Fault, kind="pad_twin"):
    """A second, identical pad is in view. It is a picture alone: nothing can stand on it."""

    north_m: float = Field(
        default=0.0, ge=-50.0, le=50.0, description="North, from the pad's centre to its twin's"
    )
    east_m: float = Field(default=2.0, ge=-50.0, le=50.0, description="East, from the same point")
    moves: bool = Field(
        default=True,
        description="Whether it moves with the pad; otherwise it stays on the ground at the pad's position",
    )

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        north, east, _ = targets.motion.at(now_s).position_ned_m
        left = (north + self.north_m, east + self.east_m, -TWIN_HEIGHT_M)

        def beside(pad_ned_m: Vector3) -> Vector3:
            return (pad_ned_m[0] + self.north_m, pad_ned_m[1] + self.east_m, pad_ned_m[2])

        targets.camera.twin_ned_m = beside if self.moves else lambda _pad_ned_m: left

    def end(self, targets: FaultTargets, now_s: float) -> None:
        targets.camera.twin_ned_m = None


class _PadDrives(Fault):
    """The pad's drive changes; in the end it goes on as fast as before, straight on."""

    def end(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.drive(now_s, targets.motion.usual_m_s, RESUMES_M_S2)


class PadStops(_PadDrives, kind="pad_stops"):
    """The pad stands still at once, as against a kerb; at the end of the fault it goes on."""

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.drive(now_s, 0.0)


class PadBrakes(_PadDrives, kind="pad_brakes"):
    """The pad brakes to a standstill, straight on; at the end of the fault it goes on."""

    deceleration_m_s2: float = Field(
        default=3.0, gt=0.0, le=20.0, description="Deceleration until the pad stands still"
    )

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.drive(now_s, 0.0, self.deceleration_m_s2)


class PadTurnsBack(_PadDrives, kind="pad_turns_back"):
    """The pad brakes and drives back the way it came."""

    acceleration_m_s2: float = Field(default=2.0, gt=0.0, le=20.0, description="Acceleration backwards")

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.turn_back(now_s, self.acceleration_m_s2)


class PadLeaves(_PadDrives, kind="pad_leaves"):
    """The pad drives away, straight on."""

    speed_m_s: float = Field(default=6.0, gt=0.0, le=30.0, description="Final speed")
    acceleration_m_s2: float = Field(
        default=2.0, gt=0.0, le=20.0, description="Acceleration up to that speed"
    )

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.drive(now_s, self.speed_m_s, self.acceleration_m_s2)


class PadVanishes(Fault, kind="pad_vanishes"):
    """The pad is gone: neither to be seen nor to be stood on. Its beacon stays where it was."""

    def apply(self, targets: FaultTargets) -> None:
        targets.camera.shows_pad = False

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.vanish(now_s)

    def end(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.appear()


class PadTilts(Fault, kind="pad_tilts"):
    """The pad tilts, as on a vehicle that drives on to a kerb."""

    roll_deg: float = Field(default=15.0, ge=-45.0, le=45.0, description="Angle about its heading")
    rate_deg_s: float = Field(default=15.0, gt=0.0, le=360.0, description="Rate of tilting")

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.tilt(now_s, math.radians(self.roll_deg), math.radians(self.rate_deg_s))

    def end(self, targets: FaultTargets, now_s: float) -> None:
        targets.motion.tilt(now_s, 0.0, math.radians(self.rate_deg_s))


# ---------------------------------------------------------------- the autopilot


class AutopilotRefuses(AutopilotFault, kind="autopilot_refuses"):
    """It denies a request, with or without force. `auto_disarm`: it does not disarm by itself either."""

    what: Literal["arm", "take_off", "offboard", "land", "disarm", "auto_disarm"] = Field(
        description="Request that is refused"
    )

    def apply(self, targets: FaultTargets) -> None:
        targets.bundled.refused |= {self.what}


class PilotMode(AutopilotFault, kind="pilot_mode"):
    """The pilot changes the mode, once."""

    mode: Literal["position", "hold", "return", "land"] = Field(
        default="position", description="Mode, as the autopilot calls it"
    )

    def chosen(self, profile: AutopilotProfile) -> str:
        """What an autopilot calls the mode."""
        position = "POSCTL" if profile.name == "px4" else "LOITER"
        modes = {"position": position, "hold": profile.hold_mode, "return": profile.return_mode}
        return modes.get(self.mode, profile.land_mode)

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.bundled.set_mode_named(self.chosen(targets.bundled.profile))


class AutopilotReboots(AutopilotFault, kind="autopilot_reboots"):
    """A watchdog's reset in flight: silence, then a new boot time, its hold mode, its default streams.

    The motors stay on, as ArduPilot's in-flight recovery keeps them.
    """

    silent_s: float = Field(default=2.0, gt=0.0, le=60.0, description="Time without sending or receiving")

    @property
    def lasts_s(self) -> float:
        """It is silent no longer than that."""
        return min(self.duration_s, self.silent_s)

    def apply(self, targets: FaultTargets) -> None:
        targets.to_app.cut = targets.to_vehicle.cut = True

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.bundled.recover(now_s)
        targets.restart_streams()


class AutopilotDisarms(AutopilotFault, kind="autopilot_disarms"):
    """Its motors stop wherever it is: the pilot's switch, or a land detector that errs."""

    def begin(self, targets: FaultTargets, now_s: float) -> None:
        targets.bundled.terminate()


class AutopilotPositionLost(AutopilotFault, kind="autopilot_position_lost"):
    """Its estimator gives no position: none is sent, and it says so. It flies on as it did."""

    def apply(self, targets: FaultTargets) -> None:
        targets.bundled.position_lost = True


class BatteryCharge(AutopilotFault, kind="battery"):
    """The battery's remaining charge, as reported in SYS_STATUS and BATTERY_STATUS."""

    remaining_percent: int = Field(
        default=15, ge=-1, le=100, description="Remaining charge; -1: unknown to the autopilot"
    )

    def apply(self, targets: FaultTargets) -> None:
        targets.bundled.battery.false_share = 0.01 * self.remaining_percent


class FollowMe(Fault, kind="follow_me"):
    """The ground station sends its operator's place as FOLLOW_TARGET, unasked, as QGroundControl does."""

    north_m: float = Field(
        default=20.0, ge=-500.0, le=500.0, description="Position of the operator north of home"
    )
    east_m: float = Field(default=-15.0, ge=-500.0, le=500.0, description="East, from the same point")
    rate_hz: float = Field(default=1.0, gt=0.0, le=10.0, description="Messages per second")

    def apply(self, targets: FaultTargets) -> None:
        targets.station.follow((self.north_m, self.east_m, 0.0), self.rate_hz)


class SecondCompanion(AutopilotFault, kind="second_companion"):
    """A duplicate of the companion, under another component id, sends setpoints too: stand still."""

    component_id: int = Field(
        default=196, ge=1, le=255, description="Its component id, in the vehicle's system"
    )
    rate_hz: float = Field(default=10.0, gt=0.0, le=50.0, description="Setpoints per second")

    def apply(self, targets: FaultTargets) -> None:
        targets.station.second_companion(self.component_id, self.rate_hz)


class ForgedFrames(Fault, kind="forged_frames"):
    """Somebody without the key sends frames in the autopilot's name, with the largest time stamp there is."""

    rate_hz: float = Field(default=1.0, gt=0.0, le=50.0, description="Frames per second")

    def apply(self, targets: FaultTargets) -> None:
        targets.station.forge(self.rate_hz)


# ---------------------------------------------------------------- the companion computer


class ImuNan(ComputerFault, kind="imu_nan"):
    """The IMU's driver hands on samples that are no numbers."""

    def apply(self, targets: FaultTargets) -> None:
        targets.host.imu_nan = True


class SolverInfeasible(ComputerFault, kind="solver_infeasible"):
    """The MPC finds no solution."""

    def apply(self, targets: FaultTargets) -> None:
        targets.host.solver = "infeasible"


class SolverLate(ComputerFault, kind="solver_late"):
    """The MPC's time is up before it has found its solution, in each cycle."""

    def apply(self, targets: FaultTargets) -> None:
        targets.host.solver = "late"


class SolverNan(ComputerFault, kind="solver_nan"):
    """The MPC's solution is no number, and it says that it solved."""

    def apply(self, targets: FaultTargets) -> None:
        targets.host.solver = "nan"


class DiskFull(ComputerFault, kind="disk_full"):
    """Nothing more can be written to the log's disk."""

    def apply(self, targets: FaultTargets) -> None:
        targets.host.disk_full = True


class DiskSlow(ComputerFault, kind="disk_slow"):
    """Every write to the log's disk takes long."""

    write_s: float = Field(default=0.02, gt=0.0, le=10.0, description="Real time that each write takes")

    def apply(self, targets: FaultTargets) -> None:
        targets.host.disk_write_s = self.write_s


def _kinds() -> tuple[type[Fault], ...]:
    """All of the above that a scenario can name."""
    classes = [each for each in globals().values() if inspect.isclass(each) and issubclass(each, Fault)]
    return tuple(each for each in classes if "kind" in each.__annotations__ and each.__subclasses__() == [])


if TYPE_CHECKING:
    AnyFault = Fault
else:
    AnyFault = Union[_kinds()]  # noqa: UP007 - of a tuple
