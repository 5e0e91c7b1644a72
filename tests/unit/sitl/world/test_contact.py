"""Legs on ground and on a moving board."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    quat_from_euler,
    quat_rotate_inverse,
    tilt_from_quat,
)
from sitl.pad.motion import PadTruth
from sitl.scenario.scenario import load_airframe
from sitl.vehicle.quadrotor import Quadrotor, QuadrotorState, RotorValues
from sitl.world.contact import NO_CONTACT, Contact
from sitl.world.ground import PadBoard

DT = 0.0025
X500 = load_airframe("x500")
STAND = X500.legs.standing_height_m()
OFF: RotorValues = (0.0, 0.0, 0.0, 0.0)
BOARD = PadBoard(0.65, 0.65)
HUBS = tuple((0.25 * x, 0.25 * y, -0.05) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)))

Pad = Callable[[float], PadTruth]


def nowhere(t: float) -> PadTruth:
    return PadTruth(t, (100.0, 0.0, -0.1), ZERO3, ZERO3, 0.0, 0.0)


def driving(speed: float, height: float = 0.3, course: float = 0.6) -> Pad:
    c, s = math.cos(course), math.sin(course)
    return lambda t: PadTruth(
        t, (speed * t * c, speed * t * s, -height), (speed * c, speed * s, 0.0), ZERO3, course, 0.0
    )


def circling(speed: float, radius: float) -> Pad:
    w = speed / radius

    def at(t: float) -> PadTruth:
        c, s = math.cos(w * t), math.sin(w * t)
        return PadTruth(
            t,
            (radius * c, radius * s, -0.3),
            (-speed * s, speed * c, 0.0),
            (-speed * w * c, -speed * w * s, 0.0),
            w * t + 0.5 * math.pi,
            w,
        )

    return at


def heaving(amplitude: float, period: float) -> Pad:
    w = math.tau / period

    def at(t: float) -> PadTruth:
        z, v = amplitude * math.sin(w * t), amplitude * w * math.cos(w * t)
        return PadTruth(t, (0.0, 0.0, -1.0 + z), (0.0, 0.0, v), ZERO3, 0.0, 0.0)

    return at


class Fall:
    """A vehicle with stopped motors, and what it stands on."""

    def __init__(
        self, state: QuadrotorState, pad: Pad = nowhere, mass_factor: float = 1.0, friction: float = 0.8
    ) -> None:
        self.state, self.pad, self.t = state, pad, 0.0
        self.vehicle = Quadrotor(X500.body, mass_factor)
        legs = X500.legs.model_copy(update={"friction": friction})
        self.contact = Contact(legs, X500.body.mass_kg, BOARD, HUBS)
        self.load = NO_CONTACT

    def run(self, seconds: float, dt: float = DT) -> Fall:
        for _ in range(round(seconds / dt)):
            self.load = self.contact.step(self.state, self.pad(self.t), dt)
            self.state = self.vehicle.step(
                self.state,
                OFF,
                dt,
                force_ned_n=self.load.force_ned_n,
                torque_body_n_m=self.load.torque_body_n_m,
            )
            self.t += dt
        return self

    def relative(self) -> tuple[Vector3, Vector3]:
        """Place (in the board's axes) and velocity relative to the pad."""
        pad = self.pad(self.t)
        forward, right, down = BOARD.local(pad, self.state.position_ned_m)
        v, u = self.state.velocity_ned_m_s, pad.velocity_ned_m_s
        return (forward, right, -down), (v[0] - u[0], v[1] - u[1], v[2] - u[2])


def above(pad: Pad, x: float = 0.0, gap: float = 0.0, **values: object) -> QuadrotorState:
    n, e, d = pad(0.0).position_ned_m
    return QuadrotorState((n + x, e, d - STAND - gap), **values)  # type: ignore[arg-type]


def on_ground(height: float = STAND, **values: object) -> QuadrotorState:
    return QuadrotorState((0.0, 0.0, -height), **values)  # type: ignore[arg-type]


def test_stands_still_at_its_standing_height_and_feels_gravity() -> None:
    fall = Fall(on_ground()).run(3.0)
    assert fall.state.position_ned_m == pytest.approx((0.0, 0.0, -0.18), abs=1e-6)
    assert fall.state.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, -GRAVITY_M_S2), abs=1e-4)
    assert (fall.load.on_ground, fall.load.on_board) == (4, 0)
    for height in (0.3, 5.0):  # in the air nothing touches
        assert Fall(on_ground(height)).run(DT).load == NO_CONTACT


