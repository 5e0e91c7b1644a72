"""What lies under the vehicle, and what it does to the rotors."""

import math

import pytest

from companion.base.geometry import ZERO3, Vector3, quat_from_euler
from companion.pad import load_pad
from sitl.pad.motion import PadTruth
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.ground import PadBoard, rotor_ratios, thrust_ratio

R = 0.127
ROTORS = ((0.25, 0.0, -0.05), (0.0, 0.25, -0.05), (-0.25, 0.0, -0.05), (0.0, -0.25, -0.05))


def pad_at(position: Vector3 = (0.0, 0.0, -1.0), heading: float = 0.0) -> PadTruth:
    return PadTruth(0.0, position, ZERO3, ZERO3, heading, 0.0)


@pytest.mark.parametrize(
    ("radii", "ratio"), [(0.5, 4.0 / 3.0), (1.0, 16.0 / 15.0), (2.0, 64.0 / 63.0), (4.0, 256.0 / 255.0)]
)
def test_thrust_follows_cheeseman_and_bennett(radii: float, ratio: float) -> None:
    assert thrust_ratio(radii * R, R) == pytest.approx(ratio)


@pytest.mark.parametrize("height", [0.4 * R, 0.01, 0.0, -0.2])
def test_thrust_is_bounded_where_the_formula_ends(height: float) -> None:
    assert thrust_ratio(height, R) == pytest.approx(4.0 / 3.0)


def test_thrust_grows_steadily_towards_the_ground() -> None:
    ratios = [thrust_ratio(0.02 * i, R) for i in range(100)]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] == pytest.approx(1.0, abs=1e-3)


def test_only_rotors_over_the_board_feel_it() -> None:
    board = PadBoard(0.5, 0.5)
    # the front rotor's hub is over the rear edge of a high board, the others over the ground
    state = QuadrotorState((-0.6, 0.0, -1.2))
    ratios = rotor_ratios(state, ROTORS, R, board, pad_at())
    assert ratios[0] == pytest.approx(thrust_ratio(0.25, R))
    assert ratios[1:] == pytest.approx((thrust_ratio(1.25, R),) * 3)


def test_a_tilted_vehicle_has_its_low_rotor_deeper_in_ground_effect() -> None:
    state = QuadrotorState((0.0, 0.0, -0.4), attitude=quat_from_euler(0.2, 0.0, 1.0))
    ratios = rotor_ratios(state, ROTORS, R, PadBoard(0.5, 0.5), pad_at((50.0, 0.0, -0.1)))
    assert ratios[1] > ratios[0] == pytest.approx(ratios[2])
    assert ratios[0] > ratios[3]


def test_high_up_there_is_none() -> None:
    assert rotor_ratios(QuadrotorState((0.0, 0.0, -5.0)), ROTORS, R, PadBoard(1, 1), pad_at()) == (1, 1, 1, 1)


@pytest.mark.parametrize("heading_deg", [0, 90, 180, 270])
def test_the_board_turns_with_the_heading(heading_deg: int) -> None:
    board, heading = PadBoard(2.0, 0.5), math.radians(heading_deg)
    pad = pad_at((3.0, 4.0, -0.2), heading)
    ahead = (3.0 + 1.5 * math.cos(heading), 4.0 + 1.5 * math.sin(heading))
    aside = (3.0 - 1.5 * math.sin(heading), 4.0 + 1.5 * math.cos(heading))
    assert board.local(pad, (*ahead, -0.2)) == pytest.approx((1.5, 0.0, 0.0), abs=1e-12)
    assert board.local(pad, (*aside, -0.3)) == pytest.approx((0.0, 1.5, -0.1), abs=1e-12)
    assert board.surface_down_m(pad, *ahead) == -0.2
    assert board.surface_down_m(pad, *aside) == 0.0


def test_the_distance_to_the_board_is_to_its_nearest_point() -> None:
    board, pad = PadBoard(0.5, 0.5), pad_at()
    assert board.distance_m(pad, (0.2, 0.1, -3.0)) == pytest.approx((0.0, 2.0))
    assert board.distance_m(pad, (0.8, 0.9, -3.0)) == pytest.approx((0.5, 2.0))


def test_the_board_has_the_pads_size() -> None:
    assert PadBoard.of(load_pad("moving_1300")) == PadBoard(0.65, 0.65)
