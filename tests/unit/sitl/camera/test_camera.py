"""The simulated camera against geometry worked out apart from it, with OpenCV's projection."""

import asyncio
import math
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    matrix_from_quat,
    quat_from_euler,
    quat_integrate,
)
from companion.config import CONFIG_FOLDER, CameraConfig, ConfigError, VehicleConfig, find_file, load_model
from companion.pad import Marker, Pad, load_pad
from companion.sense.camera.source import open_camera
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import (
    AutoExposure,
    DirtSettings,
    ExposureSettings,
    ImagingSettings,
    levelled,
    motion_blur,
    noise_std_grey,
    response,
)
from sitl.camera.light import GlareSettings, LightSettings, ShadowSettings
from sitl.camera.textures import pad_texture
from sitl.devices.socket_servers import MOST_PATH_BYTES, UnixServer

SHARP = ImagingSettings(
    exposure_s=0.0, readout_s=0.0, noise_grey=0.0, lens_blur_px=0.5, aperture_m=0.0, vignette=0.0
)
PRINTED = load_pad("moving_1300")
# by a printer whose dots are too small to see
PAD = PRINTED.model_copy(update={"sheet": PRINTED.sheet.model_copy(update={"dots_per_inch": 2400.0})})
# what is looked at here is light, before it is encoded
CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480")).model_copy(
    update={"encoding": "linear"}
)
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
MATRIX = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1.0]])
# image right is the body's right, image down its back
CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
LEVEL = quat_from_euler(0.0, 0.0, 0.0)
DECK = (0.0, 0.0, -0.3)

Scene = Callable[[float], ScenePose]


