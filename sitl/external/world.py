"""The world around an external vehicle: a pad on its simulator's flat ground, and the score. Pure.

The vehicle's pose is given, so nothing here pushes it: its own simulator has the ground, level and at the
height on which the vehicle stands when it is first seen, disarmed. There lies the pad, flush, whatever height
the scenario gives it. The pad sets off when the vehicle is armed, and is back at its start when that is
disarmed without having flown; it drives by the clock of the vehicle's simulator. Touchdown is when a foot
meets the ground; its own simulator does not carry a vehicle on the pad along, so the pad goes with the
vehicle until it flies again (`TouchedPad`).

NED from where the vehicle was first seen, z = 0 the ground, the vehicle's reference point at its airframe's
standing height over it; SI.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    ned_from_geodetic,
    norm,
    quat_rotate,
    scale,
    subtract,
    tilt_from_quat,
)
from companion.base.messages import Phase, Truth
from companion.config import ConfigError
from companion.pad import load_pad
from sitl.external.pose import JUMP_M, MEMORY_S, Pose, PoseTrack, Sample
from sitl.pad.motion import PadMotion, PadTruth, build_pad_motion
from sitl.scenario.scenario import Scenario, load_airframe
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.contact import NO_CONTACT, REST_SPEED_M_S, STANDING_FEET, ContactLoad
from sitl.world.ground import Obstacles, PadBoard
from sitl.world.score import TouchdownDetector, Verdict, judge

PAD_STREAM: Final = 12  # the bundled world's: the same seed gives the same way of the pad
# A foot this near counts as down: a simulator's ground is level with the first stand to a centimetre, and a
# message in 10 ms of a descent at 0.3 m/s is 3 mm.
CONTACT_M: Final = 0.02
LEVEL_M: Final = 0.01
_LEVEL_EVERY_S: Final = 0.5


class ExternalWorld:
    """A scenario's pad under one seed, and an external vehicle, updated by `see`."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        """Lay the pad out.

        Raises:
            ConfigError: a file that the scenario names cannot be read, or its pad does not stay level with
                the ground.
        """
        airframe = load_airframe(scenario.airframe)
        self._feet = airframe.legs.feet_body_m
        self._standing_m = airframe.legs.standing_height_m()
        self._bounds = scenario.pass_bounds
        self.board = PadBoard.of(load_pad(scenario.pad.name))
        motion = build_pad_motion(
            scenario.pad.motion, 0.0, scenario.pad.heading, np.random.default_rng((seed, PAD_STREAM))
        )
        _check_level(motion, scenario)
        self._obstacles = Obstacles(scenario.obstacles, airframe.body)
        self.track = PoseTrack()
        self._pad = TouchedPad(motion, airframe.legs.friction, self._standing_m, self.track.at)
        self.origin: Vector3 | None = None
        self._forget_flight()

    # ------------------------------------------------------------ in

    def begin(self, ground_place: Vector3) -> None:
        """Put the origin: latitude (deg), longitude (deg) and altitude (m) at which the vehicle stands.

        Whatever was seen about another origin is forgotten; `see` the next pose at once.
        """
        self.origin = ground_place
        self.track.begin_anew()
        self._forget_flight()

    def _forget_flight(self) -> None:
        self.armed = self.flown = False  # flown: it has been in the air, armed
        self._load = NO_CONTACT
        self._in_air: Pose | None = None
        self._last: Pose
        self.watch = TouchdownDetector()
        self._pad.stop()

    def see(self, sample: Sample, *, armed: bool) -> None:
        """Take the vehicle's next pose; `begin` comes first."""
        assert self.origin is not None
        if armed and not self.armed and self._load.touching:
            self.watch.begin_flight()
        self.armed = armed
        north, east, down = ned_from_geodetic(*sample.place, self.origin)
        position = (north, east, down - self._standing_m)
        pose = self.track.put(
            Pose(
                sample.time_s,
                position,
                sample.velocity_ned_m_s,
                sample.attitude,
                sample.rate_body_rad_s,
                sample.simulated_s,
            )
        )
        if armed and not self._pad.departed:
            self._pad.depart(sample.time_s)
        elif not armed and not self.flown:
            self._pad.stop()
        if pose is not None:
            self._touch(pose)

    def _touch(self, pose: Pose) -> None:
        """Feet on the ground, the pad that goes with them, and what the score takes down of it."""
        if self._pad.carries and norm(subtract(pose.position_ned_m, self._last.position_ned_m)) > JUMP_M:
            self._pad.release(self._last.time_s)  # put elsewhere: what stands there takes no pad along
        self._last = pose
        feet = [add(pose.position_ned_m, quat_rotate(pose.attitude, foot)) for foot in self._feet]
        lowest_m = -max(foot[2] for foot in feet)
        pad, touched = self.pad_at(pose.time_s), self._load.touching
        if lowest_m <= CONTACT_M:
            over = sum(self.board.contains(self.board.local(pad, foot)) for foot in feet)
            self._load = ContactLoad(on_board=over, on_ground=len(feet) - over)
        else:
            self._load = NO_CONTACT
            self._in_air = pose
        # the message with the contact has the vehicle already stopped: take the one before
        self.watch.beside(self._obstacles.clearance_m(pose.position_ned_m))
        touches_now = self._load.touching and not touched
        state = self._in_air if touches_now and self._in_air is not None else pose
        self.watch.step(pose.time_s, _body(state), self.pad_at(state.time_s), self._load)
        self.watch.airborne(lowest_m)
        self.flown = self.flown or (self.armed and self.watch.flying)
        if self._load.on_board and self._pad.departed and not self._pad.carries:
            self._pad.touch(state)
        elif not self._load.touching and self._pad.carries:
            self._pad.release(pose.time_s)

    # ------------------------------------------------------------ out

    def pad_at(self, time_s: float) -> PadTruth:
        """The pad at a time of the last second."""
        return self._pad.at(time_s)

    def truth_at(self, time_s: float) -> Truth:
        """Vehicle and pad at a time of the last second.

        Raises:
            ValueError: no pose has come yet.
        """
        pose, pad = self.track.at(time_s), self.pad_at(time_s)
        return Truth(
            time_s=time_s,
            vehicle_position_ned_m=pose.position_ned_m,
            vehicle_velocity_ned_m_s=pose.velocity_ned_m_s,
            vehicle_attitude=pose.attitude,
            pad_position_ned_m=pad.position_ned_m,
            pad_velocity_ned_m_s=pad.velocity_ned_m_s,
            pad_heading_rad=pad.heading_rad,
            in_contact=self._load.touching,
            rate_body_rad_s=pose.rate_body_rad_s,
            attitude_setpoint=pose.attitude,
            obstacle_clearance_m=self._obstacles.clearance_m(pose.position_ned_m),
        )

    def range_m(self, sensor_body_m: Vector3, half_beam_rad: float) -> float | None:
        """First echo (m) from the level ground, or the pad that sank with the vehicle; None: none.

        In a cone about the body's down axis, now.
        """
        pose = self.track.newest
        if pose is None:
            return None
        below = self._pad.sunk_m(pose)
        height = below - (pose.position_ned_m[2] + quat_rotate(pose.attitude, sensor_body_m)[2])
        return height if height > 0.0 and tilt_from_quat(pose.attitude) <= half_beam_rad else None

    @property
    def at_rest_on_pad(self) -> bool:
        """Whether it stands on the board."""
        pose = self.track.newest
        resting = pose is not None and norm(pose.velocity_ned_m_s) <= REST_SPEED_M_S
        return resting and self._load.on_board >= STANDING_FEET

    def judge(self, final_phase: Phase) -> Verdict:
        return judge(
            self.watch,
            self._bounds,
            at_rest_on_pad=self.at_rest_on_pad,
            disarmed=not self.armed,
            final_phase=final_phase,
        )


