"""The landing as a scene: pad, predicted touchdown, planned path, obstacles."""

import math
from typing import Final

from companion.base.geometry import Vector3, add, quat_from_euler, scale
from companion.base.messages import ControlReport, PadState, PlanStep
from companion.config import Box, Shape
from companion.flightlog.foxglove.parts import LOCAL, PAD, Plain, colour, entity, pose, vector
from companion.pad import Pad

PAD_THICKNESS_M: Final = 0.02
TOUCHDOWN_SIZE_M: Final = 0.12
PATH_WIDTH_M: Final = 0.03
# what is predicted is gone when nothing new is said
PREDICTED_FOR_S: Final = 1.0
PAD_COLOUR: Final = colour(0.15, 0.68, 0.38, 0.6)
TOUCHDOWN_COLOUR: Final = colour(0.91, 0.3, 0.24, 0.9)
PATH_COLOUR: Final = colour(0.14, 0.44, 0.64)
OBSTACLE_COLOUR: Final = colour(0.5, 0.55, 0.55, 0.6)


def pad_entity(unix_ns: int, pad: Pad) -> Plain:
    """The board, in the pad's own frame: its face lies at 0, down is +z."""
    size = vector((pad.length_m, pad.width_m, PAD_THICKNESS_M))
    board = {"pose": pose((0.0, 0.0, 0.5 * PAD_THICKNESS_M)), "size": size, "color": PAD_COLOUR}
    return entity(unix_ns, PAD, "pad", cubes=[board])


def time_to_touchdown_s(plan: PlanStep) -> float | None:
    """How long the planned motion takes to the pad; None while nothing leads there."""
    if plan.reference is None or plan.reference.origin != "pad" or plan.time_to_go_s <= 0.0:
        return None
    return plan.time_to_go_s


def touchdown_entity(
    unix_ns: int, pad_position_ned_m: Vector3, pad: PadState, plan: PlanStep
) -> Plain | None:
    """Where the pad will be when the planned motion ends; None while nothing leads to the pad."""
    duration_s = time_to_touchdown_s(plan)
    if duration_s is None:
        return None
    place = add(pad_position_ned_m, scale(pad.velocity_ned_m_s, duration_s))
    size = vector((TOUCHDOWN_SIZE_M,) * 3)
    ball = {"pose": pose(place), "size": size, "color": TOUCHDOWN_COLOUR}
    return entity(unix_ns, LOCAL, "predicted touchdown", PREDICTED_FOR_S, spheres=[ball])


def path_entity(unix_ns: int, report: ControlReport, origin_ned_m: Vector3) -> Plain:
    """The tracker's prediction over its horizon; its rows count from `origin_ned_m`."""
    line = {
        "type": 0,
        "pose": pose(origin_ned_m),
        "thickness": PATH_WIDTH_M,
        "scale_invariant": False,
        "points": [vector(row) for row in report.predicted_position_m],
        "color": PATH_COLOUR,
    }
    return entity(unix_ns, LOCAL, "predicted path", PREDICTED_FOR_S, lines=[line])


def obstacle_entity(unix_ns: int, number: int, shape: Shape) -> Plain:
    """One surveyed obstacle, from the ground to its top; home is taken for the EKF's origin."""
    north, east = shape.centre_ned_m
    middle = (north, east, -0.5 * shape.height_m)
    name = f"obstacle {number}"
    if isinstance(shape, Box):
        turn = quat_from_euler(0.0, 0.0, math.radians(shape.heading_deg))
        size = vector((shape.length_m, shape.width_m, shape.height_m))
        cube = {"pose": pose(middle, turn), "size": size, "color": OBSTACLE_COLOUR}
        return entity(unix_ns, LOCAL, name, cubes=[cube])
    size = vector((2.0 * shape.radius_m, 2.0 * shape.radius_m, shape.height_m))
    cylinder = {
        "pose": pose(middle),
        "size": size,
        "bottom_scale": 1.0,
        "top_scale": 1.0,
        "color": OBSTACLE_COLOUR,
    }
    return entity(unix_ns, LOCAL, name, cylinders=[cylinder])
