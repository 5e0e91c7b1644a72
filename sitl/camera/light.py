"""The light over the pad: how bright it is, a shadow's edge that passes, and the sun's mirror image.

The camera's response is in `exposure`. Directions NED; lengths in metres. A shadow is a
factor on what is seen, glare an addition to it in units of a white sheet's light; both are worked out on the
camera's mesh (`mesh`), since neither has an edge finer than that.

Mirror: a ray that leaves the camera along d and meets a surface with the unit normal n goes on along
d - 2 (d.n) n. Print that shines a little spreads the sun about that direction as a Gauss bell.
"""

import math
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from companion.base.geometry import FloatArray, Vector3
from companion.config import StrictModel
from sitl.camera.mesh import HORIZON, Part, nodes_of, pixels_of
from sitl.camera.textures import GreyImage
from sitl.pad.paths import Angle, drawn_angle

# a mesh node is a few centimetres of ground: an edge is never sharper
LEAST_PENUMBRA_M: Final = 0.02


class ShadowSettings(StrictModel):
    """A straight edge of shade that moves over the pad; what it has passed lies in shade."""

    depth: float = Field(default=0.7, gt=0.0, le=0.98, description="Share of the light that is missing in it")
    penumbra_m: float = Field(default=0.05, ge=0.0, le=5.0, description="Width of its edge")
    course_deg: Angle = Field(default="random", description="Where it goes, clockwise from north")
    speed_m_s: float = Field(default=0.1, ge=-10.0, le=10.0, description="Relative to the pad")
    crosses_s: float = Field(
        default=25.0, ge=0.0, le=900.0, description="Time at which it passes the pad's centre"
    )
    stripes_m: Annotated[float, Field(gt=0.1, le=100.0)] | None = Field(
        default=None, description="Width of alternating stripes of light and shade; none: one edge"
    )


class GlareSettings(StrictModel):
    """The sun's image in the pad's print: a patch that saturates and hides what it lies on."""

    elevation_deg: float = Field(default=75.0, ge=5.0, le=90.0, description="Elevation of the sun")
    azimuth_deg: Angle = Field(default="random", description="Azimuth of the sun, clockwise from north")
    strength: float = Field(
        default=4.0, gt=0.0, le=1000.0, description="Brightness of its middle over a white sheet"
    )
    spread_deg: float = Field(default=4.0, ge=0.5, le=30.0, description="How far a matt print spreads it")


class LightSettings(StrictModel):
    """How bright it is; without it the camera's exposure is right and its noise constant."""

    illuminance_lux: float = Field(
        default=3000.0, ge=0.1, le=150000.0, description="Dusk 50, overcast 3000, sun 80000"
    )
    veil: float = Field(
        default=0.0,
        ge=0.0,
        le=0.9,
        description="Stray light of a low sun, as a share of a white sheet's brightness",
    )
    shadow: ShadowSettings | None = None
    glare: GlareSettings | None = None


class LightInView:
    """A scenario's light under one seed, as one camera's mesh sees it."""

    def __init__(self, settings: LightSettings, rng: np.random.Generator, rays: FloatArray) -> None:
        """`rays` (rows, columns, 3) are the mesh's in the camera's axes, z = 1."""
        self.veil = settings.veil
        self._shadow, self._glare = settings.shadow, settings.glare
        self._rays = rays
        self._unit_rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        course = drawn_angle("random" if self._shadow is None else self._shadow.course_deg, rng)
        azimuth = drawn_angle("random" if self._glare is None else self._glare.azimuth_deg, rng)
        self._course = (math.cos(course), math.sin(course))
        elevation = math.radians(90.0 if self._glare is None else self._glare.elevation_deg)
        flat = math.cos(elevation)
        self._sun = np.array((flat * math.cos(azimuth), flat * math.sin(azimuth), -math.sin(elevation)))

    def shade(
        self, ned_from_camera: FloatArray, camera_from_pad_ned_m: Vector3, time_s: float
    ) -> GreyImage | None:
        """How much of the light (0..255) reaches what each pixel sees; None: all of it.

        Args:
            ned_from_camera: rotation (3, 3).
            camera_from_pad_ned_m: the camera's place less the pad's; all is taken to lie at its height.
            time_s: the world's.
        """
        shadow = self._shadow
        if shadow is None:
            return None
        rays = self._rays @ ned_from_camera.T
        reach = -camera_from_pad_ned_m[2] / np.maximum(rays[..., 2:], HORIZON)
        places = rays[..., :2] * reach + camera_from_pad_ned_m[:2]
        lit = self._lit(shadow, places, time_s)
        return np.asarray(pixels_of(255.0 * lit), dtype=np.uint8)  # between nodes it is between theirs

    def glow(
        self, ned_from_camera: FloatArray, normal_ned: Vector3, inside: FloatArray, part: Part
    ) -> NDArray[np.float32] | None:
        """The sun's image in the board, of a white sheet's light, at each pixel of a part of the picture.

        None: there is none.

        Args:
            ned_from_camera: rotation (3, 3).
            normal_ned: of the board.
            inside: how far within the board each node (rows, columns) is, negative outside.
            part: the rectangle of mesh cells that may show the board.
        """
        glare = self._glare
        if glare is None:
            return None
        light = self._mirrored(glare, self._unit_rays @ ned_from_camera.T, normal_ned)
        nodes = nodes_of(part)
        return pixels_of(light[nodes]) * (pixels_of(inside[nodes]) > 0.0)

    def _lit(self, shadow: ShadowSettings, north_east_m: FloatArray, time_s: float) -> FloatArray:
        """Share of the light (...) at places (..., 2) relative to the pad's centre."""
        ahead = north_east_m @ self._course - shadow.speed_m_s * (time_s - shadow.crosses_s)
        if shadow.stripes_m is not None:
            # a triangle wave: zero at each edge, with the edge's own slope there
            half = 0.5 * shadow.stripes_m
            ahead = np.abs((ahead + 0.5 * half) % (2.0 * half) - half) - 0.5 * half
        lit = 0.5 + ahead / max(shadow.penumbra_m, LEAST_PENUMBRA_M)
        return np.asarray(1.0 - shadow.depth * (1.0 - lit.clip(0.0, 1.0)))

    def _mirrored(self, glare: GlareSettings, rays_ned: FloatArray, normal_ned: Vector3) -> FloatArray:
        """The sun's light (...), of a white sheet's, that such a surface sends up unit rays (..., 3)."""
        normal = np.array(normal_ned)
        towards = self._sun - 2.0 * (self._sun @ normal) * normal
        off2 = 2.0 * (1.0 - rays_ned @ towards)
        return np.asarray(glare.strength * np.exp(-0.5 * off2 / math.radians(glare.spread_deg) ** 2))
