"""Legs on ground or board: spring-dampers with Coulomb friction, at points fixed to the airframe.

NED for places and forces, FRD for points on the body and the torque; SI.

Each point in contact pushes up with a spring and a damper, never pulls, and is held sideways by a second
spring from where it first stood (its anchor, which rides and turns with the board) up to the friction
cone, beyond which it slides and takes the anchor along. So a landed vehicle rides along without creeping.
The forces are taken where the points will be half a step later: a spring so stepped neither gains nor loses
energy (the leapfrog), so the legs' own damping decides, at 400 Hz with room to spare.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import Field

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    cross,
    norm,
    quat_rotate,
    quat_rotate_inverse,
    scale,
    subtract,
)
from companion.config import StrictModel
from sitl.pad.motion import PadTruth
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.ground import PadBoard

Metres = Annotated[float, Field(ge=-2.0, le=2.0)]
Place = tuple[Metres, Metres, Annotated[float, Field(gt=0.0, le=2.0)]]
Surface = Literal["board", "ground"]
# a vehicle stands by so many feet, and is at rest below this speed against what it stands on
STANDING_FEET: Final = 3
REST_SPEED_M_S: Final = 0.05
# A point that is this deep under the board's top did not come from above: it is beside or beneath it.
DEEPEST_ENTRY_M: Final = 0.02
MARGIN_M: Final = 0.05


class ContactParameters(StrictModel):
    """The legs; feet are where they are when the vehicle stands, the springs being loaded."""

    feet_body_m: tuple[Place, Place, Place, Place]
    stiffness_n_m: float = Field(ge=100.0, le=20000.0)
    damping_n_s_m: float = Field(ge=0.0, le=200.0)
    friction: float = Field(ge=0.0, le=2.0)
    sideways_stiffness_n_m: float = Field(ge=100.0, le=20000.0)
    sideways_damping_n_s_m: float = Field(ge=0.0, le=200.0)

    def longer(self, by_m: float) -> ContactParameters:
        """The same legs, but so much longer."""
        if by_m == 0.0:
            return self
        a, b, c, d = ((x, y, z + by_m) for x, y, z in self.feet_body_m)
        return self.model_copy(update={"feet_body_m": (a, b, c, d)})

    def standing_height_m(self) -> float:
        """Height of the reference point over the surface when the vehicle stands."""
        return self.feet_body_m[0][2]


@dataclass(frozen=True, slots=True)
class ContactLoad:
    """Force and torque of the surfaces on the body, and how many points touch which."""

    force_ned_n: Vector3 = ZERO3
    torque_body_n_m: Vector3 = ZERO3
    on_board: int = 0
    on_ground: int = 0

    @property
    def touching(self) -> bool:
        return self.on_board + self.on_ground > 0


NO_CONTACT: Final = ContactLoad()


@dataclass(slots=True)
class _Point:
    """A point of the body that can touch, what it touches, and its anchor in that surface's axes."""

    body_m: Vector3
    surface: Surface | None = None
    anchor_m: tuple[float, float] = field(default=(0.0, 0.0))


class Contact:
    """Contact forces of the legs; stores which foot stands where."""

    def __init__(
        self, parameters: ContactParameters, mass_kg: float, board: PadBoard, hull_body_m: tuple[Vector3, ...]
    ) -> None:
        """`mass_kg` is the mass under which the feet stand as the parameters say; `hull_body_m` are further
        points (the rotors' hubs) that touch when the vehicle lies on its side or back."""
        sag = mass_kg * GRAVITY_M_S2 / (4.0 * parameters.stiffness_n_m)
        feet = ((x, y, z + sag) for x, y, z in parameters.feet_body_m)
        self._p = parameters
        self._board = board
        self._points = [_Point(point) for point in (*feet, *hull_body_m)]
        # as far over all surfaces nothing touches within a step
        self.reach_m = max(norm(point.body_m) for point in self._points) + MARGIN_M

    def step(self, state: QuadrotorState, pad: PadTruth, dt_s: float) -> ContactLoad:
        """The load for the coming step of dt."""
        half = 0.5 * dt_s
        clear_m = self._board.ceiling_down_m(pad) - state.position_ned_m[2]
        w, x, y, z = state.attitude
        # the body's axes' shares downwards: most points are too high to touch
        down_x, down_y, down_z = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        extrapolated = pad.extrapolated(half)
        force, torque, touched = ZERO3, ZERO3, {"board": 0, "ground": 0}
        for point in self._points:
            px, py, pz = point.body_m
            if down_x * px + down_y * py + down_z * pz < clear_m - MARGIN_M:
                point.surface = None
                continue
            push = self._push(point, state, extrapolated, half)
            if point.surface is not None:
                touched[point.surface] += 1
                force = add(force, push)
                arm = quat_rotate_inverse(state.attitude, push)
                torque = add(torque, cross(point.body_m, arm))
        if not touched["board"] + touched["ground"]:
            return NO_CONTACT
        return ContactLoad(force, torque, touched["board"], touched["ground"])

    def release(self) -> None:
        for point in self._points:
            point.surface = None

    def _push(self, point: _Point, state: QuadrotorState, pad: PadTruth, ahead_s: float) -> Vector3:
        """Force NED on one point; notes what it touches."""
        arm = quat_rotate(state.attitude, point.body_m)
        velocity = add(
            state.velocity_ned_m_s, quat_rotate(state.attitude, cross(state.rate_body_rad_s, point.body_m))
        )
        place = add(add(state.position_ned_m, arm), scale(velocity, ahead_s))
        local = self._board.local(pad, place)
        if pad.is_there and self._stands_on_board(point, local):
            return self._on_board(point, place, local, velocity, pad)
        if place[2] > 0.0:
            return self._pressed(point, "ground", (place[0], place[1]), place[2], velocity)
        point.surface = None
        return ZERO3

    def _stands_on_board(self, point: _Point, local: Vector3) -> bool:
        depth = local[2]
        if depth <= 0.0 or (point.surface != "board" and depth > DEEPEST_ENTRY_M):
            return False
        return self._board.contains(local)

    def _on_board(
        self, point: _Point, place: Vector3, local: Vector3, velocity: Vector3, pad: PadTruth
    ) -> Vector3:
        """The same in the board's own axes, in which it neither moves nor turns."""
        axes = pad.axes()
        relative = axes.from_ned(subtract(velocity, pad.velocity_at_ned_m_s(place)))
        return axes.to_ned(self._pressed(point, "board", (local[0], local[1]), local[2], relative))

    def _pressed(
        self, point: _Point, surface: Surface, place: tuple[float, float], depth: float, velocity: Vector3
    ) -> Vector3:
        """Force in the surface's axes on a point at `place`, `depth` under it; moves the anchor."""
        p = self._p
        if point.surface != surface:
            point.surface, point.anchor_m = surface, place
        normal = max(0.0, p.stiffness_n_m * depth + p.damping_n_s_m * velocity[2])
        k, c = p.sideways_stiffness_n_m, p.sideways_damping_n_s_m
        x = -k * (place[0] - point.anchor_m[0]) - c * velocity[0]
        y = -k * (place[1] - point.anchor_m[1]) - c * velocity[1]
        pull, held = math.hypot(x, y), p.friction * normal
        if pull > held:
            x, y = x * held / pull, y * held / pull
            point.anchor_m = (place[0] + x / k, place[1] + y / k)
        return (x, y, -normal)
