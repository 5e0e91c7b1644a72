"""What the judge reads of a flight: from the simulator's side, but for the height of the app's reference.

The truth and the autopilot's state at 50 Hz, each touch of the ground by the state before it, each contact
with pad or ground by its worst touch, each change of
arming, every setpoint as it left the app, and every text that the app sent. NED, SI.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from companion.base.geometry import Vector3, horizontal_acceleration, tilt_from_quat, yaw_from_quat
from companion.link.codec import mavlink
from sitl.faults.schedule import AppText
from sitl.mavlink.framing import FrameReader, MavFrame
from sitl.run.simulation import Simulation
from sitl.world.score import TouchdownState

SAMPLE_S: Final = 0.02
_YAW_RATE_IGNORED: Final = 1 << 11
_YAW_IGNORED: Final = 1 << 10


class TruthSample(NamedTuple):
    """The truth at a time. `feet_over_surface_m`: over what is beneath, board or ground. `obeys`: a setpoint
    that has reached it of late.

    So much too low the GPS receiver has its height, and the app believes itself: `receiver_low_m` and
    `believed_low_m`, whose zero may be anywhere.
    """

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    feet_over_surface_m: float
    touching: bool
    armed: bool
    mode: str
    receiver_low_m: float = 0.0
    believed_low_m: float = 0.0
    obeys: bool = True


class GroundTouch(NamedTuple):
    """A moment at which something of the vehicle touches the ground, by the state before it."""

    time_s: float
    sideways_m_s: float
    down_m_s: float
    armed: bool


class Disarming(NamedTuple):
    """The motors stop: how high the feet are over what is beneath, and whether they touch it."""

    time_s: float
    feet_over_surface_m: float
    touching: bool


class SentSetpoint(NamedTuple):
    """A setpoint as it left the app; None where the message says that it holds no such thing.

    `tilt_ned_m_s2` is the level acceleration that an attitude gives without a vertical one. `pressed_m_s2`:
    by so much the app felt the vehicle pressed down, which may be met beyond the limit on acceleration.
    """

    time_s: float
    velocity_ned_m_s: Vector3 | None = None
    acceleration_ned_m_s2: Vector3 | None = None
    yaw_rad: float = 0.0
    yaw_rate_rad_s: float = 0.0
    tilt_rad: float = 0.0
    tilt_ned_m_s2: Vector3 | None = None
    thrust: float | None = None
    finite: bool = True
    pressed_m_s2: float = 0.0


class Commanded(NamedTuple):
    """The height of the app's reference: down (m) in the frame `origin`, over the pad or in its own NED."""

    time_s: float
    origin: str
    down_m: float


@dataclass
class WitnessedFlight:
    """All of a flight that the judge reads."""

    samples: list[TruthSample] = field(default_factory=list)
    touches: list[GroundTouch] = field(default_factory=list)
    contacts: list[TouchdownState] = field(default_factory=list)
    disarmings: list[Disarming] = field(default_factory=list)
    setpoints: list[SentSetpoint] = field(default_factory=list)
    texts: list[AppText] = field(default_factory=list)
    commanded: list[Commanded] = field(default_factory=list)
    crashed: bool = False
    at_rest_on_pad: bool = False
    app_ended_s: float | None = None
    app_stopped_s: float | None = None  # by the bench; the vehicle is watched for minutes more
    app_failed: str = ""
    pilot_took_over: bool = False
    pilot_mode: str = ""  # what the fault has put it into, as the autopilot calls it
    unasked_from_s: float | None = None  # the app stands by, and what it sends from then on nobody asked for
    fault_began: bool = False
    fault_began_s: float = math.inf  # the last of them


