"""Frames of a pad as a hovering vehicle's camera takes them: poses spread as the prediction assumes them."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import (
    FloatArray,
    add,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    subtract,
)
from companion.base.messages import Frame, PadPrior
from companion.base.printing.page import PNG_DPI, save
from companion.config import (
    CONFIG_FOLDER,
    CameraConfig,
    VehicleConfig,
    VisionConfig,
    find_file,
    load_model,
)
from companion.pad import DICTIONARIES, Marker, Pad, load_pad
from companion.sense.vision.pipeline import Vision
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
from companion.tools.pads.printing import Tile, clip, draw_pad, place_labels, tiles, words_of
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from tests.printed_pages import PX_PER_MM, Printed, read_pdf, read_svg
from tests.programs import ProgramHere

BOARD = (0.0, 0.0, -0.1)


class Hover:
    """A camera that hovers over a pad, and the eyes that look for it where it is expected, as in flight."""

    def __init__(self, pad: Pad, camera_name: str, seed: int, spread: HoverSpread = HOVER) -> None:
        self._camera = load_model(CameraConfig, find_file("cameras", camera_name))
        self._vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
        self._rng, self._spread = np.random.default_rng(seed), spread
        self._model = CameraModel(self._camera, self._vehicle, pad, ImagingSettings(), self._rng)
        self._vision = Vision(pad, self._camera, self._vehicle, VisionConfig())

    def recall(self, height_m: float, frames: int) -> float:
        """Share of the frames from a height in which the pad was recognised."""
        seen = 0
        for _ in range(frames):
            frame, prior = self.picture(height_m)
            seen += self._vision.step(frame, prior).sighting is not None
        return seen / frames

    def picture(self, height_m: float) -> tuple[Frame, PadPrior]:
        """A frame, and where the eyes expect the pad."""
        rng, spread = self._rng, self._spread
        roll, pitch = np.radians(rng.normal(0.0, spread.tilt_deg, 2)).tolist()
        yaw, course = rng.uniform(-math.pi, math.pi, 2).tolist()
        attitude = quat_from_euler(roll, pitch, yaw)
        std = math.hypot(spread.offset_m, spread.offset_share * height_m)
        aside_x, aside_y = rng.normal(0.0, std, 2).tolist()
        # the prediction turns the camera about the place over which it is: so here, at its own height
        lens = add(BOARD, (aside_x, aside_y, -height_m))
        start = subtract(lens, quat_rotate(attitude, self._vehicle.camera_position_body_m))
        vx, vy = spread.speed_m_s * math.cos(course), spread.speed_m_s * math.sin(course)

        def scene(time_s: float) -> ScenePose:
            x, y, z = start
            return ScenePose((x + vx * time_s, y + vy * time_s, z), attitude, BOARD, 0.0)

        to_body = quat_conjugate(attitude)
        std_m = 0.005 + 0.01 * height_m
        error_x, error_y, error_z = rng.normal(0.0, std_m, 3).tolist()
        prior = PadPrior(
            0.0,
            quat_rotate(to_body, (0.0, 0.0, 1.0)),
            add(quat_rotate(to_body, subtract(BOARD, start)), (error_x, error_y, error_z)),
            quat_multiply(to_body, quat_from_euler(0.0, 0.0, 0.0)),
            std_m,
        )
        return Frame(0.0, 0.0, 0, self._model.render(0.0, scene)), prior


def assembled(pages: list[Printed], sheets: list[Tile], pad: Pad) -> NDArray[np.uint8]:
    """The board: each sheet cut at its marks and laid in its place."""
    board = np.full(
        (round(1e3 * pad.length_m * PX_PER_MM), round(1e3 * pad.width_m * PX_PER_MM)), 128, np.uint8
    )
    for page, sheet in zip(pages, sheets, strict=False):
        (left, bottom), (width, height) = sheet.corner_mm, sheet.size_mm
        x, y = left * PX_PER_MM, (page.size_mm[1] - bottom - height) * PX_PER_MM
        size = (round(width * PX_PER_MM), round(height * PX_PER_MM))
        # a cut is where it is, not at a whole pixel
        centre = (x + 0.5 * (size[0] - 1), y + 0.5 * (size[1] - 1))
        piece = cv2.getRectSubPix(page.picture(), size, centre)
        top = round(1e3 * (0.5 * pad.length_m - sheet.along_m[1]) * PX_PER_MM)
        first = round(1e3 * (sheet.across_m[0] + 0.5 * pad.width_m) * PX_PER_MM)
        board[top : top + size[1], first : first + size[0]] = piece
    return board


def read_markers(image: NDArray[np.uint8]) -> dict[tuple[str, int], FloatArray]:
    """Every marker that OpenCV reads: corners (4, 2) in pixels."""
    found: dict[tuple[str, int], FloatArray] = {}
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.minMarkerPerimeterRate = 0.01
    parameters.adaptiveThreshWinSizeMax = 53
    for name, number in DICTIONARIES.items():
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number), parameters)
        quads, ids, _ = detector.detectMarkers(image)
        for quad, identity in zip(quads, np.ravel(ids) if ids is not None else [], strict=True):
            found[name, int(identity)] = np.asarray(quad, dtype=float).reshape(4, 2)
    return found


def worst_miss_mm(
    found: dict[tuple[str, int], FloatArray],
    markers: tuple[Marker, ...],
    middle_px: tuple[float, float],
    px_per_mm: float,
) -> float:
    """How far corners are from where the pad has them; infinite when a marker is missing.

    `middle_px` is where the board's middle is in the image.
    """
    worst = 0.0
    for marker in markers:
        corners = found.get((marker.dictionary, marker.id))
        if corners is None:
            return float("inf")
        x, y = 1e3 * marker.corners_pad_m()[:, :2].T
        expected = np.column_stack((middle_px[0] + px_per_mm * y, middle_px[1] - px_per_mm * x))
        worst = max(worst, float(np.linalg.norm(corners - expected, axis=1).max()) / px_per_mm)
    return worst


# ---------------- `companion pad`: what it says, prints and draws, and what it says of what cannot be

BAD = """
name: bad
width_m: 0.3
length_m: 0.3
markers:
  - {dictionary: 4x4_50, id: 0, side_m: 0.1, position_pad_m: [0.05, 0.0], group: F}
  - {dictionary: 4x4_50, id: 1, side_m: 0.1, position_pad_m: [-0.06, 0.0], group: F}