@pytest.mark.parametrize("speed", [0.3, 0.6, 1.0, 2.0])
def test_hardly_bounces(speed: float) -> None:
    fall = Fall(on_ground(STAND + 0.01, velocity_ned_m_s=(0.0, 0.0, speed)))
    upward = 0.0
    for _ in range(400):
        fall.run(DT)
        upward = max(upward, -fall.state.velocity_ned_m_s[2])
    assert upward < 0.25 * speed
    assert abs(fall.state.velocity_ned_m_s[2]) < 0.01


def test_a_vehicle_set_down_on_a_pad_at_two_metres_a_second_rides_along() -> None:
    pad = driving(2.0)
    fall = Fall(above(pad, gap=0.01, velocity_ned_m_s=(2 * math.cos(0.6), 2 * math.sin(0.6), 0.3)), pad)
    fall.run(1.0)
    place, velocity = fall.relative()
    assert fall.load.on_board == 4
    assert velocity == pytest.approx(ZERO3, abs=0.002)
    later, _ = fall.run(20.0).relative()
    assert later == pytest.approx(place, abs=1e-4)  # it does not creep


def test_a_vehicle_that_comes_down_too_slow_slides_by_coulombs_law() -> None:
    pad = driving(1.0, course=0.0)
    fall = Fall(above(pad), pad, friction=0.3).run(3.0)
    place, velocity = fall.relative()
    assert velocity == pytest.approx(ZERO3, abs=0.002)
    # v^2 / (2 mu g) behind where it came down
    assert place[0] == pytest.approx(-1.0 / (2 * 0.3 * GRAVITY_M_S2), abs=0.01)


def test_good_grip_at_a_metre_a_second_of_slip_lifts_two_feet_and_sets_them_down_again() -> None:
    pad = driving(1.0, course=0.0)
    fall = Fall(above(pad, velocity_ned_m_s=(0.0, 0.0, 0.3)), pad)
    tilts = [tilt_from_quat(fall.run(0.01).state.attitude) for _ in range(200)]
    assert math.radians(5.0) < max(tilts) < math.radians(30.0)
    assert tilts[-1] < math.radians(0.2)
    assert fall.load.on_board == 4


def test_it_turns_with_a_circling_pad() -> None:
    pad = circling(1.5, 5.0)
    fall = Fall(above(pad, velocity_ned_m_s=(0.0, 1.5, 0.0), rate_body_rad_s=(0.0, 0.0, 0.3)), pad).run(0.5)
    before, _ = fall.relative()
    after, _ = fall.run(15.0).relative()
    assert after == pytest.approx(before, abs=1e-3)
    assert fall.state.rate_body_rad_s[2] == pytest.approx(0.3, abs=0.005)
    assert fall.load.on_board == 4


def test_it_follows_a_heaving_deck() -> None:
    pad = heaving(0.2, 5.0)
    fall = Fall(above(pad, velocity_ned_m_s=pad(0.0).velocity_ned_m_s), pad).run(2.0)
    for _ in range(20):
        place, velocity = fall.run(0.4).relative()
        assert place[2] == pytest.approx(STAND, abs=0.001)
        assert abs(velocity[2]) < 0.01