def model(settings: ImagingSettings, pad: Pad = PAD, seed: int = 0) -> CameraModel:
    cv2.setNumThreads(1)
    return CameraModel(CAMERA, VEHICLE, pad, settings, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def sharp() -> CameraModel:
    return model(SHARP)


def still(position: Vector3, attitude: Quaternion = LEVEL, heading: float = 0.0) -> Scene:
    return lambda _: ScenePose(position, attitude, DECK, heading)


def projected(points_pad_m: FloatArray, scene: ScenePose) -> FloatArray:
    """Pixels (n, 2) of points (n, 3) of the pad."""
    c, s = math.cos(scene.pad_heading_rad), math.sin(scene.pad_heading_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    world = points_pad_m @ turn.T + scene.pad_position_ned_m
    body = (world - scene.vehicle_position_ned_m) @ matrix_from_quat(scene.vehicle_attitude)
    points = (body - VEHICLE.camera_position_body_m) @ CAMERA_FROM_BODY.T
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, np.array(CAMERA.distortion))
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def corner_errors(
    image: NDArray[np.uint8], marker: Marker, see: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """How far (px) each of a marker's corners (4, 2) is from where `see` puts it.

    From the sides: across each, at points along it, the middle of the grey's slope is where the edge is. The
    usual corner refinement is not used, because it is drawn inwards by a third of the blur's sigma.
    """
    corners = marker.corners_pad_m()
    share = np.linspace(0.08, 0.92, 15)[:, None]
    sides = [see(corners[k] + share * (corners[(k + 1) % 4] - corners[k])) for k in range(4)]
    cell = float(np.linalg.norm(sides[0][-1] - sides[0][0])) / (int(marker.dictionary[0]) + 2)
    reach = np.linspace(-1.0, 1.0, 41) * min(0.42 * cell, 6.0)
    normals, ends = [], []
    for side in sides:
        along = (side[-1] - side[0]) / np.linalg.norm(side[-1] - side[0])
        normal = np.array([along[1], -along[0]])  # outwards
        at = (side[:, None, :] + reach[None, :, None] * normal).astype(np.float32)
        grey = cv2.remap(image.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        slope = np.diff(np.asarray(grey, dtype=np.float64), axis=1)
        middle = 0.5 * (reach[1:] + reach[:-1])
        line = np.polyfit(share[:, 0], slope @ middle / slope.sum(axis=1), 1)
        normals.append(normal)
        ends.append((float(np.polyval(line, 0.0)), float(np.polyval(line, 1.0))))
    errors = [
        np.linalg.solve(np.array([normals[k - 1], normals[k]]), [ends[k - 1][1], ends[k][0]])
        for k in range(4)
    ]
    return np.array(errors)


def in_view(pixels: FloatArray) -> bool:
    return bool((pixels > 12.0).all() and (pixels < (627.0, 467.0)).all())


def errors_of_group(
    image: NDArray[np.uint8], group: str, see: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Corner errors (n, 2) of all markers of a group that are whole in the image."""
    markers = [m for m in PAD.markers if m.group == group and in_view(see(m.corners_pad_m()))]
    assert markers
    return np.concatenate([corner_errors(image, marker, see) for marker in markers])


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0, 25.0])
@pytest.mark.parametrize(("height_m", "group"), [(0.25, "C"), (1.0, "M"), (2.0, "F"), (3.0, "F"), (5.0, "F")])
def test_corners_are_where_geometry_puts_them(
    sharp: CameraModel, height_m: float, group: str, yaw_deg: float
) -> None:
    tilt = 0.08 if height_m > 0.5 else 0.03
    attitude = quat_from_euler(tilt, -0.7 * tilt, math.radians(yaw_deg))
    scene = still((0.03 * height_m, -0.02 * height_m, -height_m - 0.38), attitude, 0.35)
    errors = errors_of_group(sharp.render(0.0, scene), group, lambda p: projected(p, scene(0.0)))
    assert np.abs(errors.mean(axis=0)).max() < 0.03
    assert np.sqrt((errors**2).mean()) < 0.06
    assert np.abs(errors).max() < 0.15


def test_the_lens_bends_what_is_near_the_images_corners(sharp: CameraModel) -> None:
    scene = still((0.62, 0.9, -3.38))
    image = sharp.render(0.0, scene)
    marker = PAD.markers[2]
    pixels = projected(marker.corners_pad_m(), scene(0.0))
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), MATRIX, np.array(CAMERA.distortion))
    straight = np.asarray(rays).reshape(4, 2) * CAMERA.fx_px + MATRIX[:2, 2]
    assert np.abs(straight - pixels).max() > 2.0
    assert np.abs(corner_errors(image, marker, lambda p: projected(p, scene(0.0)))).max() < 0.1


def test_each_row_shows_the_moment_at_which_it_is_exposed() -> None:
    readout = 0.02
    camera = model(SHARP.model_copy(update={"readout_s": readout}))
    attitude = quat_from_euler(0.03, 0.0, 0.4)

    def scene(time_s: float) -> ScenePose:
        turned = quat_integrate(attitude, (0.6, -0.5, 0.4), time_s)
        return ScenePose((0.8 * time_s, -1.2 * time_s, -2.4), turned, (1.5 * time_s, 0.0, -0.3), 0.2)

    def see(points: FloatArray) -> FloatArray:
        """The row depends on the time, which depends on the row."""
        pixels = projected(points, scene(0.0))
        for _ in range(4):
            times = ((pixels[:, 1] + 0.5) / CAMERA.height_px - 0.5) * readout
            pixels = np.concatenate(
                [projected(p[None], scene(float(t))) for p, t in zip(points, times, strict=True)]
            )
        return pixels

    image = camera.render(0.0, scene)
    for group in ("F", "M"):
        assert np.abs(errors_of_group(image, group, see)).max() < 0.15
    assert np.abs(errors_of_group(image, "M", lambda p: projected(p, scene(0.0)))).max() > 1.0


@pytest.mark.parametrize(
    ("ahead", "right", "quadrant"),
    [(0.7, 0.0, (0, -1)), (-0.7, 0.0, (0, 1)), (0.0, 0.7, (1, 0)), (0.0, -0.7, (-1, 0))],
)
@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_what_is_ahead_is_up_in_the_image_and_right_is_right(
    sharp: CameraModel, ahead: float, right: float, quadrant: tuple[int, int], yaw_deg: float
) -> None:
    yaw = math.radians(yaw_deg)
    north = ahead * math.cos(yaw) - right * math.sin(yaw)
    east = ahead * math.sin(yaw) + right * math.cos(yaw)
    image = sharp.render(0.0, still((-north, -east, -4.3), quat_from_euler(0.0, 0.0, yaw)))
    rows, columns = np.nonzero(image > 210)  # the white of the board
    off = np.array([columns.mean() - CAMERA.cx_px, rows.mean() - CAMERA.cy_px])
    assert off @ quadrant > 60.0
    assert abs(off @ (quadrant[1], quadrant[0])) < 15.0


def test_the_same_seed_gives_the_same_picture_and_another_seed_another_noise_of_the_strength_asked_for() -> (
    None
):
    scene, noisy = still((0.0, 0.0, -0.6)), SHARP.model_copy(update={"noise_grey": 5.0})
    first, second, other = (model(noisy, seed=s).render(0.0, scene) for s in (1, 1, 2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)
    noise = first.astype(float) - model(SHARP).render(0.0, scene)
    assert noise.std() == pytest.approx(5.0, abs=0.2)
    assert noise.mean() == pytest.approx(0.0, abs=0.1)


def test_motion_smears_along_its_direction_and_moves_nothing() -> None:
    camera = model(SHARP.model_copy(update={"exposure_s": 0.004}))

    def scene(time_s: float) -> ScenePose:
        return ScenePose((0.0, 2.0 * time_s, -1.38), LEVEL, DECK, 0.0)

    smeared, sharp_image = camera.render(0.0, scene), model(SHARP).render(0.0, scene)
    errors = errors_of_group(smeared, "M", lambda p: projected(p, scene(0.0)))
    assert np.abs(errors.mean(axis=0)).max() < 0.05
    assert np.abs(errors).max() < 0.2
    contrast = [
        float(np.percentile(np.abs(np.diff(picture.astype(float), axis=axis)), 99.5))
        for picture in (sharp_image, smeared)
        for axis in (0, 1)
    ]
    assert contrast[2] > 0.7 * contrast[0]  # up and down stays sharp
    assert contrast[3] < 0.55 * contrast[1]  # 4 px at 532 px/m and 8 mm: left and right does not


def test_close_to_the_pad_the_picture_is_out_of_focus() -> None:
    lens = SHARP.model_copy(update={"aperture_m": 0.0015})
    scene = still((0.0, 0.0, -0.48))
    sharp_image, soft = model(SHARP).render(0.0, scene), model(lens).render(0.0, scene)
    assert np.abs(np.diff(soft.astype(float))).max() < 0.6 * np.abs(np.diff(sharp_image.astype(float))).max()


def test_without_a_pad_in_view_there_is_ground_everywhere(sharp: CameraModel) -> None:
    for position in ((300.0, -200.0, -7.0), (-35.0, 18.0, -0.2), (1e4, 1e4, -30.0)):
        image = sharp.render(0.0, still(position, quat_from_euler(0.2, -0.3, 1.0)))
        assert 60.0 < image.mean() < 150.0
        assert image.std() > 3.0
        assert image.min() > 0
    # nor is a pad seen from below the deck's surface
    assert (sharp.render(0.0, still((0.0, 0.0, -0.2))) < 200).all()


def test_a_turned_and_tilted_camera_looks_where_it_points() -> None:
    mounted = VEHICLE.model_copy(update={"camera_yaw_deg": 90.0, "camera_tilt_deg": 30.0})
    camera = CameraModel(CAMERA, mounted, PAD, SHARP, np.random.default_rng(0))
    # turned right by 90 degrees and up by 30, it has what is 3 tan(30) m to the right in the middle
    image = camera.render(0.0, still((0.0, -3.0 * math.tan(math.radians(30.0)), -3.38)))
    rows, columns = np.nonzero(image > 210)
    assert abs(columns.mean() - CAMERA.cx_px) < 25.0
    assert abs(rows.mean() - CAMERA.cy_px) < 25.0


@pytest.mark.parametrize("stroke", [(1.0, 0.5), (7.0, -3.0), (-18.0, 11.0), (0.0, 40.0)])
def test_a_stroke_keeps_the_light_and_its_centre(stroke: tuple[float, float]) -> None:
    image = np.zeros((121, 121), np.uint8)
    image[56:65, 56:65] = 240
    blurred = motion_blur(image, *stroke).astype(float)
    y, x = np.mgrid[0:121, 0:121]
    total = blurred.sum()
    assert total == pytest.approx(image.sum(), rel=0.06)
    assert (blurred * x).sum() / total == pytest.approx(60.0, abs=0.35)
    assert (blurred * y).sum() / total == pytest.approx(60.0, abs=0.35)
    length = math.hypot(*stroke)
    along = ((x - 60) * stroke[0] + (y - 60) * stroke[1]) / length
    spread = (blurred * along**2).sum() / total - (81 - 1) / 12.0
    assert spread == pytest.approx(length**2 / 12.0, rel=0.2, abs=1.5)


def test_every_scale_of_the_pads_print_is_an_average_of_the_finest() -> None:
    texture = pad_texture(PAD)
    finest = texture.levels[0].image.mean()
    for level in texture.levels:
        assert level.image.mean() == pytest.approx(float(finest), abs=0.6)
    densities = [level.texels_per_m for level in texture.levels]
    assert densities == sorted(densities, reverse=True)
    assert texture.level_for(100.0).texels_per_m <= 120.0 < 2.0 * texture.level_for(100.0).texels_per_m


def test_a_marker_printed_at_an_angle_has_its_corners_where_the_data_say() -> None:
    turned = Marker(
        dictionary="4x4_50", id=3, side_m=0.3, position_pad_m=(0.05, -0.07), yaw_deg=31.0, group="F"
    )
    pad = Pad(name="one", width_m=0.8, length_m=0.6, markers=(turned,))
    scene = still((0.0, 0.0, -1.4))
    image = model(SHARP, pad).render(0.0, scene)
    assert np.abs(corner_errors(image, turned, lambda p: projected(p, scene(0.0)))).max() < 0.06


# ----------------
# The example of docs/reference/camera-frames.md feeds the app: run as written, in its own process.

PAGE = (CONFIG_FOLDER.parent / "docs" / "reference" / "camera-frames.md").read_text(encoding="utf-8")


def example(folder: Path) -> Path:
    found = re.search(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert found is not None
    assert len(found[1].splitlines()) <= 25
    path = folder / "feed.py"
    path.write_text(found[1])
    return path


async def test_the_example_feeds_the_app(tmp_path: Path) -> None:
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    pictures = tmp_path / "pictures"
    await asyncio.to_thread(pictures.mkdir)
    for k in range(2):
        cv2.imwrite(str(pictures / f"{k}.png"), np.full((480, 640), 50 + 100 * k, np.uint8))
    words = (sys.executable, str(example(tmp_path)), str(tmp_path / "frames"), str(pictures))
    process = await asyncio.to_thread(subprocess.Popen, words, stderr=subprocess.DEVNULL)
    try:
        while not await asyncio.to_thread((tmp_path / "frames").is_socket):  # noqa: ASYNC110 - a process's
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.1)  # between bind and listen
        source = await open_camera(f"socket:{tmp_path / 'frames'}", camera)
        frames = [await asyncio.wait_for(source.next(), 5.0) for _ in range(3)]
        source.close()
    finally:
        process.kill()
        await asyncio.to_thread(process.wait)
    assert [f.sequence for f in frames] == sorted({f.sequence for f in frames})
    assert {int(f.image[0, 0]) for f in frames} <= {50, 150}
    assert all(0.0 <= f.received_s - f.time_s < 1.0 for f in frames)
    assert frames[-1].time_s <= Clock().now_s()


# ---------------- Light: exposure and its price, shade, glare, veil, and dirt on the lens

FLAT = {"readout_s": 0.0, "lens_blur_px": 0.0, "aperture_m": 0.0, "vignette": 0.0}

Image = NDArray[np.uint8]


FIXED = ExposureSettings(automatic=False)
USUAL_LUX = 3333.3  # at which a fixed exposure is right


def settings(**values: object) -> ImagingSettings:
    return ImagingSettings.model_validate({"exposure_s": 0.003, "noise_grey": 0.0, **FLAT, **values})


def lit(exposure: ExposureSettings = FIXED, **light: Any) -> ImagingSettings:
    return settings(light=LightSettings(**{"illuminance_lux": USUAL_LUX, **light}), exposure=exposure)


def lit_scene(height_m: float = 2.0, **pad: float) -> Scene:
    return lambda _: ScenePose((0.0, 0.0, -height_m), LEVEL, DECK, 0.0, **pad)


def pictures(chosen: ImagingSettings, scene: Scene, count: int = 1) -> list[Image]:
    camera = model(chosen, PRINTED)
    return [camera.render(k / 30.0, scene) for k in range(count)]


def picture(chosen: ImagingSettings, scene: Scene, count: int = 1) -> Image:
    """The last of so many."""
    return pictures(chosen, scene, count)[-1]


# ---------------------------------------------------------------- exposure


@pytest.mark.parametrize(
    ("lux", "exposure_s", "gain"),
    [(100_000.0, 0.0001, 1.0), (3333.3, 0.003, 1.0), (250.0, 0.01, 4.0), (1.0, 0.01, 16.0)],
)
def test_less_light_takes_a_longer_exposure_and_then_gain(lux: float, exposure_s: float, gain: float) -> None:
    metering = AutoExposure(ExposureSettings(), 0.003, lux)
    assert metering.now.exposure_s == pytest.approx(exposure_s, rel=0.01)
    assert metering.now.gain == pytest.approx(gain, rel=0.01)


def test_an_automatic_exposure_comes_to_the_right_mean_and_a_fixed_one_stays() -> None:
    def look(metering: AutoExposure) -> float:
        for _ in range(60):
            metering.look(np.full((48, 64), min(255.0, 40.0 * metering.brightness), np.uint8))
        return 40.0 * metering.brightness

    assert look(AutoExposure(ExposureSettings(), 0.003, 1000.0)) == pytest.approx(112.0, abs=4.0)
    fixed = AutoExposure(ExposureSettings(automatic=False, gain=2.0), 0.003, 1000.0)
    assert look(fixed) == pytest.approx(40.0 * 1000.0 * 0.003 * 2.0 / 10.0)


def test_the_camera_adapts_to_what_it_sees() -> None:
    # nothing but bright board: the first picture is too bright, later ones are not
    light = settings(light=LightSettings(illuminance_lux=2000.0))
    first, *_, last = pictures(light, lit_scene(0.6), 60)
    assert abs(float(last.mean()) - 112.0) < 6.0 < abs(float(first.mean()) - 112.0)


def test_too_much_light_for_a_fixed_exposure_saturates() -> None:
    bright, dark = (picture(lit(illuminance_lux=lux), lit_scene()) for lux in (50_000.0, 100.0))
    assert (bright == 255).mean() > 0.6
    assert dark.max() < 12


def test_noise_is_constant_on_the_levelled_scale_and_as_strong_as_asked_for_off_it() -> None:
    std = noise_std_grey(3.0, 8.0)
    assert noise_std_grey(3.0, 1.0)[222] == pytest.approx(3.0)
    there, back, level = levelled(3.0, 8.0)
    noise = np.random.default_rng(1).normal(0.0, level, 40_000)
    for grey in (40, 100, 180):
        noisy = np.rint(there[grey] + noise).clip(0, 255).astype(np.uint8)
        seen = back[noisy].astype(float)
        assert seen.std() == pytest.approx(std[grey], rel=0.15)
        assert seen.mean() == pytest.approx(grey, abs=2.0)


def test_dusk_is_noisier_than_day_most_of_all_where_it_is_bright() -> None:
    def noise(lux: float) -> tuple[float, float]:
        chosen = settings(noise_grey=3.0, light=LightSettings(illuminance_lux=lux))
        a, b = pictures(chosen, lit_scene(1.2), 2)
        off = a.astype(float) - b
        white, black = (a > 150) & (a < 245), a < 60
        return float(off[white].std()) / math.sqrt(2.0), float(off[black].std()) / math.sqrt(2.0)

    day, dusk = noise(3000.0), noise(60.0)
    assert dusk[0] > 3.0 * day[0]
    assert dusk[0] > 1.2 * dusk[1]


def test_dusk_smears_more_than_day_unless_blur_is_off() -> None:
    def edge(lux: float, **values: bool) -> float:
        chosen = settings(light=LightSettings(illuminance_lux=lux), **values)

        def scene(time_s: float) -> ScenePose:
            return ScenePose((0.0, 2.0 * time_s, -1.4), LEVEL, DECK, 0.0)

        return float(np.percentile(np.abs(np.diff(picture(chosen, scene).astype(float), axis=1)), 99.5))

    assert edge(500.0) < 0.6 * edge(30_000.0)
    assert edge(500.0, motion_blur=False) > 0.9 * edge(30_000.0)


# ---------------------------------------------------------------- shade, veil, dirt


def seen_at(image: Image, north_m: float, east_m: float, height_m: float = 2.0) -> float:
    """Mean grey about a place of the board's plane, seen from above the pad's middle."""
    depth = height_m - 0.3 - VEHICLE.camera_position_body_m[2] * -1.0
    x0, y0, _ = VEHICLE.camera_position_body_m
    column = round(CAMERA.cx_px + CAMERA.fx_px * (east_m - y0) / depth)
    row = round(CAMERA.cy_px - CAMERA.fy_px * (north_m - x0) / depth)
    return float(image[row - 3 : row + 4, column - 3 : column + 4].mean())


@pytest.mark.parametrize(
    ("course_deg", "sunny"), [(0.0, (0.3, 0.0)), (90.0, (0.0, 0.3)), (180.0, (-0.3, 0.0))]
)
def test_behind_a_shadows_edge_there_is_shade(course_deg: float, sunny: tuple[float, float]) -> None:
    shadow = ShadowSettings(depth=0.6, course_deg=course_deg, speed_m_s=0.5, crosses_s=0.0)
    shaded, clear = (picture(lit(shadow=each), lit_scene()) for each in (shadow, None))
    assert seen_at(shaded, *sunny) == pytest.approx(seen_at(clear, *sunny), abs=2.0)
    dark = (-sunny[0], -sunny[1])
    assert seen_at(shaded, *dark) == pytest.approx(0.4 * seen_at(clear, *dark), abs=3.0)


def test_a_shadow_moves_and_stripes_repeat() -> None:
    def row(stripes_m: float | None, frames: int) -> FloatArray:
        shadow = ShadowSettings(depth=0.9, course_deg=90.0, speed_m_s=0.6, crosses_s=0.0, stripes_m=stripes_m)
        shaded, clear = (picture(lit(shadow=each), lit_scene(5.0), frames) for each in (shadow, None))
        return np.asarray((shaded.astype(float) / clear.clip(1, None)).mean(axis=0))

    # the edge is where half the columns' light is; a second later 0.6 m to the right
    before, after = (int(np.argmax(row(None, frames) > 0.55)) for frames in (1, 31))
    assert (after - before) * 4.7 / CAMERA.fx_px == pytest.approx(0.6, abs=0.03)
    stripes = row(1.0, 1) > 0.55
    assert np.abs(np.diff(stripes.astype(int))).sum() >= 8


def test_a_veil_takes_contrast() -> None:
    clear, veiled = (picture(lit(veil=veil), lit_scene()) for veil in (0.0, 0.5))
    assert np.ptp(veiled[100:380, 200:440]) == pytest.approx(0.5 * np.ptp(clear[100:380, 200:440]), abs=3.0)
    assert veiled.min() > 110


def test_the_response_saturates_and_a_right_exposure_changes_nothing() -> None:
    assert response(1.0, 0.0).tolist() == list(range(256))
    assert response(2.0, 0.0)[[0, 50, 127, 128, 200]].tolist() == [0, 100, 254, 255, 255]


def test_dirt_stays_where_it_is_in_the_image() -> None:
    dirty = settings(dirt=DirtSettings(blobs=15, opacity=0.9))
    shares = []
    for heading in (0.0, 1.0):

        def scene(_: float, heading: float = heading) -> ScenePose:
            return ScenePose((0.0, 0.0, -0.6), quat_from_euler(0.0, 0.0, heading), DECK, 0.0)

        clean = picture(settings(), scene).astype(float).clip(1.0, None)
        shares.append(picture(dirty, scene) / clean)
    assert 0.02 < (shares[0] < 0.8).mean() < 0.6
    assert np.abs(shares[0] - shares[1]).max() < 0.2
    assert np.median(shares[0]) > 0.9


# ---------------------------------------------------------------- the sun's image


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (math.radians(5.0), math.radians(-4.0))])
@pytest.mark.parametrize("azimuth_deg", [0.0, 120.0])
def test_the_sun_is_mirrored_where_the_angles_are_equal(
    azimuth_deg: float, tilt: tuple[float, float]
) -> None:
    glare = GlareSettings(elevation_deg=80.0, azimuth_deg=azimuth_deg, strength=1000.0, spread_deg=0.5)
    roll, pitch = tilt
    scene = lit_scene(1.6, pad_roll_rad=roll, pad_pitch_rad=pitch)
    shining, dull = (picture(lit(glare=each), scene) for each in (glare, None))
    rows, columns = np.nonzero((shining > 254) & (dull < 254))
    spot = np.array([[columns.mean(), rows.mean()]])
    assert len(rows) > 300
    # the ray that is seen there, thrown back by the deck, goes to the sun
    x, y = cv2.undistortPoints(spot.reshape(1, 1, 2), MATRIX, np.array(CAMERA.distortion)).ravel()
    ray = np.array([-y, x, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    normal = matrix_from_quat(quat_from_euler(roll, pitch, 0.0))[:, 2]
    thrown = ray - 2.0 * (ray @ normal) * normal
    azimuth, elevation = math.radians(azimuth_deg), math.radians(80.0)
    flat = math.cos(elevation)
    sun = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), -math.sin(elevation)])
    assert math.degrees(math.acos(float(thrown @ sun))) < 1.0


def test_grass_does_not_shine() -> None:
    away = still((30.0, 0.0, -2.0))
    shining, dull = (picture(lit(glare=each), away) for each in (GlareSettings(elevation_deg=85.0), None))
    assert np.array_equal(shining, dull)


# ---------------- Sockets at a path: whose they are, and what is in the way


async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.close()


async def test_one_that_is_served_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "camera"
    first = await UnixServer.start(silent, path)
    before = path.stat().st_ino
    with pytest.raises(ConfigError, match="another simulator serves there; expected a folder of its own"):
        await UnixServer.start(silent, path)
    assert path.stat().st_ino == before
    first.close()
    assert not path.exists()


async def test_one_that_was_left_behind_is_replaced_and_anothers_is_not_removed(tmp_path: Path) -> None:
    path = tmp_path / "camera"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    server = await UnixServer.start(silent, path)
    path.rename(tmp_path / "mine")  # whose number is not given to another meanwhile
    path.write_text("somebody else's")
    server.close()
    assert path.read_text() == "somebody else's"


async def test_what_is_in_the_way_is_reported(tmp_path: Path) -> None:
    (tmp_path / "camera").write_text("a file")
    with pytest.raises(ConfigError, match="is in the way of a socket"):
        await UnixServer.start(silent, tmp_path / "camera")
    with pytest.raises(ConfigError, match="too long for a socket"):
        await UnixServer.start(silent, tmp_path / ("x" * MOST_PATH_BYTES))
    with pytest.raises(ConfigError, match="No such file or directory; expected a folder"):
        await UnixServer.start(silent, tmp_path / "nowhere" / "camera")