def _check_level(motion: PadMotion, scenario: Scenario) -> None:
    """Refuse a pad that leaves the ground: the vehicle's own simulator knows no other surface."""
    if scenario.pad.deck is not None:
        raise ConfigError(
            f"scenario '{scenario.name}': pad.deck: expected none, since the ground of an external simulator "
            "is flat and does not heave"
        )
    for k in range(math.ceil(scenario.time_limit_s / _LEVEL_EVERY_S)):
        if abs(motion.at(k * _LEVEL_EVERY_S).position_ned_m[2]) > LEVEL_M:
            raise ConfigError(
                f"scenario '{scenario.name}': its pad leaves the ground (pad.motion "
                f"'{scenario.pad.motion.kind}'); expected one that stays level with it, since the "
                "ground of an external simulator is flat: static, line, circle, figure_8 or random_turns"
            )


def _body(pose: Pose) -> QuadrotorState:
    return QuadrotorState(
        position_ned_m=pose.position_ned_m,
        velocity_ned_m_s=pose.velocity_ned_m_s,
        attitude=pose.attitude,
        rate_body_rad_s=pose.rate_body_rad_s,
    )


# ---------------------------------------------------------------- touched pad
# An external simulator's own ground stops a vehicle that comes down on a moving pad; a real deck would carry
# it. Camera and rangefinder see the same of both: the vehicle at rest over the pad. So from the contact on
# the pad goes where the vehicle goes, message by message: it stops with it. What their speeds differed by at
# the contact is slowed down by the feet's friction, as on a deck. Once the feet are clear it drives on from
# there.
#
# Down as well: the ground of PX4's SIH stops what falls, and lets through what sinks with more thrust than
# its weight (one flight sank 11 cm into it at 0.2 m/s, for 1 s). A pad that stayed would rise through the
# feet, into the camera.
#
# It drives by the clock of the vehicle's simulator: while that stands still, so do both.
#
# NED, SI units. Pure; `at` may be called from another thread than the rest.

