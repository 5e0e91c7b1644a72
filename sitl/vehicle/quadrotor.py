"""The airframe: a rigid body with lagging rotors, drag and rotor gyroscopics (paper eqs. 5-8).

Frames: NED and FRD; where the rotors are: `RotorLayout`. Units are SI; a motor command is 0..1.

The paper writes eqs. (5)(6) z-up and in small-angle Euler rates. Here they are in vector form,
    I w' = torque - w x (I w + h),   h = (0, 0, J_TP (-W1 + W2 - W3 + W4)),
whose gyroscopic part is (-q h, +p h, 0): roll and pitch have opposite signs, which the paper's text misses.

Thrust, contact, wind and the rotational drag are held over a step; within it drag and rotation are integrated
by RK4. It all runs on plain floats, because arrays of three cost ten times as much.

Thrust changes with the air through the rotors. By blade-element theory a rotor loses thrust in proportion
to its speed and to the flow along its shaft beyond that of hover: the vehicle's own through the air, and the
wake's by Glauert's momentum equation, T = 2 rho A v sqrt(V_edge^2 + (V_climb + v)^2). A vehicle that climbs
loses thrust, one that flies edgewise gains it (J. G. Leishman, Principles of Helicopter Aerodynamics, 2nd
ed., 2.14, 3.5). The wake settles within some 5 ms and has no state of its own.
"""

import math
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Final, Literal

from pydantic import Field

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_euler,
    quat_normalise,
    quat_rotate_inverse,
)
from companion.config import StrictModel

LayoutName = Literal["quad_plus", "quad_x", "hexa", "octa"]
RotorValues = tuple[float, ...]
"""One value a rotor: commands (0..1), thrust shares, factors."""


@dataclass(frozen=True, slots=True)
class RotorLayout:
    """Unit places forward and right of the centre, and the sign of each one's reaction torque (FRD).

    Rotors are numbered clockwise from the front, seen from above; neighbours turn against one another, the
    first anticlockwise.
    """

    forward: RotorValues
    right: RotorValues
    turns: RotorValues

    @property
    def count(self) -> int:
        return len(self.turns)

    @property
    def tilting(self) -> float:
        """What a unit of command along `right` makes of roll, in motors at one arm; of pitch alike."""
        return sum(right * right for right in self.right)

    def momentum(self, speeds: RotorValues) -> float:
        """Sum of the speeds about the down axis: those that turn clockwise less the others."""
        total = 0.0
        for speed in speeds[1::2]:
            total += speed
        for speed in speeds[::2]:
            total -= speed
        return total


def _ring(count: int, first_deg: float) -> RotorLayout:
    angles = [math.radians(first_deg + 360.0 * k / count) for k in range(count)]
    turns = tuple(1.0 if k % 2 == 0 else -1.0 for k in range(count))
    return RotorLayout(tuple(map(math.cos, angles)), tuple(map(math.sin, angles)), turns)


LAYOUTS: Final[dict[LayoutName, RotorLayout]] = {
    "quad_plus": RotorLayout((1.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, -1.0), (1.0, -1.0, 1.0, -1.0)),
    "quad_x": _ring(4, 45.0),
    "hexa": _ring(6, 0.0),
    "octa": _ring(8, 22.5),
}


Positive = Annotated[float, Field(gt=1e-5, le=10.0)]
AIR_DENSITY_KG_M3 = 1.225

# velocity NED, quaternion w x y z, body rate: what forces depend on
Moving = tuple[float, float, float, float, float, float, float, float, float, float]
# what stays the same within a step: wind, drags, accelerations and coupling, see Quadrotor.step
_Held = tuple[float, ...]


