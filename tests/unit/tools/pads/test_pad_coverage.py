"""The predicted recall: its formula, its bounds, and the eyes' own over rendered frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config import CameraConfig, find_file, load_model
from companion.pad import Marker, Pad, load_pad
from companion.tools.pads.coverage import (
    FITTED,
    HOVER,
    SMALL_LENS,
    HoverSpread,
    Optics,
    RecallModel,
    predict,
    seen_between,
)
from tests.unit.tools.pads.hover_frames import Hover

CERTAIN = RecallModel(0.01, 50.0, 50.0, 50.0, 1.0)
HALF = RecallModel(0.01, 50.0, 50.0, 50.0, 0.5)
STILL = HoverSpread(0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def camera() -> CameraConfig:
    return load_model(CameraConfig, find_file("cameras", "sitl_640x480"))


def pad_of(*places: tuple[float, float, str]) -> Pad:
    """Markers of 10 cm at places, in groups."""
    return Pad.model_validate(
        {
            "name": "p",
            "width_m": 1.0,
            "length_m": 1.0,
            "markers": [
                {"dictionary": "4x4_50", "id": k, "side_m": 0.1, "position_pad_m": (x, y), "group": group}
                for k, (x, y, group) in enumerate(places)
            ],
        }
    )


def test_the_pad_is_missed_when_every_marker_is(camera: CameraConfig) -> None:
    pad = pad_of((0.2, 0.0, "F"), (-0.2, 0.0, "F"), (0.0, 0.3, "M"))
    coverage = predict(pad, camera, STILL, np.array([2.0]), model=HALF)
    assert coverage.groups["F"] == pytest.approx([1.0 - 0.5**2])
    assert coverage.groups["M"] == pytest.approx([0.5])
    assert coverage.pad == pytest.approx([1.0 - 0.5**3])
    assert set(coverage.groups) == {"F", "M"}


def test_a_marker_is_seen_from_the_height_at_which_it_is_whole_in_the_image(camera: CameraConfig) -> None:
    # its diagonal has to fit into the image's height, whichever way the vehicle points: 480 px less the edges
    pad = pad_of((0.0, 0.0, "C"))
    focal_px, side_px = camera.fy_px, 480.0 - 8.0
    always = focal_px * 0.1 * math.sqrt(2.0) / side_px
    never = focal_px * 0.1 / side_px
    heights = np.array([0.95 * never, 1.1 * always])
    assert predict(pad, camera, STILL, heights, model=CERTAIN).pad == pytest.approx([0.0, 1.0])
    between = predict(pad, camera, STILL, np.array([0.5 * (always + never)]), model=CERTAIN).pad[0]
    assert 0.2 < between < 0.8


def test_what_moves_or_is_out_of_focus_is_read_less(camera: CameraConfig) -> None:
    pad = pad_of((0.0, 0.0, "C"))

    def recall(spread: HoverSpread, optics: Optics = SMALL_LENS) -> float:
        return float(predict(pad, camera, spread, np.array([0.4]), optics).pad[0])

    assert recall(STILL) > 0.99
    # cells of 17 mm: 8 m/s smear 32 mm in 4 ms
    assert recall(HoverSpread(0.0, 0.0, 0.0, 8.0)) < 0.2
    assert recall(STILL, Optics(aperture_m=0.1)) < 0.1


def test_off_the_middle_less_is_in_view(camera: CameraConfig) -> None:
    pad = pad_of((0.0, 0.0, "C"))
    heights = np.array([0.3])
    centred, aside = (
        float(predict(pad, camera, HoverSpread(offset, 0.0, 0.0, 0.0), heights).pad[0])
        for offset in (0.0, 0.1)
    )
    assert centred > 0.98
    assert aside < 0.6


def test_the_fitted_curves_rise_with_the_cell_and_fall_with_blur() -> None:
    cells = np.geomspace(1.0, 40.0, 60)
    assert (np.diff(FITTED(cells, 0.1 * cells)) >= 0.0).all()
    blurs = np.linspace(0.05, 1.5, 60)
    assert (np.diff(FITTED(np.full(60, 10.0), 10.0 * blurs)) <= 0.0).all()
    assert FITTED(np.array([1.2, 4.0]), np.array([0.2, 0.5])) == pytest.approx([0.0, 1.0], abs=0.02)


def test_where_it_is_seen_lies_between_two_heights() -> None:
    heights, recall = np.array([0.1, 0.2, 0.4, 0.8]), np.array([0.0, 1.0, 1.0, 0.5])
    low, high = seen_between(heights, recall, 0.75)
    assert low == pytest.approx(0.1 * 2**0.75)
    assert high == pytest.approx(0.4 * 2**0.5)
    assert seen_between(heights, recall, 0.5)[1] == 0.8
    assert all(map(math.isnan, seen_between(heights, 0.5 * recall, 0.75)))


@pytest.mark.parametrize(
    ("name", "heights_m"),
    [("indoor_400", (0.08, 0.15, 0.3, 0.6, 1.2, 2.5, 4.0)), ("touchdown_1300", (0.06, 0.1, 0.5, 3.0, 12.0))],
)
def test_a_shipped_pad_is_seen_by_the_eyes_as_predicted(
    camera: CameraConfig, name: str, heights_m: tuple[float, ...]
) -> None:
    pad = load_pad(name)
    predicted = predict(pad, camera, HOVER, np.array(heights_m)).pad
    assert predicted.min() > 0.98
    hover = Hover(pad, "sitl_640x480", seed=1)
    assert min(hover.recall(height_m, 10) for height_m in heights_m) >= 0.8


def test_where_a_pad_is_predicted_blind_the_eyes_see_little(camera: CameraConfig) -> None:
    pad = load_pad("moving_1300")
    coverage = predict(pad, camera)
    assert 0.06 < coverage.blind_height_m < 0.08
    hover = Hover(pad, "sitl_640x480", seed=1)
    assert hover.recall(0.05, 20) <= 0.2
    assert hover.recall(0.12, 20) >= 0.9


def test_markers_that_no_group_has_take_no_part() -> None:
    marker = Marker(dictionary="4x4_50", id=0, side_m=0.1, position_pad_m=(0.0, 0.0), group="M")
    pad = Pad(name="p", width_m=0.3, length_m=0.3, markers=(marker,))
    hd = load_model(CameraConfig, find_file("cameras", "hd_1280x720"))
    assert set(predict(pad, hd, heights_m=np.array([1.0])).groups) == {"M"}
