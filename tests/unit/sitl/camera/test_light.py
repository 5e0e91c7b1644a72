"""Light: exposure and its price, shade, glare, veil, and dirt on the lens."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import matrix_from_quat, quat_from_euler
from companion.config import CameraConfig, VehicleConfig, find_file, load_model
from companion.pad import load_pad
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import (
    AutoExposure,
    DirtSettings,
    ExposureSettings,
    ImagingSettings,
    levelled,
    noise_std_grey,
    response,
)
from sitl.camera.light import GlareSettings, LightSettings, ShadowSettings

PAD = load_pad("moving_1300")
# what is looked at here is light, before it is encoded
CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480")).model_copy(
    update={"encoding": "linear"}
)
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
LEVEL = quat_from_euler(0.0, 0.0, 0.0)
DECK = (0.0, 0.0, -0.3)
FLAT = {"readout_s": 0.0, "lens_blur_px": 0.0, "aperture_m": 0.0, "vignette": 0.0}

Image = NDArray[np.uint8]
Scene = Callable[[float], ScenePose]


def settings(**values: object) -> ImagingSettings:
    return ImagingSettings.model_validate({"exposure_s": 0.003, "noise_grey": 0.0, **FLAT, **values})


def still(height_m: float = 2.0, **pad: float) -> Scene:
    return lambda _: ScenePose((0.0, 0.0, -height_m), LEVEL, DECK, 0.0, **pad)


def pictures(chosen: ImagingSettings, scene: Scene, count: int = 1, seed: int = 0) -> list[Image]:
    cv2.setNumThreads(1)
    model = CameraModel(CAMERA, VEHICLE, PAD, chosen, np.random.default_rng(seed))
    return [model.render(k / 30.0, scene) for k in range(count)]


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
    first, *_, last = pictures(light, still(0.6), 60)
    assert abs(float(last.mean()) - 112.0) < 6.0 < abs(float(first.mean()) - 112.0)


def test_too_much_light_for_a_fixed_exposure_saturates() -> None:
    fixed = ExposureSettings(automatic=False)
    bright = picture(settings(light=LightSettings(illuminance_lux=50_000.0), exposure=fixed), still())
    dark = picture(settings(light=LightSettings(illuminance_lux=100.0), exposure=fixed), still())
    assert (bright == 255).mean() > 0.6
    assert dark.max() < 12


def test_noise_is_constant_on_the_levelled_scale_and_as_strong_as_asked_for_off_it() -> None:
    std = noise_std_grey(3.0, 8.0)
    assert noise_std_grey(3.0, 1.0)[222] == pytest.approx(3.0)
    there, back, level = levelled(std)
    noise = np.random.default_rng(1).normal(0.0, level, 40_000)
    for grey in (40, 100, 180):
        noisy = np.rint(there[grey] + noise).clip(0, 255).astype(np.uint8)
        seen = back[noisy].astype(float)
        assert seen.std() == pytest.approx(std[grey], rel=0.15)
        assert seen.mean() == pytest.approx(grey, abs=2.0)


def test_dusk_is_noisier_than_day_most_of_all_where_it_is_bright() -> None:
    def noise(lux: float) -> tuple[float, float]:
        fixed = ExposureSettings(automatic=True)
        chosen = settings(noise_grey=3.0, light=LightSettings(illuminance_lux=lux), exposure=fixed)
        a, b = pictures(chosen, still(1.2), 2)
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
            return ScenePose((0.0, 2.0 * time_s, -1.4), LEVEL, (0.0, 0.0, -0.3), 0.0)

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


@pytest.mark.parametrize(("course_deg", "lit"), [(0.0, (0.3, 0.0)), (90.0, (0.0, 0.3)), (180.0, (-0.3, 0.0))])
def test_behind_a_shadows_edge_there_is_shade(course_deg: float, lit: tuple[float, float]) -> None:
    shadow = ShadowSettings(depth=0.6, course_deg=course_deg, speed_m_s=0.5, crosses_s=0.0)
    fixed = ExposureSettings(automatic=False)
    light = LightSettings(illuminance_lux=3333.3, shadow=shadow)
    shaded = picture(settings(light=light, exposure=fixed), still())
    clear = picture(settings(light=light.model_copy(update={"shadow": None}), exposure=fixed), still())
    assert seen_at(shaded, *lit) == pytest.approx(seen_at(clear, *lit), abs=2.0)
    dark = (-lit[0], -lit[1])
    assert seen_at(shaded, *dark) == pytest.approx(0.4 * seen_at(clear, *dark), abs=3.0)


def test_a_shadow_moves_and_stripes_repeat() -> None:
    fixed = ExposureSettings(automatic=False)

    def row(stripes_m: float | None, frames: int) -> NDArray[np.float64]:
        shadow = ShadowSettings(depth=0.9, course_deg=90.0, speed_m_s=0.6, crosses_s=0.0, stripes_m=stripes_m)
        light = LightSettings(illuminance_lux=3333.3, shadow=shadow)
        shaded = picture(settings(light=light, exposure=fixed), still(5.0), frames)
        clear = picture(
            settings(light=LightSettings(illuminance_lux=3333.3), exposure=fixed), still(5.0), frames
        )
        return np.asarray((shaded.astype(float) / clear.clip(1, None)).mean(axis=0))

    before, after = row(None, 1), row(None, 31)
    # the edge is where half the columns' light is; a second later 0.6 m to the right
    edges = [int(np.argmax(light > 0.55)) for light in (before, after)]
    assert (edges[1] - edges[0]) * 4.7 / CAMERA.fx_px == pytest.approx(0.6, abs=0.03)
    stripes = row(1.0, 1) > 0.55
    assert np.abs(np.diff(stripes.astype(int))).sum() >= 8


def test_a_veil_takes_contrast() -> None:
    fixed = ExposureSettings(automatic=False)
    clear, veiled = (
        picture(settings(light=LightSettings(illuminance_lux=3333.3, veil=veil), exposure=fixed), still())
        for veil in (0.0, 0.5)
    )
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
    light = LightSettings(illuminance_lux=3333.3, glare=glare)
    roll, pitch = tilt
    scene = still(1.6, pad_roll_rad=roll, pad_pitch_rad=pitch)
    fixed = ExposureSettings(automatic=False)
    lit = picture(settings(light=light, exposure=fixed), scene).astype(float)
    dull = picture(settings(light=light.model_copy(update={"glare": None}), exposure=fixed), scene)
    rows, columns = np.nonzero((lit > 254.0) & (dull < 254))
    spot = np.array([[columns.mean(), rows.mean()]])
    assert len(rows) > 300
    # the ray that is seen there, thrown back by the deck, goes to the sun
    matrix = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1.0]])
    x, y = cv2.undistortPoints(spot.reshape(1, 1, 2), matrix, np.array(CAMERA.distortion)).ravel()
    ray = np.array([-y, x, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    normal = matrix_from_quat(quat_from_euler(roll, pitch, 0.0))[:, 2]
    thrown = ray - 2.0 * (ray @ normal) * normal
    azimuth, elevation = math.radians(azimuth_deg), math.radians(80.0)
    flat = math.cos(elevation)
    sun = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), -math.sin(elevation)])
    assert math.degrees(math.acos(float(thrown @ sun))) < 1.0


def test_grass_does_not_shine() -> None:
    light = LightSettings(illuminance_lux=3333.3, glare=GlareSettings(elevation_deg=85.0))
    fixed = ExposureSettings(automatic=False)
    away: Scene = lambda _: ScenePose((30.0, 0.0, -2.0), LEVEL, DECK, 0.0)  # noqa: E731
    dull = picture(settings(light=LightSettings(illuminance_lux=3333.3), exposure=fixed), away)
    assert np.array_equal(picture(settings(light=light, exposure=fixed), away), dull)