class QuadrotorParameters(StrictModel):
    """The plant's numbers; where they come from stands in configs/airframes/x500.yaml."""

    mass_kg: float = Field(gt=0.1, le=20.0)
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    arm_length_m: float = Field(gt=0.03, le=1.0)
    rotor_height_m: float = Field(ge=-0.2, le=0.3)
    rotor_radius_m: float = Field(gt=0.02, le=0.5)
    max_thrust_n: float = Field(gt=0.1, le=200.0)
    max_rotor_speed_rad_s: float = Field(gt=100.0, le=5000.0)
    torque_to_thrust_m: float = Field(gt=0.0, le=0.1)
    motor_rise_s: float = Field(gt=0.001, le=0.5)
    motor_fall_s: float = Field(gt=0.001, le=0.5)
    rotor_inertia_kg_m2: float = Field(ge=0.0, le=0.01)
    rotor_drag_plane_n_s2_m_rad: float = Field(ge=0.0, le=0.01)
    rotor_inflow_loss_n_s2_m_rad: float = Field(ge=0.0, le=0.01)
    body_drag_area_m2: float = Field(ge=0.0, le=1.0)
    linear_drag_n_s_m: float = Field(default=0.0, ge=0.0, le=10.0)
    turning_drag_n_m_s: float = Field(default=0.0, ge=0.0, le=1.0)
    rotors: LayoutName = "quad_plus"

    @property
    def layout(self) -> RotorLayout:
        return LAYOUTS[self.rotors]

    def hover_share(self) -> float:
        """Share of full thrust that carries the weight."""
        return self.mass_kg * GRAVITY_M_S2 / (self.layout.count * self.max_thrust_n)


@dataclass(slots=True)
class QuadrotorState:
    """The body at one time.

    `specific_force_body_m_s2` is what an ideal accelerometer at the centre of mass makes of the step just
    taken: the mean of all forces but gravity, contact included, over the mass. `angular_acceleration_body`
    is that step's mean too; with both, sensors can sit off-centre.
    """

    position_ned_m: Vector3
    velocity_ned_m_s: Vector3 = ZERO3
    attitude: Quaternion = IDENTITY
    rate_body_rad_s: Vector3 = ZERO3
    thrust_share: RotorValues = (0.0, 0.0, 0.0, 0.0)
    specific_force_body_m_s2: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)
    angular_acceleration_body_rad_s2: Vector3 = ZERO3


def resting_state(position_ned_m: Vector3, heading_rad: float, rotors: int = 4) -> QuadrotorState:
    attitude = quat_from_euler(0.0, 0.0, heading_rad)
    return QuadrotorState(position_ned_m=position_ned_m, attitude=attitude, thrust_share=(0.0,) * rotors)


