"""The simulated world: one vehicle, one pad and the wind, stepped together.

NED from home, the ground at z = 0; FRD; SI. The app gets it only through the simulated sensors.
"""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    between,
    norm,
    quat_between,
    quat_rotate_inverse,
    subtract,
    wrap_angle,
)
from companion.base.messages import Truth
from companion.pad import load_pad
from sitl.pad.motion import IncidentMotion, PadTruth, build_pad_motion
from sitl.scenario.scenario import Scenario, load_airframe
from sitl.vehicle.quadrotor import Motors, Quadrotor, QuadrotorState, RotorValues, packed, resting_state
from sitl.world.contact import NO_CONTACT, REST_SPEED_M_S, STANDING_FEET, Contact, ContactLoad
from sitl.world.ground import Obstacles, PadBoard, echo_distance_m, rotor_ratios
from sitl.world.score import TouchdownDetector
from sitl.world.wind import Wind

HISTORY_S: Final = 0.35
CLOCK_SLACK_S: Final = 1e-6
REST_RATE_RAD_S: Final = 0.1


class _Stream(IntEnum):
    """Each disturbance draws from its own generator, so that one more draw in one leaves the others be."""

    START = 11
    PAD = 12
    WIND = 13


class _Snapshot(NamedTuple):
    time_s: float
    state: QuadrotorState
    pad: PadTruth
    wind_ned_m_s: Vector3
    in_contact: bool


@dataclass(slots=True)
class Effects:
    """What acts on the vehicle in a step besides motors and weight; disturbances add to it."""

    thrust_ratio: RotorValues  # of each rotor, over that in free air
    wind_ned_m_s: Vector3 = ZERO3
    force_ned_n: Vector3 = ZERO3
    torque_body_n_m: Vector3 = ZERO3


# (effects, dt_s): one disturbance's part of the coming step, from the world as it is now
Disturbance = Callable[[Effects, float], None]