PoseAt = Callable[[float], Pose]
_BEFORE_ALL: Final = -math.inf


class _Stretch(NamedTuple):
    """A part of the pad's way, after `since_s`; `phase_s` is how far along its motion it is then, and
    `simulated_s` the time by the vehicle's simulator.

    `displaced_m` is how far vehicles have taken it from that motion. With `contact`, the vehicle's pose then,
    it goes with the vehicle, and at first slides on beneath it by `slip_m_s`. Without, it drives or stands.
    """

    since_s: float = _BEFORE_ALL
    phase_s: float = 0.0
    displaced_m: Vector3 = ZERO3
    drives: bool = False
    contact: Pose | None = None
    slip_m_s: Vector3 = ZERO3
    simulated_s: float = 0.0


class TouchedPad:
    """A pad's motion that a vehicle interrupts; `pose_at` is the vehicle's at a time of the last second."""

    def __init__(self, motion: PadMotion, friction: float, standing_m: float, pose_at: PoseAt) -> None:
        self._motion, self._standing_m, self._pose_at = motion, standing_m, pose_at
        self._slows_m_s2 = friction * GRAVITY_M_S2
        self.stop()

    def stop(self) -> None:
        """Back at its start, where it stands until it departs."""
        self._stretches: tuple[_Stretch, ...] = (_Stretch(),)

    @property
    def departed(self) -> bool:
        return self._stretches[-1].since_s > _BEFORE_ALL

    @property
    def carries(self) -> bool:
        return self._stretches[-1].contact is not None

    def depart(self, time_s: float) -> None:
        self._append(_Stretch(time_s, drives=True, simulated_s=self._simulated_s(time_s)))

    def touch(self, pose: Pose) -> None:
        """Go with the vehicle, whose last pose before the contact this is."""
        pad, last = self.at(pose.time_s), self._stretches[-1]
        north, east, _ = subtract(pad.velocity_ned_m_s, pose.velocity_ned_m_s)
        slip = (north, east, 0.0) if last.drives else ZERO3
        self._append(
            _Stretch(pose.time_s, self._phase_s(last, pose.time_s), last.displaced_m, False, pose, slip)
        )

    def release(self, time_s: float) -> None:
        last = self._stretches[-1]
        displaced = add(last.displaced_m, self._carried_m(last, time_s))
        begun_s = self._simulated_s(time_s)
        self._append(_Stretch(time_s, last.phase_s, displaced, drives=True, simulated_s=begun_s))

    def at(self, time_s: float) -> PadTruth:
        """The pad at a time of the last second."""
        stretches = self._stretches
        stretch = next((s for s in reversed(stretches) if time_s > s.since_s), stretches[0])
        pad = self._motion.at(self._phase_s(stretch, time_s))
        moved = add(pad.position_ned_m, stretch.displaced_m)
        if stretch.drives:
            return pad._replace(position_ned_m=moved)
        velocity = ZERO3
        if stretch.contact is not None:
            pose = self._pose_at(time_s)
            sunk_m = self._sunk_m(stretch, pose)
            moved = add(add(moved, self._carried_m(stretch, time_s)), (0.0, 0.0, sunk_m))
            slows = self._sliding_s(stretch, time_s) * self._slows_m_s2
            north, east, down = pose.velocity_ned_m_s
            carried = (north, east, down if sunk_m > 0.0 else 0.0)
            velocity = add(carried, _shortened(stretch.slip_m_s, slows))
        return pad._replace(
            position_ned_m=moved,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=ZERO3,
            heading_rate_rad_s=0.0,
        )

    def sunk_m(self, pose: Pose) -> float:
        """How far the pad is below the ground, under the vehicle with this newest pose."""
        return self._sunk_m(self._stretches[-1], pose)

    def _sunk_m(self, stretch: _Stretch, pose: Pose) -> float:
        return max(0.0, pose.position_ned_m[2] + self._standing_m) if stretch.contact is not None else 0.0

    def _phase_s(self, stretch: _Stretch, time_s: float) -> float:
        return stretch.phase_s + (self._simulated_s(time_s) - stretch.simulated_s if stretch.drives else 0.0)

    def _simulated_s(self, time_s: float) -> float:
        return self._pose_at(time_s).simulated_s

    def _carried_m(self, stretch: _Stretch, time_s: float) -> Vector3:
        """How far it has gone with the vehicle since the contact, and slid beneath it."""
        assert stretch.contact is not None
        north, east, _ = subtract(self._pose_at(time_s).position_ned_m, stretch.contact.position_ned_m)
        slid_s = self._sliding_s(stretch, time_s)
        mean = _shortened(stretch.slip_m_s, 0.5 * slid_s * self._slows_m_s2)
        return add((north, east, 0.0), scale(mean, slid_s))

    def _sliding_s(self, stretch: _Stretch, time_s: float) -> float:
        """For how long it has slid by then."""
        lasts_s = norm(stretch.slip_m_s) / self._slows_m_s2 if self._slows_m_s2 > 0.0 else math.inf
        return min(max(time_s - stretch.since_s, 0.0), lasts_s)

    def _append(self, stretch: _Stretch) -> None:
        """Keep what may be asked for: a replaced tuple, never a changed one."""
        old = [k for k, s in enumerate(self._stretches) if s.since_s < stretch.since_s - MEMORY_S]
        self._stretches = (*self._stretches[old[-1] if old else 0 :], stretch)


def _shortened(v: Vector3, by: float) -> Vector3:
    length = norm(v)
    return scale(v, max(0.0, 1.0 - by / length)) if length > 0.0 else ZERO3