class Quadrotor:
    """One airframe: turns a state, commands and loads into the state a step later. Holds no state itself."""

    def __init__(self, parameters: QuadrotorParameters, mass_factor: float = 1.0) -> None:
        """`mass_factor` scales mass and inertia: a load that the autopilot does not know."""
        self.parameters = parameters
        self._layout = parameters.layout
        self.free_air: RotorValues = (1.0,) * self._layout.count
        self.mass_kg = parameters.mass_kg * mass_factor
        ix, iy, iz = (mass_factor * value for value in parameters.inertia_kg_m2)
        self._inertia = (ix, iy, iz)
        self._coupling = ((iy - iz) / ix, (iz - ix) / iy, (ix - iy) / iz)
        self._body_drag = 0.5 * AIR_DENSITY_KG_M3 * parameters.body_drag_area_m2 / self.mass_kg
        speed = parameters.max_rotor_speed_rad_s
        self._plane_drag = parameters.rotor_drag_plane_n_s2_m_rad * speed / self.mass_kg
        self._inflow_loss = parameters.rotor_inflow_loss_n_s2_m_rad * speed / self._layout.count
        self._disc = 2.0 * AIR_DENSITY_KG_M3 * math.pi * parameters.rotor_radius_m**2
        self._linear_drag = parameters.linear_drag_n_s_m / self.mass_kg
        self._momentum = parameters.rotor_inertia_kg_m2 * speed
        self._lag_dt_s = 0.0
        self._rise = self._fall = (0.0, 0.0)

    def step(
        self,
        state: QuadrotorState,
        commands: RotorValues,
        dt_s: float,
        *,
        wind_ned_m_s: Vector3 = ZERO3,
        thrust_ratio: RotorValues | None = None,
        force_ned_n: Vector3 = ZERO3,
        torque_body_n_m: Vector3 = ZERO3,
    ) -> QuadrotorState:
        """The state dt later.

        Args:
            state: the state now.
            commands: share of full thrust commanded to each motor; clipped to 0..1.
            dt_s: step (s), a few milliseconds.
            wind_ned_m_s: motion of the air.
            thrust_ratio: each rotor's thrust over that in free air (ground effect); none: in free air.
            force_ned_n: further force at the centre of mass (contact).
            torque_body_n_m: further torque.
        """
        share, mean = self._spin(state.thrust_share, commands, dt_s)
        speeds, thrust, spin, torque = self._rotors(
            state.thrust_share, share, mean, thrust_ratio or self.free_air, dt_s
        )
        thrust -= self._lost(state, wind_ned_m_s, thrust, speeds)
        ix, iy, iz = self._inertia
        drag, (p, q, r) = self.parameters.turning_drag_n_m_s, state.rate_body_rad_s
        held: _Held = (
            *wind_ned_m_s,
            self._plane_drag * speeds,
            self._linear_drag,
            self._body_drag,
            thrust / self.mass_kg,
            force_ned_n[0] / self.mass_kg,
            force_ned_n[1] / self.mass_kg,
            force_ned_n[2] / self.mass_kg + GRAVITY_M_S2,
            spin / ix,
            spin / iy,
            (torque[0] + torque_body_n_m[0] - drag * p) / ix,
            (torque[1] + torque_body_n_m[1] - drag * q) / iy,
            (torque[2] + torque_body_n_m[2] - drag * r) / iz,
            *self._coupling,
        )
        x = state.velocity_ned_m_s + state.attitude + state.rate_body_rad_s
        return packed(state, *_rk4(state.position_ned_m, x, held, dt_s), share, dt_s)

    def _lost(self, state: QuadrotorState, wind: Vector3, thrust_n: float, speeds: float) -> float:
        """Thrust (N) that all rotors lose to the air through them; negative: gained.

        All share one wake. Its speed solves momentum against blade element by Newton's method, from above:
        the excess is convex there, so it falls to the one solution in which the wake goes down. A descent
        faster than hover's wake meets its own vortex ring, where the theory does not hold: it gains no more.
        """
        if not self._inflow_loss or thrust_n <= 0.0:
            return 0.0
        (vn, ve, vd), (wn, we, wd), (w, a, b, c) = state.velocity_ned_m_s, wind, state.attitude
        n, e, d = vn - wn, ve - we, vd - wd
        climb = -(2.0 * (a * c + w * b) * n + 2.0 * (b * c - w * a) * e + (1.0 - 2.0 * (a * a + b * b)) * d)
        edge_2 = max(0.0, n * n + e * e + d * d - climb * climb)
        slope, each = self._inflow_loss * speeds, thrust_n / self._layout.count
        hover = sqrt(each / self._disc)
        climb = max(-hover, climb)
        wake = hover - min(0.0, climb)
        for _ in range(3):
            along = climb + wake
            flow = sqrt(edge_2 + along * along) + 1e-9
            excess = self._disc * wake * flow - each + slope * (along - hover)
            wake -= excess / (self._disc * (flow + wake * along / flow) + slope)
        return slope * (climb + wake - hover) * self._layout.count

    def _spin(
        self, share: RotorValues, commands: RotorValues, dt_s: float
    ) -> tuple[RotorValues, RotorValues]:
        """Thrust shares after dt, and their means over it, of a first-order lag solved exactly."""
        if dt_s != self._lag_dt_s:
            self._lag_dt_s = dt_s
            self._rise = _lag(self.parameters.motor_rise_s, dt_s)
            self._fall = _lag(self.parameters.motor_fall_s, dt_s)
        rise, fall = self._rise, self._fall
        spun, means = [], []
        for old, command in zip(share, commands, strict=True):
            target = 0.0 if command < 0.0 else 1.0 if command > 1.0 else command
            end, mean = rise if target > old else fall
            gap = old - target
            spun.append(target + gap * end)
            means.append(target + gap * mean)
        return tuple(spun), tuple(means)

    def _rotors(
        self, old: RotorValues, new: RotorValues, mean: RotorValues, ratio: RotorValues, dt_s: float
    ) -> tuple[float, float, float, Vector3]:
        """Eq. (5) in FRD over a step: sum of speeds over the full one, thrust (N), rotor momentum, torque."""
        p, layout = self.parameters, self._layout
        full, arm = p.max_thrust_n, p.arm_length_m
        # speed is proportional to the root of thrust
        speeds = tuple(map(sqrt, new))
        spin = self._momentum * layout.momentum(speeds)
        before = layout.momentum(tuple(map(sqrt, old)))
        spinning_up = (spin - self._momentum * before) / dt_s
        turned = speed = thrust = roll = pitch = 0.0
        # the ground changes a rotor's thrust, not its reaction torque
        for share, more, one, turn, forward, right in zip(
            mean, ratio, speeds, layout.turns, layout.forward, layout.right, strict=True
        ):
            own = share * more * full
            turned, speed, thrust = turned + turn * share, speed + one, thrust + own
            roll, pitch = roll - right * own, pitch + forward * own
        reaction = p.torque_to_thrust_m * full * turned
        return speed, thrust, spin, (arm * roll, arm * pitch, reaction - spinning_up)


