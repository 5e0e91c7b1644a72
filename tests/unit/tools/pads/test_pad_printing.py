"""The prints are the pad: read from the files themselves, every marker is where the layout has it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.base.printing.page import PNG_DPI, save
from companion.pad import Pad, load_pad
from companion.tools.pads.printing import clip, draw_pad, place_labels, tiles, words_of
from tests.unit.tools.pads.printed import (
    PX_PER_MM,
    Printed,
    assembled,
    read_markers,
    read_pdf,
    read_svg,
    worst_miss_mm,
)

# some turned, of all dictionaries; a label has room beside each
TURNED = Pad.model_validate(
    {
        "name": "turned",
        "width_m": 0.2,
        "length_m": 0.16,
        "markers": [
            {"dictionary": name, "id": n, "side_m": side, "position_pad_m": at, "yaw_deg": yaw, "group": "F"}
            for name, n, side, at, yaw in (
                ("4x4_50", 2, 0.05, (0.03, -0.05), 30.0),
                ("5x5_50", 11, 0.03, (0.02, 0.06), -75.0),
                ("6x6_50", 49, 0.02, (-0.05, 0.01), 180.0),
            )
        ],
    }
)


@pytest.fixture(scope="module")
def indoor() -> Pad:
    return load_pad("indoor_400")


@pytest.fixture(scope="module")
def pdf(indoor: Pad, tmp_path_factory: pytest.TempPathFactory) -> list[Printed]:
    (path,) = save(draw_pad(indoor), tmp_path_factory.mktemp("pdf") / "pad.pdf")
    return read_pdf(path)


def test_tiles_cut_at_their_marks_and_laid_edge_to_edge_are_the_pad(indoor: Pad, pdf: list[Printed]) -> None:
    sheets = tiles(indoor, indoor.tiling())
    # six sheets and the plan
    assert (len(sheets), len(pdf)) == (6, 7)
    assert all(page.size_mm == pytest.approx((210.0, 297.0), abs=0.01) for page in pdf)
    board = assembled(pdf, sheets, indoor)
    assert (board == 128).mean() < 1e-3  # what no sheet covers
    middle = (0.5 * board.shape[1] - 0.5, 0.5 * board.shape[0] - 0.5)
    assert worst_miss_mm(read_markers(board), indoor.markers, middle, PX_PER_MM) < 0.15


def test_each_sheet_has_a_ruler_and_marks_at_its_corners(indoor: Pad, pdf: list[Printed]) -> None:
    for page, sheet in zip(pdf, tiles(indoor, indoor.tiling()), strict=False):
        lines = [line[[0, -1]] for line in page.lines]
        rulers = [line for line in lines if np.ptp(line[:, 0]) == pytest.approx(100.0, abs=0.01)]
        assert len(rulers) == 1
        start = rulers[0][:, 0].min()
        ticks = sorted(float(a[0]) - start for a, b in lines if a[0] == b[0] and a[1] == rulers[0][0, 1])
        assert ticks == pytest.approx(range(101), abs=0.01)
        (left, bottom), (width, height) = sheet.corner_mm, sheet.size_mm
        for x in (left, left + width):
            ends = [
                line[:, 1]
                for line in lines
                if np.abs(line[:, 0] - x).max() < 0.01 and np.ptp(line[:, 1]) < 3.6
            ]
            assert any(end.max() < bottom for end in ends)
            assert any(end.min() > bottom + height for end in ends)


def test_an_svg_is_the_same_page(tmp_path: Path) -> None:
    (pdf_path,), (svg_path,) = (save(draw_pad(TURNED), tmp_path / f"pad.{kind}") for kind in ("pdf", "svg"))
    (in_pdf,), in_svg = read_pdf(pdf_path), read_svg(svg_path)
    assert in_svg.size_mm == pytest.approx(in_pdf.size_mm, abs=0.01)
    middle = (0.5 * in_pdf.size_mm[0], 10.0 + 14.0 + 80.0)
    for page in (in_pdf, in_svg):
        at_px = (middle[0] * PX_PER_MM - 0.5, (page.size_mm[1] - middle[1]) * PX_PER_MM - 0.5)
        assert worst_miss_mm(read_markers(page.picture()), TURNED.markers, at_px, PX_PER_MM) < 0.15


def test_a_png_has_its_resolution_and_nothing_in_the_quiet_zones(tmp_path: Path) -> None:
    (path,) = save(draw_pad(TURNED), tmp_path / "pad.png")
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    per_mm = PNG_DPI / 25.4
    # dots a metre, as the file says
    assert round(1e3 * per_mm).to_bytes(4, "big") in path.read_bytes()[:400]
    middle = (0.5 * image.shape[1] - 0.5, image.shape[0] - 104.0 * per_mm - 0.5)
    assert worst_miss_mm(read_markers(np.asarray(image, np.uint8)), TURNED.markers, middle, per_mm) < 0.2
    for marker in TURNED.markers:
        ring = np.zeros_like(image)
        for margin_m, value in ((marker.quiet_m - 1e-4, 255), (1e-4, 0)):
            square = np.array(marker.square_pad_m(margin_m)) * 1e3 * per_mm
            corners = np.column_stack((middle[0] + square[:, 1], middle[1] - square[:, 0]))
            cv2.fillPoly(ring, [np.rint(corners).astype(np.int32)], (value,))
        assert image[ring > 0].min() == 255, marker.name


def test_a_name_is_printed_as_it_is_and_no_formula(tmp_path: Path) -> None:
    named = TURNED.model_copy(update={"name": r"the $\frac$ pad"})
    (path,) = save(draw_pad(named), tmp_path / "pad.svg")
    assert path.is_file()


def test_the_same_pad_gives_the_same_file(tmp_path: Path) -> None:
    for kind in ("pdf", "svg", "png"):
        first, second = (save(draw_pad(TURNED), tmp_path / f"{k}.{kind}")[0].read_bytes() for k in (1, 2))
        assert first == second, kind


def test_labels_stand_outside_all_quiet_zones_and_what_has_no_room_is_reported() -> None:
    pad = load_pad("moving_1300")
    labels, left_out = place_labels(pad, pad.tiling())
    assert len(labels) + len(left_out) == len(pad.markers)
    # the inner ones of the grid
    assert {m.group for m in left_out} == {"C"}
    for label in labels:
        x, y = label.at_pad_m
        assert label.words == words_of(label.marker)
        for marker in pad.markers:
            away = max(abs(x - marker.position_pad_m[0]), abs(y - marker.position_pad_m[1]))
            assert away > 0.5 * marker.side_m + marker.quiet_m


@pytest.mark.parametrize("name", ["moving_1300", "touchdown_1300"])
def test_texts_on_a_large_sheet_are_read_from_further_away(name: str) -> None:
    pad = load_pad(name)
    labels, _ = place_labels(pad, pad.tiling())
    sizes_pt = sorted(label.size_pt for label in labels)
    assert sizes_pt[len(sizes_pt) // 3] >= 8.0
    (page,) = draw_pad(pad)
    texts = [text for text in page.figure.axes[0].texts if "100 %" in text.get_text()]
    assert [float(text.get_fontsize()) >= 10.0 for text in texts] == [True] * len(texts) != []
    # on A4 as small as ever
    small = load_pad("indoor_400")
    assert {label.size_pt for label in place_labels(small, small.tiling())[0]} == {4.0}


def test_clipping_keeps_what_is_inside() -> None:
    window = (0.0, 2.0, 2.0, 0.0)
    square = [(1.0, 1.0), (3.0, 1.0), (3.0, 3.0), (1.0, 3.0)]
    assert sorted(clip(square, window)) == [(1.0, 1.0), (1.0, 2.0), (2.0, 1.0), (2.0, 2.0)]
    assert clip([(x + 5.0, y) for x, y in square], window) == []
    inside = [(0.5, 0.5), (1.5, 0.5), (1.0, 1.5)]
    assert clip(inside, window) == inside


@pytest.mark.parametrize("name", ["moving_1300", "indoor_400"])
def test_a_label_is_on_the_sheet_of_its_marker(name: str) -> None:
    pad = load_pad(name)
    sheets = tiles(pad, pad.tiling())
    for label in place_labels(pad, pad.tiling())[0]:
        (of_label,) = [sheet.number for sheet in sheets if sheet.holds(label.at_pad_m)]
        (of_marker,) = [sheet.number for sheet in sheets if sheet.holds(label.marker.position_pad_m)]
        assert of_label == of_marker, label.words