class World:
    """A scenario's world under one seed, from rest at home at time 0.

    `disturbances` act in their order at every step; one more is one more function in the list. `state` is
    the body now, to be changed by `place` alone; `contact` what touched, and how, in the last step.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        """Build it.

        Raises:
            ConfigError: the scenario names an airframe or a pad that cannot be read.
        """
        self.built = built = scenario.built(seed)
        believed = load_airframe(scenario.airframe)
        body = built.body(believed.body)
        airframe = believed.model_copy(
            update={"body": body, "legs": believed.legs.longer(built.leg_height_m)}
        )
        arm, up = body.arm_length_m, -body.rotor_height_m
        self.believed_airframe, self.airframe = believed, airframe
        self.board = PadBoard.of(built.pad(load_pad(scenario.pad.name)))
        self.time_s = 0.0
        self.wind_ned_m_s: Vector3 = (0.0, 0.0, 0.0)
        # stored with the truth for the plots
        self.attitude_setpoint: Quaternion = IDENTITY
        self.motors = Motors(built.thrust_exponent, body.layout.count)
        self._quadrotor = Quadrotor(body, scenario.mass_factor)
        layout = body.layout
        self._rotors = tuple(
            (arm * forward, arm * right, up)
            for forward, right in zip(layout.forward, layout.right, strict=True)
        )
        self._legs = Contact(airframe.legs, body.mass_kg, self.board, self._rotors)
        self._wind = Wind(scenario.wind, np.random.default_rng((seed, _Stream.WIND)))
        pad = scenario.pad
        self.pad_motion = IncidentMotion(
            build_pad_motion(
                pad.motion,
                pad.surface_height_m,
                pad.heading,
                np.random.default_rng((seed, _Stream.PAD)),
                pad.deck,
            ).at
        )
        self.pad_state = self.pad_motion.at(0.0)
        self.state = self._at_home(scenario, np.random.default_rng((seed, _Stream.START)))
        self.contact: ContactLoad = NO_CONTACT
        self._obstacles = Obstacles(scenario.obstacles, body)
        self.watch = TouchdownDetector()
        self._history: deque[_Snapshot] = deque([self._snapshot()])
        self.disturbances: list[Disturbance] = [self._wind_blows, self._legs_stand, self._ground_effect]

    def _at_home(self, scenario: Scenario, rng: np.random.Generator) -> QuadrotorState:
        """Standing on what is at home: the ground, or the pad if that is there."""
        drawn = float(rng.uniform(-math.pi, math.pi))
        fixed = scenario.start_heading_deg
        heading = drawn if fixed == "random" else math.radians(fixed)
        surface = self.board.surface_down_m(self.pad_state, 0.0, 0.0)
        return resting_state(
            (0.0, 0.0, surface - self.landed_reference_height_m), heading, self.airframe.body.layout.count
        )

    def place(self, state: QuadrotorState) -> None:
        """Set the vehicle's state and clear contacts and history: to start in the air."""
        self.state = state
        self.contact = NO_CONTACT
        self._legs.release()
        self.watch = TouchdownDetector(stands=False)
        self.watch.airborne(self.height_m - self.landed_reference_height_m)
        self._history = deque([self._snapshot()])

    # ------------------------------------------------------------ stepping

    def step(self, motor_commands: RotorValues, dt_s: float) -> None:
        """Move everything on by dt (s); commands are the motors' shares of full thrust, 0..1."""
        effects = Effects(self._quadrotor.free_air)
        for disturb in self.disturbances:
            disturb(effects, dt_s)
        self.watch.step(self.time_s, self.state, self.pad_state, self.contact)
        state = self._quadrotor.step(
            self.state,
            self.motors.given(motor_commands),
            dt_s,
            wind_ned_m_s=effects.wind_ned_m_s,
            thrust_ratio=effects.thrust_ratio,
            force_ned_n=effects.force_ned_n,
            torque_body_n_m=effects.torque_body_n_m,
        )
        self._advance(state, dt_s)

    def _advance(self, state: QuadrotorState, dt_s: float) -> None:
        """Advance the time: the vehicle's new state, and the pad's motion."""
        self.state = state
        self.time_s += dt_s
        self.pad_state = self.pad_motion.at(self.time_s)
        self.watch.beside(self._obstacles.clearance_m(state.position_ned_m))
        if not self.watch.flying:
            self.watch.airborne(self.height_m - self.landed_reference_height_m)
        self._record()

    def _wind_blows(self, effects: Effects, dt_s: float) -> None:
        self.wind_ned_m_s = self._wind.at(self.time_s, -self.state.position_ned_m[2])
        effects.wind_ned_m_s = add(effects.wind_ned_m_s, self.wind_ned_m_s)

    def _legs_stand(self, effects: Effects, dt_s: float) -> None:
        # nothing that could be touched lies less beneath
        clear_m = self.board.ceiling_down_m(self.pad_state) - self.state.position_ned_m[2]
        if clear_m <= self._legs.reach_m:
            self.contact = self._legs.step(self.state, self.pad_state, dt_s)
            effects.force_ned_n = add(effects.force_ned_n, self.contact.force_ned_n)
            effects.torque_body_n_m = add(effects.torque_body_n_m, self.contact.torque_body_n_m)
        elif self.contact is not NO_CONTACT:
            self._legs.release()
            self.contact = NO_CONTACT

    def _ground_effect(self, effects: Effects, dt_s: float) -> None:
        effects.thrust_ratio = rotor_ratios(
            self.state, self._rotors, self.airframe.body.rotor_radius_m, self.board, self.pad_state
        )

    def _snapshot(self) -> _Snapshot:
        return _Snapshot(self.time_s, self.state, self.pad_state, self.wind_ned_m_s, self.contact.touching)

    def _record(self) -> None:
        self._history.append(self._snapshot())
        while self._history[1].time_s < self.time_s - HISTORY_S:
            self._history.popleft()

    # ------------------------------------------------------------ for sensors

    @property
    def height_m(self) -> float:
        """Height of the reference point over what lies under it."""
        north, east, down = self.state.position_ned_m
        return self.board.surface_down_m(self.pad_state, north, east) - down

    def deck_field_ned_ut(self) -> Vector3:
        if not self.pad_state.is_there:
            return ZERO3
        away = subtract(self.state.position_ned_m, self.pad_state.position_ned_m)
        return self.built.deck_field_at(norm(away))

    @property
    def feet_over_pad_m(self) -> float | None:
        """Height of the feet over the pad's surface, 0 as soon as one touches; None before the flight and
        beside the pad."""
        north, east, down = self.state.position_ned_m
        if not self.watch.flown or not self.board.is_under(self.pad_state, self.state.position_ned_m):
            return None
        over_m = self.board.surface_down_m(self.pad_state, north, east) - down
        # feet that bear a part of the weight are pressed in less than those of the height they stand at
        return 0.0 if self.contact.on_board else over_m - self.landed_reference_height_m

    @property
    def landed_reference_height_m(self) -> float:
        """Height of the reference point over the surface when standing."""
        return self.airframe.legs.standing_height_m()

    def ranging(self, sensor_position_body_m: Vector3, half_angle_rad: float) -> Callable[[], float | None]:
        """Distance (m) of the first echo in a cone about the body's down axis, None without an echo.

        It is computed when called, from the present state.
        """
        return partial(
            echo_distance_m, self.board, self.pad_state, self.state, sensor_position_body_m, half_angle_rad
        )

    # ------------------------------------------------------------ for the score and the camera

    @property
    def at_rest_on_pad(self) -> bool:
        """Whether it stands at rest relative to the board."""
        state, pad = self.state, self.pad_state
        carried = pad.velocity_at_ned_m_s(state.position_ned_m)
        still = norm(subtract(state.velocity_ned_m_s, carried)) <= REST_SPEED_M_S
        turned = quat_rotate_inverse(state.attitude, pad.rate_ned_rad_s())
        steady = norm(subtract(state.rate_body_rad_s, turned)) <= REST_RATE_RAD_S
        return self.contact.on_board >= STANDING_FEET and still and steady

    def truth(self) -> Truth:
        return self._truth_of(self._history[-1])

    def truth_at(self, time_s: float) -> Truth:
        """Everything at a time up to 0.3 s back, interpolated; before the start all stood as at the start.

        Raises:
            ValueError: the time lies ahead, or further back than is kept.
        """
        memory = self._history
        i = bisect_left(memory, time_s - CLOCK_SLACK_S, key=lambda snapshot: snapshot.time_s)
        if i == len(memory) or (i == 0 and memory[0].time_s > max(time_s, 0.0) + CLOCK_SLACK_S):
            raise ValueError(
                f"no truth at {time_s:.4f} s: kept from {memory[0].time_s:.4f} to {self.time_s:.4f} s"
            )
        if i == 0:
            return self._truth_of(memory[0])
        return self._truth_of(_between(memory[i - 1], memory[i], time_s))

    def _truth_of(self, snapshot: _Snapshot) -> Truth:
        return Truth(
            time_s=snapshot.time_s,
            vehicle_position_ned_m=snapshot.state.position_ned_m,
            vehicle_velocity_ned_m_s=snapshot.state.velocity_ned_m_s,
            vehicle_attitude=snapshot.state.attitude,
            pad_position_ned_m=snapshot.pad.position_ned_m,
            pad_velocity_ned_m_s=snapshot.pad.velocity_ned_m_s,
            pad_heading_rad=snapshot.pad.heading_rad,
            pad_roll_rad=snapshot.pad.roll_rad,
            pad_pitch_rad=snapshot.pad.pitch_rad,
            wind_ned_m_s=snapshot.wind_ned_m_s,
            in_contact=snapshot.in_contact,
            rate_body_rad_s=snapshot.state.rate_body_rad_s,
            attitude_setpoint=self.attitude_setpoint,
            obstacle_clearance_m=self._obstacles.clearance_m(snapshot.state.position_ned_m),
        )