def _lag(time_constant_s: float, dt_s: float) -> tuple[float, float]:
    """What is left of a gap at the end of a step, and on the mean over it."""
    end = math.exp(-dt_s / time_constant_s)
    return end, (1.0 - end) * time_constant_s / dt_s


def _slope(x: Moving, k: Moving, h: float, held: _Held) -> Moving:
    """Eqs. (6)-(8) at x + h k: how velocity, attitude and rate change, by Newton, Euler, q' = q * (0, w) / 2.

    A rotor drags in its plane only: as if along every axis, less the part along the shaft. So of the rotation
    only the body's down axis in NED is needed.
    """
    vn, ve, vd, w, a, b, c, p, q, r = x
    kn, ke, kd, kw, ka, kb, kc, kp, kq, kr = k
    wn, we, wd, plane, linear, body, thrust, fn, fe, fd, hx, hy, tx, ty, tz, jx, jy, jz = held
    w, a, b, c = w + h * kw, a + h * ka, b + h * kb, c + h * kc
    p, q, r = p + h * kp, q + h * kq, r + h * kr
    an, ae, ad = vn + h * kn - wn, ve + h * ke - we, vd + h * kd - wd
    dn, de, dd = 2.0 * (a * c + w * b), 2.0 * (b * c - w * a), 1.0 - 2.0 * (a * a + b * b)
    drag = plane + linear + body * sqrt(an * an + ae * ae + ad * ad)
    along = plane * (dn * an + de * ae + dd * ad) - thrust
    return (
        along * dn - drag * an + fn,
        along * de - drag * ae + fe,
        along * dd - drag * ad + fd,
        -0.5 * (a * p + b * q + c * r),
        0.5 * (w * p + b * r - c * q),
        0.5 * (w * q + c * p - a * r),
        0.5 * (w * r + a * q - b * p),
        tx + (jx * r - hx) * q,
        ty + (jy * r + hy) * p,
        tz + jz * p * q,
    )


