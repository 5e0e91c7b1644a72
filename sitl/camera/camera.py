"""The simulated camera: the pad and the ground through lens, rolling shutter, exposure and noise.

Every pixel's ray (lens of eqs. 2 and 3 undone exactly) meets the plane it looks at, with the poses of
the moment at which that row is exposed. Rays are followed on a mesh of one node in 8 x 8 pixels and the
texture coordinates interpolated between: against following every pixel, that is wrong by less than
0.02 px, and it is continuous (no bands). Within a frame the homography runs through three exact ones
(start, middle, end) as a parabola, or, where vibration of the rotors' frequency is to be followed, straight
between as many as requested. Blur is one straight stroke for the whole image: the motion, over the
exposure, of what is in the middle of the pad's part of the image.

World NED with the ground at z = 0; the pad's surface is at the height of its position.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.encoding import encoding_table
from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    add,
    matrix_from_quat,
    quat_from_euler,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
    subtract,
)
from companion.config import CameraConfig, VehicleConfig
from companion.pad import Pad
from sitl.camera.exposure import (
    AutoExposure,
    ImagingSettings,
    NoiseBank,
    add_light,
    levelled,
    motion_blur,
    response,
    through,
    vignette,
)
from sitl.camera.light import LightInView
from sitl.camera.mesh import HORIZON, NODE_PX, Part, covers, node_rays, visible_part, within_board
from sitl.camera.textures import (
    PAD_WHITE,
    GreyImage,
    Texture,
    TextureLevel,
    covered_texture,
    ground_texture,
    other_ids_texture,
    pad_texture,
)


def mounted_camera(vehicle: VehicleConfig, error_deg: Vector3 = ZERO3) -> FloatArray:
    """Rotation (3, 3) of camera axes into body axes (FRD).

    `error_deg` is a further rotation (roll, pitch, yaw) about the body's axes that `vehicle` lacks.
    """
    nominal = body_from_camera(
        math.radians(vehicle.camera_yaw_deg),
        math.radians(vehicle.camera_tilt_deg),
        math.radians(vehicle.camera_roll_deg),
    )
    if error_deg == ZERO3:
        return nominal
    roll, pitch, yaw = (math.radians(angle) for angle in error_deg)
    return np.asarray(matrix_from_quat(quat_from_euler(roll, pitch, yaw)) @ nominal)


def body_from_camera(yaw_rad: float, tilt_rad: float, roll_rad: float = 0.0) -> FloatArray:
    """How the camera sits on the airframe: rotation (3, 3) of camera axes into body axes (FRD).

    Derived here independently of the app's code: a sign that is wrong on one side shows.

    The columns are what the camera's axes are on the vehicle: the image's right, the image's down, and
    where the lens looks. Untilted and unturned, the lens looks down and the image's top edge is forward:
    right is right, the image's down is back. Tilted, the lens rises from down towards forward and the
    image's down from back towards down. Turned, forward becomes (cos, sin, 0) and right (-sin, cos, 0):
    clockwise seen from above. Rolled, before all that, the lens swings from down towards the left.
    """
    st, ct = math.sin(tilt_rad), math.cos(tilt_rad)
    sy, cy = math.sin(yaw_rad), math.cos(yaw_rad)
    tilted = np.array(
        [
            # image right, image down, lens
            [0.0, -ct, st],  # forward
            [1.0, 0.0, 0.0],  # right
            [0.0, st, ct],  # down
        ]
    )
    if roll_rad != 0.0:
        sr, cr = math.sin(roll_rad), math.cos(roll_rad)
        rolled = np.array([[0.0, -1.0, 0.0], [cr, 0.0, -sr], [sr, 0.0, cr]])
        tilted = np.array([[ct, 0.0, st], [0.0, 1.0, 0.0], [-st, 0.0, ct]]) @ rolled
    turned = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turned @ tilted)


FARTHEST_TEXEL: Final = 30000.0
GROUND_SEED: Final = 1


@dataclass(frozen=True, slots=True)
class ScenePose:
    """Where vehicle and pad are at one moment. The pad's roll and pitch are of a deck that rocks."""

    vehicle_position_ned_m: Vector3
    vehicle_attitude: Quaternion
    pad_position_ned_m: Vector3
    pad_heading_rad: float
    pad_roll_rad: float = 0.0
    pad_pitch_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class _Surface:
    """A plane as seen over one frame: texel-from-ray homographies (k, 3, 3) at equal steps, start to end."""

    level: TextureLevel
    texel_from_ray: FloatArray
    height_m: float