class FaultWitness:
    """Fills a record: `step` after every step of the physics, `hear` with what the app sends."""

    def __init__(self, simulation: Simulation) -> None:
        self.record = WitnessedFlight()
        self._simulation = simulation
        self._world, self._autopilot = simulation.world, simulation.autopilot
        world = self._world
        self._before = world.state
        self._armed = False
        self._next_s = 0.0
        self._reader = FrameReader(datagrams=True)
        self._decoder = mavlink.MAVLink(None)

    def step(self) -> None:
        """Look at the world."""
        world, armed = self._world, self._autopilot.armed
        now_s, contact = world.time_s, world.contact
        if contact.on_ground:
            vn, ve, vd = self._before.velocity_ned_m_s
            self.record.touches.append(GroundTouch(now_s, math.hypot(vn, ve), vd, armed))
        if self._armed and not armed:
            self.record.disarmings.append(Disarming(now_s, self._feet_m(), contact.touching))
        if self._simulation.faults.all_begun:
            self.record.fault_began_s = min(self.record.fault_began_s, now_s)
        self._armed = armed
        self._before = world.state
        if now_s >= self._next_s:
            self._next_s += SAMPLE_S
            self._sample(now_s)

    def _feet_m(self) -> float:
        return self._world.height_m - self._world.landed_reference_height_m

    def _sample(self, now_s: float) -> None:
        world, state = self._world, self._world.state
        touching = world.contact.touching
        place, velocity = state.position_ned_m, state.velocity_ned_m_s
        armed, mode = self._autopilot.armed, self._autopilot.mode
        low_m = self._simulation.receiver_wander_ned_m[2]
        sample = TruthSample(now_s, place, velocity, self._feet_m(), touching, armed, mode, low_m)
        self.record.samples.append(sample._replace(obeys=self._autopilot.obeys_setpoints))

    def hear(self, data: bytes, now_s: float) -> None:
        """Take what the app has just sent."""
        for frame in self._reader.read(data, now_s):
            sent = self._setpoint(frame, now_s)
            if sent is not None:
                self.record.setpoints.append(sent)

    def _setpoint(self, frame: MavFrame, now_s: float) -> SentSetpoint | None:
        if frame.message_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            return local_setpoint(self._decoder.decode(bytearray(frame.data)), now_s)
        if frame.message_id == mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET:
            return attitude_setpoint(self._decoder.decode(bytearray(frame.data)), now_s)
        return None


def local_setpoint(m: Any, now_s: float) -> SentSetpoint:
    """SET_POSITION_TARGET_LOCAL_NED; what its mask ignores may be anything."""
    velocity, acceleration = (
        _given(m.type_mask, 3, m.vx, m.vy, m.vz),
        _given(m.type_mask, 6, m.afx, m.afy, m.afz),
    )
    yaw_rate = 0.0 if m.type_mask & _YAW_RATE_IGNORED else m.yaw_rate
    yaw = 0.0 if m.type_mask & _YAW_IGNORED else m.yaw
    numbers = (*(velocity or ()), *(acceleration or ()), yaw, yaw_rate)
    finite = all(map(math.isfinite, numbers))
    return SentSetpoint(now_s, velocity, acceleration, yaw, yaw_rate, finite=finite)


def _given(mask: int, first_bit: int, x: float, y: float, z: float) -> Vector3 | None:
    """A vector of a setpoint without the parts that its mask ignores; None when it ignores all."""
    ignored = [bool(mask & 1 << bit) for bit in range(first_bit, first_bit + 3)]
    if all(ignored):
        return None
    kept = (0.0 if left else value for left, value in zip(ignored, (x, y, z), strict=True))
    north, east, down = kept
    return (north, east, down)


def attitude_setpoint(m: Any, now_s: float) -> SentSetpoint:
    """SET_ATTITUDE_TARGET."""
    w, x, y, z = m.q
    numbers = (w, x, y, z, m.thrust, m.body_yaw_rate)
    if not all(map(math.isfinite, numbers)):
        return SentSetpoint(now_s, finite=False)
    q = (w, x, y, z)
    return SentSetpoint(
        now_s,
        yaw_rad=yaw_from_quat(q),
        yaw_rate_rad_s=m.body_yaw_rate,
        tilt_rad=tilt_from_quat(q),
        tilt_ned_m_s2=(*horizontal_acceleration(q), 0.0),
        thrust=m.thrust,
    )
