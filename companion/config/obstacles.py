"""Obstacles as an operator surveys them: upright cylinders and boxes that stand on the ground.

Places are north and east of home (m), heights over home (m); what is under a top is solid down to the ground.
The app's settings and the simulator's scenarios describe them by the same models, but share no geometry.
"""

from typing import Annotated, Final, Literal

from pydantic import Field

from companion.config.reading import StrictModel

Place = Annotated[float, Field(ge=-2000.0, le=2000.0)]


class Cylinder(StrictModel):
    """A pole, a tree, a silo."""

    kind: Literal["cylinder"]
    centre_ned_m: tuple[Place, Place]
    """North, east of home"""
    radius_m: float = Field(gt=0.0, le=100.0)
    """Radius of its widest part"""
    height_m: float = Field(gt=0.0, le=500.0)
    """Height of its top over home"""


class Box(StrictModel):
    """A wall, a house, a parked truck."""

    kind: Literal["box"]
    centre_ned_m: tuple[Place, Place]
    """North, east of home"""
    length_m: float = Field(gt=0.0, le=500.0)
    """Length along its heading"""
    width_m: float = Field(gt=0.0, le=500.0)
    """Width across its heading"""
    heading_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Heading, clockwise from north"""
    height_m: float = Field(gt=0.0, le=500.0)
    """Height of its top over home"""


Shape = Annotated[Cylinder | Box, Field(discriminator="kind")]
# the ways round so many are ready within seconds; time and memory grow with the cube
MOST_OBSTACLES: Final = 24
