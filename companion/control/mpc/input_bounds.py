"""The bounds of the MPC's inputs: a polytope about zero that lies within every limit on one command.

The input u (m/s2, NED) is produced by the specific force f = u - g, which points up and is tilted. The
bounds limit its horizontal part, its vertical part, the tilt of f (together with the vertical part, since a
vehicle that accelerates downwards tilts more for the same horizontal part), and its magnitude, which is the
thrust. Circles and spheres are replaced by planes inside of them, so that the gate never reduces what the
MPC plans. SI units.
"""

import math
from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.config import LimitsConfig
from companion.control.limits import aside_m_s2

# normals of four directions 45 degrees apart: with both signs, an octagon
OCTAGON: Final = np.array([(math.cos(k * math.pi / 4), math.sin(k * math.pi / 4)) for k in range(4)])
EIGHT: Final = np.vstack([OCTAGON, -OCTAGON])
# an octagon with this share of a circle's radius to its sides lies within the circle
OCTAGON_WITHIN_CIRCLE: Final = math.cos(math.pi / 8)
FOUR: Final = EIGHT[::2]  # every second one
INPUT_ROWS: Final = len(OCTAGON) + 1 + len(EIGHT) + len(FOUR)  # horizontal, vertical, tilt, thrust
# whatever hover thrust has been learnt, the vehicle may at least rise and sink by this share of g
LEAST_ROOM: Final = 0.1


def input_rows(limits: LimitsConfig) -> FloatArray:
    """Rows (17, 3) on one input: horizontal (4), vertical (1), tilt (8) and thrust (4)."""
    octagon = np.hstack([OCTAGON, np.zeros((4, 1))])
    tilt = np.hstack([EIGHT, np.full((8, 1), OCTAGON_WITHIN_CIRCLE * _tangent(limits))])
    ring = _ring_rad(limits)
    thrust = np.hstack([FOUR * math.sin(ring), np.full((4, 1), -math.cos(ring))])
    return np.vstack([octagon, [[0.0, 0.0, 1.0]], tilt, thrust])


def input_bounds(
    limits: LimitsConfig, rows: FloatArray, hover_thrust: float, pressed_m_s2: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds (17,) of `rows`, the `input_rows` of the same limits.

    `hover_thrust` is the share of full thrust that carries the weight.

    What presses it down by `pressed_m_s2` may be met beyond the bound on vertical acceleration, which is for
    what is flown: bounded with it, a vehicle in a falling gust keeps the bound and falls.
    Zero lies inside with room to spare, whatever the numbers: the vehicle may always hover.
    """
    side = aside_m_s2(limits) * OCTAGON_WITHIN_CIRCLE
    room = LEAST_ROOM * GRAVITY_M_S2
    sink = max(room, GRAVITY_M_S2 * (1.0 - limits.minimum_thrust / hover_thrust))
    most = max(GRAVITY_M_S2 + room, GRAVITY_M_S2 * limits.maximum_thrust / hover_thrust)
    tilt = OCTAGON_WITHIN_CIRCLE * _tangent(limits) * GRAVITY_M_S2
    thrust = most * _ring_within_sphere(limits) - GRAVITY_M_S2 * math.cos(_ring_rad(limits))
    vertical = limits.vertical_acceleration_m_s2
    climb = vertical + min(pressed_m_s2, max(0.0, most - GRAVITY_M_S2 - vertical))
    upper = np.array([*[side] * 4, min(vertical, sink), *[tilt] * 8, *[thrust] * 4])
    lower = np.array([*[-side] * 4, -climb, *[-math.inf] * 12])
    # a plane that the first five rows imply gets no bound: such a row costs OSQP no iterations
    vertically = np.maximum(rows[:, 2] * upper[4], rows[:, 2] * lower[4])
    reach = np.hypot(rows[:, 0], rows[:, 1]) * side / OCTAGON_WITHIN_CIRCLE + vertically
    upper[5:][reach[5:] <= upper[5:]] = math.inf
    return lower, upper


def side_left_m_s2(limits: LimitsConfig, hover_thrust: float) -> float:
    """The horizontal input (m/s2) at which full thrust still carries the weight, with room to rise.

    Height before place: who has too little thrust for both tilts less and drifts, but does not fall.
    """
    most = GRAVITY_M_S2 * limits.maximum_thrust / hover_thrust
    room = LEAST_ROOM * GRAVITY_M_S2
    return max(room, math.sqrt(max(0.0, most**2 - (GRAVITY_M_S2 + room) ** 2)))


def shrunk(input_m_s2: FloatArray, rows: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """The input (3,), or as much of it, in its own direction, as the bounds allow."""
    reach = rows @ input_m_s2
    return input_m_s2 / max(1.0, float(np.where(reach > 0.0, reach / upper, reach / lower).max()))


def cut_sideways(
    input_m_s2: FloatArray, rows: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """The input (3,), its vertical part kept where it may be, and as much of the horizontal as then fits.

    Height is what a vehicle near a pad cannot give up for a wind.
    """
    vertical = shrunk(np.array([0.0, 0.0, input_m_s2[2]]), rows, lower, upper)
    base, reach = rows @ vertical, rows[:, :2] @ input_m_s2[:2]
    some = np.abs(reach) > 1e-9
    room = np.where(reach > 0.0, upper - base, base - lower)[some]
    share = min(1.0, max(0.0, float(np.min(room / np.abs(reach[some]), initial=math.inf))))
    horizontal: FloatArray = share * np.array([*input_m_s2[:2], 0.0])
    return vertical + horizontal


def _tangent(limits: LimitsConfig) -> float:
    return math.tan(math.radians(limits.tilt_deg))


def _ring_rad(limits: LimitsConfig) -> float:
    """How far from upright the normals of the thrust's planes tilt: the middle of what the force may."""
    return 0.5 * math.radians(limits.tilt_deg)


def _ring_within_sphere(limits: LimitsConfig) -> float:
    """The share of a sphere's radius at which the four planes lie within it, up to the greatest tilt."""
    ring, tilt = _ring_rad(limits), math.radians(limits.tilt_deg)
    aside = math.sin(tilt) * math.sin(ring) * math.cos(math.pi / 4)
    return min(math.cos(ring), math.cos(tilt) * math.cos(ring) + aside)