def test_a_deck_weighs_the_vehicle_more_in_the_trough_than_on_the_crest() -> None:
    pad = heaving(0.2, 2.0)
    fall = Fall(above(pad, velocity_ned_m_s=pad(0.0).velocity_ned_m_s), pad)
    for seconds, swing in ((5.5, 0.2 * math.pi**2), (1.0, -0.2 * math.pi**2)):
        felt = fall.run(seconds).state.specific_force_body_m_s2[2]
        assert felt == pytest.approx(-GRAVITY_M_S2 + swing, abs=0.1)


def test_it_falls_off_the_edge_and_beside_the_pad_it_stands_on_the_ground() -> None:
    pad = driving(0.0, height=1.0, course=0.0)
    fall = Fall(above(pad, x=0.70, gap=0.01), pad).run(3.0)
    assert fall.load.on_board == 0
    assert -fall.state.position_ned_m[2] < 0.6
    assert math.isfinite(sum(fall.state.velocity_ned_m_s))
    fall = Fall(QuadrotorState((2.0, 0.0, -STAND)), driving(0.0, height=0.1)).run(1.0)
    assert fall.load.on_ground == 4
    assert fall.state.position_ned_m[2] == pytest.approx(-STAND, abs=1e-4)


def test_a_pad_that_drives_into_the_legs_does_not_throw_the_vehicle() -> None:
    def pad(t: float) -> PadTruth:
        return PadTruth(t, (-2.0 + t, 0.0, -0.1), (1.0, 0.0, 0.0), ZERO3, 0.0, 0.0)

    fall = Fall(on_ground(), pad).run(4.0)
    assert fall.state.position_ned_m == pytest.approx((0.0, 0.0, -STAND), abs=1e-3)


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_a_tilted_touchdown_rights_itself(yaw_deg: int) -> None:
    attitude = quat_from_euler(math.radians(8.0), math.radians(-6.0), math.radians(yaw_deg))
    fall = Fall(on_ground(STAND + 0.05, attitude=attitude, velocity_ned_m_s=(0.1, 0.0, 0.3))).run(2.0)
    assert math.degrees(tilt_from_quat(fall.state.attitude)) < 0.1
    assert fall.load.on_ground == 4


def test_a_foot_that_touches_first_turns_the_body_off_itself() -> None:
    # right side down: the right feet touch, and push the right side up
    state = on_ground(STAND + 0.005, attitude=quat_from_euler(0.1, 0.0, 1.2))
    fall = Fall(state).run(DT)
    assert fall.load.on_ground == 2
    assert fall.load.torque_body_n_m[0] < 0.0
    push = quat_rotate_inverse(state.attitude, fall.load.force_ned_n)
    assert push[2] < 0.0


def test_a_heavier_vehicle_sags_and_upside_down_it_lies_on_its_hubs() -> None:
    fall = Fall(on_ground(), mass_factor=1.5).run(2.0)
    assert -fall.state.position_ned_m[2] == pytest.approx(STAND - 0.0015, abs=2e-4)
    fall = Fall(on_ground(0.3, attitude=quat_from_euler(math.pi, 0.0, 0.0))).run(3.0)
    assert -fall.state.position_ned_m[2] == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("dt", [0.001, 0.0025, 0.005])
def test_it_is_stable_at_coarser_and_finer_steps(dt: float) -> None:
    attitude = quat_from_euler(0.2, 0.1, 0.0)
    fall = Fall(on_ground(STAND + 0.1, attitude=attitude, velocity_ned_m_s=(1.0, -0.5, 1.5))).run(3.0, dt)
    assert fall.state.velocity_ned_m_s == pytest.approx(ZERO3, abs=1e-3)
    assert fall.state.rate_body_rad_s == pytest.approx(ZERO3, abs=1e-3)


def test_the_normal_force_never_pulls() -> None:
    fall = Fall(on_ground(STAND, velocity_ned_m_s=(0.0, 0.0, -3.0)))
    for _ in range(20):
        fall.run(DT)
        assert fall.load.force_ned_n[2] <= 0.0