def _between(a: _Snapshot, b: _Snapshot, time_s: float) -> _Snapshot:
    """Straight between two neighbouring steps; at 2.5 ms a chord and an arc differ by nothing that shows."""
    k = min(1.0, max(0.0, (time_s - a.time_s) / (b.time_s - a.time_s)))
    p, q = a.state, b.state
    state = QuadrotorState(
        position_ned_m=between(p.position_ned_m, q.position_ned_m, k),
        velocity_ned_m_s=between(p.velocity_ned_m_s, q.velocity_ned_m_s, k),
        attitude=quat_between(p.attitude, q.attitude, k),
        rate_body_rad_s=between(p.rate_body_rad_s, q.rate_body_rad_s, k),
    )
    turned = wrap_angle(b.pad.heading_rad - a.pad.heading_rad)
    pad = b.pad._replace(
        position_ned_m=between(a.pad.position_ned_m, b.pad.position_ned_m, k),
        velocity_ned_m_s=between(a.pad.velocity_ned_m_s, b.pad.velocity_ned_m_s, k),
        heading_rad=wrap_angle(a.pad.heading_rad + k * turned),
        roll_rad=a.pad.roll_rad + k * (b.pad.roll_rad - a.pad.roll_rad),
        pitch_rad=a.pad.pitch_rad + k * (b.pad.pitch_rad - a.pad.pitch_rad),
    )
    return _Snapshot(time_s, state, pad, b.wind_ned_m_s, b.in_contact)


# ---------------------------------------------------------------- firm ground
# A world with the ground that ArduPilot's SITL and PX4's SIH have: it stops dead what comes down on it.
#
# Theirs is level, acts at the reference point and not at the feet, and knows no pad that would carry the
# vehicle along: in one step a vehicle that reaches it has no velocity any more, and the accelerometer feels
# that step. ArduPilot's levels the vehicle besides, PX4's leaves its attitude alone; here it stays. For a
# vehicle that plays an external one. NED, FRD, SI.

_STANDS = ContactLoad(on_ground=STANDING_FEET)


class FirmGroundWorld(World):
    """A scenario's world under one seed, whose surface stops the vehicle instead of its legs."""

    def _legs_stand(self, effects: Effects, dt_s: float) -> None:
        """The legs bear nothing: `_advance` sets the load."""

    def _advance(self, state: QuadrotorState, dt_s: float) -> None:
        """Stop what would sink below the height that it stands at."""
        north, east, down = state.position_ned_m
        standing_m = self.board.surface_down_m(self.pad_state, north, east) - self.landed_reference_height_m
        self.contact = NO_CONTACT
        if down >= standing_m and state.velocity_ned_m_s[2] >= 0.0:
            self.contact = _STANDS
            old = self.state
            x, y, _ = old.position_ned_m
            stopped = (0.0, 0.0, 0.0, *old.attitude, 0.0, 0.0, 0.0)
            state = packed(old, (x, y, standing_m), stopped, state.thrust_share, dt_s)
        super()._advance(state, dt_s)
