"""The world around an external vehicle: a pad on its simulator's flat ground, and the score. Pure.

The vehicle's pose is given, so nothing here pushes it: its own simulator has the ground, level and at the
height on which the vehicle stands when it is first seen, disarmed. There lies the pad, flush, whatever height
the scenario gives it. The pad sets off when the vehicle is armed, and is back at its start when that is
disarmed without having flown; it drives by the clock of the vehicle's simulator. Touchdown is when a foot
meets the ground; its own simulator does not carry a vehicle on the pad along, so the pad goes with the
vehicle until it flies again (`touched_pad`).

NED from where the vehicle was first seen, z = 0 the ground, the vehicle's reference point at its airframe's
standing height over it; SI.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.base.geometry import (
    Vector3,
    add,
    ned_from_geodetic,
    norm,
    quat_rotate,
    subtract,
    tilt_from_quat,
)
from companion.base.messages import Phase, Truth
from companion.config import ConfigError
from companion.pad import load_pad
from sitl.external.pose import JUMP_M, Pose, PoseTrack, Sample
from sitl.external.touched_pad import TouchedPad
from sitl.pad.motion import PadMotion, PadTruth, build_pad_motion
from sitl.scenario.scenario import Scenario, load_airframe
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.contact import NO_CONTACT, ContactLoad
from sitl.world.ground import PadBoard
from sitl.world.obstacles import Obstacles
from sitl.world.score import TouchdownDetector, TouchdownState, Verdict, judge

PAD_STREAM: Final = 12  # the bundled world's: the same seed gives the same way of the pad
# A foot this near counts as down: a simulator's ground is level with the first stand to a centimetre, and a
# message in 10 ms of a descent at 0.3 m/s is 3 mm.
CONTACT_M: Final = 0.02
STANDING_FEET: Final = 3
REST_SPEED_M_S: Final = 0.05
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
        self._pad = TouchedPad(motion, airframe.legs.friction, self.track.at)
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
        self._watch = TouchdownDetector()
        self._pad.stop()

    def see(self, sample: Sample, *, armed: bool) -> None:
        """Take the vehicle's next pose; `begin` comes first."""
        assert self.origin is not None
        if armed and not self.armed and self._load.touching:
            self._watch.begin_flight()
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
        self._watch.beside(self._obstacles.clearance_m(pose.position_ned_m))
        touches_now = self._load.touching and not touched
        state = self._in_air if touches_now and self._in_air is not None else pose
        self._watch.step(pose.time_s, _body(state), self.pad_at(state.time_s), self._load)
        self._watch.airborne(lowest_m)
        self.flown = self.flown or (self.armed and self._watch.flying)
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
        """First echo (m) from the level ground in a cone about the body's down axis, now; None: none."""
        pose = self.track.newest
        if pose is None:
            return None
        height = -(pose.position_ned_m[2] + quat_rotate(pose.attitude, sensor_body_m)[2])
        return height if height > 0.0 and tilt_from_quat(pose.attitude) <= half_beam_rad else None

    @property
    def touchdown(self) -> TouchdownState | None:
        """The last contact, after a flight above 1 m."""
        return self._watch.touchdown

    @property
    def nearest_obstacle_m(self) -> float | None:
        """The least distance from the rotors' tips to an obstacle so far; None without any."""
        return self._watch.nearest_obstacle_m

    @property
    def at_rest_on_pad(self) -> bool:
        """Whether it stands on the board."""
        pose = self.track.newest
        resting = pose is not None and norm(pose.velocity_ned_m_s) <= REST_SPEED_M_S
        return resting and self._load.on_board >= STANDING_FEET

    def judge(self, final_phase: Phase) -> Verdict:
        """The verdict as it stands; `final_phase` is the app's last."""
        return judge(
            self._watch.touchdown,
            self._bounds,
            contacts=self._watch.contacts,
            crashed=self._watch.crashed,
            at_rest_on_pad=self.at_rest_on_pad,
            disarmed=not self.armed,
            final_phase=final_phase,
            nearest_obstacle_m=self._watch.nearest_obstacle_m,
        )


def _check_level(motion: PadMotion, scenario: Scenario) -> None:
    """Refuse a pad that leaves the ground: the vehicle's own simulator knows no other surface.

    Raises:
        ConfigError: it does.
    """
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