"""


def test_a_good_pad_is_reported_in_a_few_lines(program: ProgramHere) -> None:
    result = program("companion", "pad", "indoor_400")
    assert result.code == 0
    assert result.out.splitlines() == [
        "indoor_400: 400 x 400 mm, 57 markers, good",
        "  F: 4 x 120 mm, 4x4_50",
        "  M: 4 x 56 mm, 4x4_50",
        "  C: 49 x 12 mm, 5x5_50",
        "  6 sheets of 210 x 297 mm (a4)",
    ]


def test_another_paper_takes_the_place_of_the_pad_s_own(tmp_path: Path, program: ProgramHere) -> None:
    result = program("companion", "pad", "indoor_400", "--paper", "a3", "-o", tmp_path / "pad.svg")
    assert result.code == 0
    assert "2 sheets of 420 x 297 mm (a3)" in result.out
    # two sheets and the plan, one to a file
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pad-1.svg", "pad-2.svg", "pad-3.svg"]


def test_the_coverage_is_reported_and_drawn(tmp_path: Path, program: ProgramHere) -> None:
    picture = tmp_path / "coverage.png"
    words = ["pad", "indoor_400", "--coverage", "--camera", "hd_1280x720", "--offset", "0.01"]
    result = program("companion", *words, "-o", picture)
    assert result.code == 0
    assert "predicted recall (%)" in result.out
    assert "hd_1280x720, 1 cm and 5 % of the height off the middle" in result.out
    assert "blind height: " in result.out
    assert cv2.imread(str(picture)) is not None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nobody"], "pads: no 'nobody'"),
        (["bad.yaml"], "bad.yaml: the quiet zone is cut into: 4x4_50 id 0 (16.67 mm) by 4x4_50 id 1"),
        (["indoor_400", "-o", "pad.jpg"], "-o pad.jpg: expected a .pdf, .svg, .png file"),
        (["indoor_400", "-o", "nowhere/pad.pdf"], "-o nowhere/pad.pdf: expected"),
        (["--coverage", "-o", "pad.pdf"], "-o pad.pdf: expected a .png file"),
        (["--coverage", "--camera", "none"], "cameras: no 'none'"),
        (["--tilt", "3"], "--camera, --offset, --tilt and --speed: expected with --coverage"),
        (["whole.yaml", "--paper", "a4"], "whole.yaml on a4: a cut would divide 4x4_50 id 0 (360 mm)"),
    ],
)
def test_what_a_user_gets_wrong_is_one_line(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: ProgramHere
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.yaml").write_text(BAD)
    shipped = (CONFIG_FOLDER / "pads" / "moving_1300.yaml").read_text()
    (tmp_path / "whole.yaml").write_text(
        shipped.replace("{paper: large,", "{whole_markers: true, paper: large,")
    )
    ended = program("companion", "pad", *words)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert ended.err.startswith(f"companion: {said}")
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".yaml"] == []


# ---------------- The predicted recall: its formula, its bounds, and the eyes' own over rendered frames

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


# ----------------
# The prints are the pad: read from the files themselves, every marker is where the layout has it.

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