def _rk4(place: Vector3, x: Moving, held: _Held, dt_s: float) -> tuple[Vector3, Moving]:
    """One classical Runge-Kutta step; nothing depends on the place, whose slope is the velocity."""
    half, h = 0.5 * dt_s, dt_s / 6.0
    a = _slope(x, x, 0.0, held)
    b = _slope(x, a, half, held)
    c = _slope(x, b, half, held)
    a0, a1, a2, a3, a4, a5, a6, a7, a8, a9 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8, b9 = b
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = c
    d0, d1, d2, d3, d4, d5, d6, d7, d8, d9 = _slope(x, c, dt_s, held)
    x0, x1, x2, x3, x4, x5, x6, x7, x8, x9 = x
    return (
        place[0] + dt_s * (x0 + h * (a0 + b0 + c0)),
        place[1] + dt_s * (x1 + h * (a1 + b1 + c1)),
        place[2] + dt_s * (x2 + h * (a2 + b2 + c2)),
    ), (
        x0 + h * (a0 + 2.0 * (b0 + c0) + d0),
        x1 + h * (a1 + 2.0 * (b1 + c1) + d1),
        x2 + h * (a2 + 2.0 * (b2 + c2) + d2),
        x3 + h * (a3 + 2.0 * (b3 + c3) + d3),
        x4 + h * (a4 + 2.0 * (b4 + c4) + d4),
        x5 + h * (a5 + 2.0 * (b5 + c5) + d5),
        x6 + h * (a6 + 2.0 * (b6 + c6) + d6),
        x7 + h * (a7 + 2.0 * (b7 + c7) + d7),
        x8 + h * (a8 + 2.0 * (b8 + c8) + d8),
        x9 + h * (a9 + 2.0 * (b9 + c9) + d9),
    )


def packed(old: QuadrotorState, place: Vector3, x: Moving, share: RotorValues, dt_s: float) -> QuadrotorState:
    """The new state with a unit quaternion, and the step's mean specific force and angular acceleration.

    Args:
        old: the state dt before.
        place: position NED (m) now.
        x: velocity, quaternion (of any length; as near to the old one as it turned) and body rate now.
        share: the motors' shares of full thrust now.
        dt_s: the step (s).
    """
    vn, ve, vd, w, a, b, c, p, q, r = x
    n, rate = 1.0 / sqrt(w * w + a * a + b * b + c * c), 1.0 / dt_s
    w, a, b, c = w * n, a * n, b * n, c * n
    (un, ue, ud), (p0, q0, r0) = old.velocity_ned_m_s, old.rate_body_rad_s
    w0, a0, b0, c0 = old.attitude
    force_ned = ((vn - un) * rate, (ve - ue) * rate, (vd - ud) * rate - GRAVITY_M_S2)
    # the two unit quaternions' mean stands half-way; they are too close to need a sign check
    halfway = quat_normalise((w0 + w, a0 + a, b0 + b, c0 + c))
    return QuadrotorState(
        place,
        (vn, ve, vd),
        (w, a, b, c),
        (p, q, r),
        share,
        quat_rotate_inverse(halfway, force_ned),
        ((p - p0) * rate, (q - q0) * rate, (r - r0) * rate),
    )


# ---------------------------------------------------------------- actuators
# A worn propeller, a tired speed controller or a battery's sagging voltage costs thrust and reaction torque
# alike, so the command itself is scaled, before the motor's lag.


class Motors:
    """One after another from the front clockwise, the first is 1."""

    def __init__(self, thrust_exponent: float = 1.0, count: int = 4) -> None:
        """Thrust goes with the command to this power."""
        self.count, self._exponent = count, thrust_exponent
        self.clear_faults()

    def clear_faults(self) -> None:
        """All motors give the commanded thrust."""
        self._shares: RotorValues | None = None

    def weaken(self, motor: int | None, share: float) -> None:
        """One motor, or all for None, gives only this share of what it gave."""
        shares = self._shares or (1.0,) * self.count
        self._shares = tuple(
            own * share if motor in (None, number) else own for number, own in enumerate(shares, start=1)
        )

    def given(self, commands: RotorValues) -> RotorValues:
        """The effective commands (shares of full thrust)."""
        if self._exponent != 1.0:
            commands = tuple(min(1.0, max(0.0, c)) ** self._exponent for c in commands)
        if self._shares is None:
            return commands
        return tuple(own * command for own, command in zip(self._shares, commands, strict=True))