class CameraModel:
    """Renders frames. Deterministic: the noise comes from `rng` alone, a frame at a time."""

    def __init__(
        self,
        camera: CameraConfig,
        vehicle: VehicleConfig,
        pad: Pad,
        settings: ImagingSettings,
        rng: np.random.Generator,
        *,
        mount_error_deg: Vector3 = ZERO3,
        board: Texture | None = None,
        instants: int = 3,
        finer: int = 1,
    ) -> None:
        """Prepare it.

        Args:
            mount_error_deg: a further turn (roll, pitch, yaw) about the body's axes that `vehicle` lacks.
            board: what is printed on the board, if it is not the pad's markers.
            instants: at how many times within a frame the scene is looked at; odd, 3 or more.
            finer: each pixel is the mean of so many by so many places. With one, an edge is drawn by up to
                0.06 px where the print's texels are as large as pixels; with two, by a quarter of that.
        """
        self._camera = camera
        self._instants = instants
        self._finer = finer
        self._settings = settings
        self.position_body_m = vehicle.camera_position_body_m
        self.body_from_camera = mounted_camera(vehicle, mount_error_deg)
        self._camera_attitude = quat_from_matrix(self.body_from_camera)
        exposure_s = camera.exposure_s if settings.exposure_s is None else settings.exposure_s
        self._readout_s = camera.readout_s if settings.readout_s is None else settings.readout_s
        self._printed = pad_texture(pad) if board is None else board
        self._pad = pad
        self.clear_faults()
        # the place of a second pad's surface, from that of the pad's; None: there is none
        self.twin_ned_m: Callable[[Vector3], Vector3] | None = None
        self._ground_texture = ground_texture(GROUND_SEED)
        self._node_rays = node_rays(camera)
        self._rays_by_row = np.ascontiguousarray(self._node_rays.swapaxes(1, 2))
        row_px = NODE_PX * (np.arange(self._node_rays.shape[0]) - 1.0) + 0.5 * (NODE_PX - 1)
        self._row_time = (row_px + 0.5) / camera.height_px - 0.5  # of the readout, from its middle
        # generators of their own: light and dirt change no noise
        light_rng, dirt_rng = rng.spawn(2)
        self._metering: AutoExposure | None = None
        if settings.light is not None:
            self._light = LightInView(settings.light, light_rng, self._node_rays)
            self._metering = AutoExposure(settings.exposure, exposure_s, settings.light.illuminance_lux)
            exposure_s = self._metering.now.exposure_s
        self._set_exposure(exposure_s)
        self._encoded = encoding_table(camera.encoding)
        self._vignette = vignette(camera, settings, dirt_rng)
        self._noise = NoiseBank(camera, settings.noise_grey, rng) if settings.noise_grey else None

    def clear_faults(self) -> None:
        """The board is there with its own print, in its own size; a second pad has its own end."""
        self._pad_texture = self._printed
        self.print_scale = 1.0  # of the pad's print, against its file
        self.shows_pad = True

    def cover(self) -> None:
        self._pad_texture = covered_texture(self._pad)

    def show_other_ids(self) -> None:
        self._pad_texture = other_ids_texture(self._pad)

    @property
    def span_s(self) -> float:
        """From the start of the first row's exposure to the end of the last row's; scene_at is called within
        half of it."""
        return self._exposure_s + self._readout_s

    def blank(self) -> GreyImage:
        return np.empty((self._camera.height_px, self._camera.width_px), np.uint8)

    def render(self, time_s: float, scene_at: Callable[[float], ScenePose]) -> GreyImage:
        """Take one picture.

        Args:
            time_s: mid-exposure of the image's middle row.
            scene_at: the scene at a time within `time_s` +- `span_s` / 2.

        Returns:
            (height, width) grey image.
        """
        image = self.blank()
        self.expose(time_s, scene_at)(image)
        return image

    def expose(self, time_s: float, scene_at: Callable[[float], ScenePose]) -> Callable[[GreyImage], None]:
        """Look at the scene for one picture, as `render` does; what is returned draws it into a blank one.

        It reads no world: it may run beside. To be called once, before the next is exposed.
        """
        half = 0.5 * max(self.span_s, 1e-6)
        middle = self._instants // 2
        scenes = [scene_at(time_s + half * (k / middle - 1.0)) for k in range(self._instants)]
        pads = [(s.pad_position_ned_m, _pad_attitude(s)) for s in scenes]
        pad = self._surface(self._pad_texture, scenes, pads, self.print_scale)
        shown = self.shows_pad and pad.height_m > 0.0
        twin = None
        if self.twin_ned_m is not None:
            places = [(self.twin_ned_m(s.pad_position_ned_m), _pad_attitude(s)) for s in scenes]
            twin = self._surface(self._printed, scenes, places)
        return partial(self._picture, time_s, scenes, pad, twin, shown=shown)

    def _picture(
        self,
        time_s: float,
        scenes: list[ScenePose],
        pad: _Surface,
        twin: _Surface | None,
        out: GreyImage,
        *,
        shown: bool,
    ) -> None:
        grounds = [(ZERO3, IDENTITY)] * self._instants
        rows, columns = out.shape
        image = out if self._finer == 1 else np.empty((rows * self._finer, columns * self._finer), np.uint8)
        pad_map = self._node_map(pad) if shown else None
        part = None if pad_map is None else visible_part(pad_map, pad.level.image.shape)
        seen = pad
        if part is None or not covers(pad_map, pad.level.image.shape):
            ground = self._surface(self._ground_texture, scenes, grounds)
            self._draw(image, ground, self._node_map(ground), None)
            seen = pad if part is not None else ground
            if twin is not None:
                self._draw_twin(image, twin)
        if part is not None and pad_map is not None:
            self._draw(image, pad, pad_map, part)
        if self._finer > 1:
            cv2.resize(image, (columns, rows), dst=out, interpolation=cv2.INTER_AREA)
        glow = None
        if self._metering is not None:
            scene = scenes[self._instants // 2]
            ned_from_camera = matrix_from_quat(scene.vehicle_attitude) @ self.body_from_camera
            self._shade(out, scene, ned_from_camera, time_s)
            if part is not None and pad_map is not None:
                normal = quat_rotate(_pad_attitude(scene), (0.0, 0.0, 1.0))
                inside = within_board(pad_map, pad.level.image.shape)
                glow = self._light.glow(ned_from_camera, normal, inside, part)
        self._expose(self._through_lens(out, seen, part), glow, part, out)

    def _draw_twin(self, image: GreyImage, twin: _Surface) -> None:
        nodes = self._node_map(twin) if twin.height_m > 0.0 else None
        part = None if nodes is None else visible_part(nodes, twin.level.image.shape)
        if nodes is not None and part is not None:
            self._draw(image, twin, nodes, part)

    def _shade(self, image: GreyImage, scene: ScenePose, ned_from_camera: FloatArray, time_s: float) -> None:
        """Darken what lies in shade."""
        lever = quat_rotate(scene.vehicle_attitude, self.position_body_m)
        away = subtract(add(scene.vehicle_position_ned_m, lever), scene.pad_position_ned_m)
        shade = self._light.shade(ned_from_camera, away, time_s)
        if shade is not None:
            rows, columns = image.shape
            cv2.multiply(image, shade[:rows, :columns], dst=image, scale=1.0 / 255.0)

    def _surface(
        self,
        texture: Texture,
        scenes: list[ScenePose],
        planes: list[tuple[Vector3, Quaternion]],
        print_scale: float = 1.0,
    ) -> _Surface:
        """The homographies of one plane over the frame, and the texture's scale that suits its distance."""
        rays, heights = zip(
            *(self._plane_from_ray(s, *plane) for s, plane in zip(scenes, planes, strict=True)), strict=True
        )
        height = heights[len(heights) // 2]
        level = texture.level_for(self._finer * self._camera.fx_px / max(height, 1e-3))
        printed = np.diag([1.0 / print_scale, 1.0 / print_scale, 1.0])
        return _Surface(level, level.texel_from_plane @ printed @ np.array(rays), height)

    def _plane_from_ray(
        self, scene: ScenePose, origin: Vector3, world_from_plane: Quaternion
    ) -> tuple[list[list[float]], float]:
        """Homography (3, 3) from a camera ray (x, y, 1) to the plane (x, y, 1), and the height over it."""
        w, x, y, z = world_from_plane
        plane_from_world = (w, -x, -y, -z)
        lever = quat_rotate(scene.vehicle_attitude, self.position_body_m)
        camera = subtract(add(scene.vehicle_position_ned_m, lever), origin)
        px, py, pz = quat_rotate(plane_from_world, camera)
        world_from_camera = quat_multiply(scene.vehicle_attitude, self._camera_attitude)
        x, y, z = matrix_from_quat(quat_multiply(plane_from_world, world_from_camera)).tolist()
        return [
            [px * down - pz * forward for down, forward in zip(z, x, strict=True)],
            [py * down - pz * right for down, right in zip(z, y, strict=True)],
            z,
        ], -pz

    def _node_map(self, surface: _Surface) -> FloatArray:
        """Texture coordinates (2, rows, columns) of the mesh's nodes, each row at its own time."""
        rows = (self._pose_weights @ surface.texel_from_ray.reshape(-1, 9)).reshape(-1, 3, 3)
        places = np.empty((3, len(rows), self._rays_by_row.shape[2]))
        np.matmul(rows, self._rays_by_row, out=places.swapaxes(0, 1))
        nodes: FloatArray = places[:2] * (1.0 / np.maximum(places[2], HORIZON))
        return nodes

    def _set_exposure(self, exposure_s: float) -> None:
        """And with it how much each of a frame's poses counts for the mesh's rows: (rows, instants)."""
        self._exposure_s = exposure_s
        # -1 first pose, +1 last pose
        s = self._row_time * (2.0 * self._readout_s / max(self.span_s, 1e-6))
        if self._instants > 3:
            nodes = np.linspace(-1.0, 1.0, self._instants)
            self._pose_weights = np.maximum(0.0, 1.0 - np.abs(s[:, None] - nodes) / (nodes[1] - nodes[0]))
        else:
            self._pose_weights = np.stack((0.5 * s * (s - 1.0), 1.0 - s * s, 0.5 * s * (s + 1.0)), axis=1)

    def _draw(self, image: GreyImage, surface: _Surface, nodes: FloatArray, part: Part | None) -> None:
        """Sample one surface into the image, or into a part of it given in cells of the mesh."""
        tile = surface.level.image
        top, bottom, left, right = part or (0, nodes.shape[1] - 2, 0, nodes.shape[2] - 2)
        mesh = nodes[:, top : bottom + 2, left : right + 2]
        if part is None:  # the ground: start in the first copy of the tile
            period = tile.shape[0] // 2
            mesh = mesh - np.floor(mesh.min(axis=(1, 2), keepdims=True) / period) * period
        u, v = mesh.astype(np.float32).clip(-FARTHEST_TEXEL, FARTHEST_TEXEL)
        cell = NODE_PX * self._finer
        size = (u.shape[1] * cell, u.shape[0] * cell)
        full = cv2.resize(cv2.merge((u, v)), size, interpolation=cv2.INTER_LINEAR)
        view = image[top * cell : bottom * cell, left * cell : right * cell]
        texels = full[cell : cell + view.shape[0], cell : cell + view.shape[1]]
        border = cv2.BORDER_WRAP if part is None else cv2.BORDER_TRANSPARENT
        # both coordinates are in the first map: OpenCV's type stubs do not know that there may be no second
        cv2.remap(tile, texels, None, cv2.INTER_LINEAR, dst=view, borderMode=border)  # type: ignore[call-overload]

    def _through_lens(self, image: GreyImage, seen: _Surface, part: Part | None) -> GreyImage:
        """Defocus, motion blur, vignetting and dirt, in the order in which they happen."""
        sigma = self._defocus_px(seen.height_m)
        if sigma > 0.2:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=np.uint8)
        if self._settings.motion_blur:
            image = motion_blur(image, *self._stroke_px(seen, part))
        if self._vignette is not None:
            cv2.multiply(image, self._vignette, dst=image, scale=self._settings.gain / 255.0)
        return image

    def _expose(
        self, light: GreyImage, glow: NDArray[np.float32] | None, part: Part | None, out: GreyImage
    ) -> None:
        """The grey values that the sensor makes of the light; without a light of the scenario's, as it is.

        `glow` is the sun's image in a part of the picture: it is too bright to be drawn with the rest.
        """
        metering = self._metering
        if metering is None:
            through(self._encoded, light, out)
            if self._noise is not None:
                self._noise.add(out)
            return
        through(response(metering.brightness, self._light.veil), light, out)
        if glow is not None and part is not None:
            view = out[part[0] * NODE_PX :, part[2] * NODE_PX :][: glow.shape[0], : glow.shape[1]]
            rows, columns = view.shape
            add_light(view, glow[:rows, :columns] * (PAD_WHITE * metering.brightness))
        # it is light that is metered
        gain = metering.now.gain
        metering.look(out)
        self._set_exposure(metering.now.exposure_s)
        if self._noise is None:
            through(self._encoded, out, out)
            return
        white_std_grey = self._settings.noise_grey
        there, back, std_grey = levelled(white_std_grey, gain, self._camera.encoding)
        through(there, out, out)
        self._noise.add_times(std_grey / white_std_grey, out)
        through(back, out, out)

    def _defocus_px(self, distance_m: float) -> float:
        """Standard deviation of the blur: the lens's own, and the circle of confusion (diameter / 4)."""
        s = self._settings
        circle = self._camera.fx_px * s.aperture_m * abs(1.0 / max(distance_m, 0.02) - 1.0 / s.focus_m)
        return math.hypot(s.lens_blur_px, 0.25 * circle)

    def _stroke_px(self, surface: _Surface, part: Part | None) -> tuple[float, float]:
        """How far (right, down) the surface moves in the image within the exposure, at the part's middle."""
        if self._exposure_s == 0.0:
            return (0.0, 0.0)
        top, bottom, left, right = part or (0, self._node_rays.shape[0] - 2, 0, self._node_rays.shape[1] - 2)
        r, c = (top + bottom) // 2 + 1, (left + right) // 2 + 1
        here, right, below = self._node_rays[[r, r, r + 1], [c, c + 1, c]].tolist()
        poses = surface.texel_from_ray
        first, middle, last = poses[[0, len(poses) // 2, -1]].tolist()
        u, v = _texel(middle, here)
        # texels a pixel to the right and a pixel down
        (ru, rv), (du, dv) = _texel(middle, right), _texel(middle, below)
        ru, rv, du, dv = ((ru - u) / NODE_PX, (rv - v) / NODE_PX, (du - u) / NODE_PX, (dv - v) / NODE_PX)
        (u0, v0), (u1, v1) = _texel(first, here), _texel(last, here)
        mu, mv = u0 - u1, v0 - v1
        share = self._exposure_s / self.span_s / (ru * dv - du * rv)
        return ((mu * dv - du * mv) * share, (ru * mv - mu * rv) * share)


def _pad_attitude(scene: ScenePose) -> Quaternion:
    return quat_from_euler(scene.pad_roll_rad, scene.pad_pitch_rad, scene.pad_heading_rad)


def _texel(texel_from_ray: list[list[float]], ray: list[float]) -> tuple[float, float]:
    u, v, w = (row[0] * ray[0] + row[1] * ray[1] + row[2] for row in texel_from_ray)
    scale = 1.0 / max(w, HORIZON)
    return u * scale, v * scale
