"""A pad on paper at its true size: one large sheet, or tiles to be cut along marks and laid edge to edge.

Each sheet has a ruler to check the print by; tiles come with a plan of where each goes and of which marker is
which. What a marker is called stands where the board has room for it, outside every quiet zone; markers in a
dense grid have no such place, and are listed in the sheet's foot.

Pad frame: x (its heading, the front) is up the page and y to the right, metres. On paper the same axes, in
millimetres from the sheet's lower left corner.
"""

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Final

from companion.base.printing.page import RULER_MM, Page, Point, Rectangle, black_rectangles
from companion.base.printing.paper import FOOT_MM, PAPERS_MM
from companion.pad import Marker, Pad
from companion.pad.marker import Corners
from companion.pad.rules import extent, overlap
from companion.pad.sheet import Tiling

SIZE_PT: Final = 4.0
HEIGHT_M: Final = 0.0018
# of a character of that size, at its widest on average
CHARACTER_M: Final = 0.00095
GAP_M: Final = 0.0004
# a large sheet is looked at from further away: so many times larger, up to what its short side is of A3's
LARGER: Final = (3.0, 2.0, 1.5, 1.0)
A3_SHORT_M: Final = 0.297


@dataclass(frozen=True, slots=True)
class Label:
    """Words about a marker, centred at (x, y)."""

    marker: Marker
    words: str
    at_pad_m: tuple[float, float]
    size_pt: float


def words_of(marker: Marker) -> str:
    return f"{marker.dictionary} {marker.id}  {1e3 * marker.side_m:g} mm"


def scales(page_m: tuple[float, float]) -> list[float]:
    """How many times larger texts may be on a sheet than on A3, the largest first."""
    return [scale for scale in LARGER if scale <= max(1.0, min(page_m) / A3_SHORT_M)]


def place_labels(pad: Pad, tiling: Tiling) -> tuple[list[Label], list[Marker]]:
    """The labels that have a place on the board, and the markers for whose there is none.

    Each is then made as large as the others leave it room.
    """
    zones = [marker.square_pad_m(marker.quiet_m) for marker in pad.markers]
    boxes: dict[int, tuple[float, Corners]] = {}

    def place(number: int, scale: float) -> None:
        zone, words = zones[number], words_of(pad.markers[number])
        taken = [*zones, *(box for other, (_, box) in boxes.items() if other != number)]
        for box in _boxes(zone, words, scale):
            if tiling.together(extent(zone), extent(box)) and _free(box, taken, pad, tiling):
                boxes[number] = scale, box
                return

    for number in range(len(zones)):
        place(number, 1.0)
    for number, scale in product(list(boxes), sorted(scales(tiling.page_m))):
        if scale > 1.0:
            place(number, scale)
    labels = [_label(pad.markers[number], *boxes[number]) for number in sorted(boxes)]
    return labels, [marker for number, marker in enumerate(pad.markers) if number not in boxes]


def _label(marker: Marker, scale: float, box: Corners) -> Label:
    (x0, x1), (y0, y1) = extent(box)
    return Label(marker, words_of(marker), (0.5 * (x0 + x1), 0.5 * (y0 + y1)), scale * SIZE_PT)


def _boxes(zone: Corners, words: str, scale: float) -> Iterator[Corners]:
    """Boxes for the words below, above and beside a quiet zone, the nearest to its lower left first."""
    (x0, x1), (y0, y1) = extent(zone)
    height, width = scale * HEIGHT_M, scale * CHARACTER_M * len(words)
    for x in (x0 - GAP_M - height, x1 + GAP_M):
        for y in (y0, 0.5 * (y0 + y1 - width), y1 - width):
            yield _box(x, y, height, width)
    for y in (y1 + GAP_M, y0 - GAP_M - width):
        for x in (x0, 0.5 * (x0 + x1 - height), x1 - height):
            yield _box(x, y, height, width)


def _box(x: float, y: float, height: float, width: float) -> Corners:
    return ((x + height, y), (x + height, y + width), (x, y + width), (x, y))


def _free(box: Corners, taken: list[Corners], pad: Pad, tiling: Tiling) -> bool:
    on_board = all(abs(x) <= 0.5 * pad.length_m and abs(y) <= 0.5 * pad.width_m for x, y in box)
    return on_board and not tiling.divides(extent(box)) and not any(overlap(box, other) for other in taken)


def grouped(markers: list[Marker]) -> list[str]:
    """Markers listed together: "5x5_50 33 mm: 12-47"."""
    kinds: dict[str, list[int]] = {}
    for marker in markers:
        kinds.setdefault(f"{marker.dictionary} {1e3 * marker.side_m:g} mm", []).append(marker.id)
    return [f"{kind}: {_runs(sorted(ids))}" for kind, ids in kinds.items()]


def _runs(numbers: list[int]) -> str:
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in zip(starts, ends, strict=True))


# ---------------------------------------------------------------- the pages

# black goes on for so much beyond a cut, lest a cut beside its mark leave a white line
BLEED_MM: Final = 1.0
# cut marks begin and end so far from the corner
MARK_MM: Final = (1.5, 5.0)
TEXT_PT: Final = 5.0
LINE_MM: Final = 2.2
CHARACTER_MM: Final = 1.0
FOOT_TEXT_MM: Final = 16.0  # from the ruler's top down to half of the margin below it
PLAN_MARGIN_MM: Final = 15.0
PLAN_HEAD_MM: Final = 25.0
# of "sheet 35" in 7 pt, and from the sheet's edges
NUMBER_MM: Final = (10.0, 2.6)
PLAN_GAP_MM: Final = 1.0


@dataclass(frozen=True, slots=True)
class Tile:
    """One sheet's part of the board, in the pad frame (m), and its lower left corner on the sheet."""

    number: int
    row: int  # from the front
    column: int  # from the left
    along_m: tuple[float, float]
    across_m: tuple[float, float]
    corner_mm: Point

    @property
    def size_mm(self) -> tuple[float, float]:
        return 1e3 * (self.across_m[1] - self.across_m[0]), 1e3 * (self.along_m[1] - self.along_m[0])

    def on_sheet_mm(self, point_pad_m: tuple[float, float]) -> Point:
        x, y = point_pad_m
        left, bottom = self.corner_mm
        return left + 1e3 * (y - self.across_m[0]), bottom + 1e3 * (x - self.along_m[0])

    def holds(self, point_pad_m: tuple[float, float]) -> bool:
        x, y = point_pad_m
        return self.along_m[0] <= x <= self.along_m[1] and self.across_m[0] <= y <= self.across_m[1]


def tiles(pad: Pad, tiling: Tiling) -> list[Tile]:
    rows = list(pairwise(tiling.along_m))[::-1]
    columns = list(pairwise(tiling.across_m))
    room_width, room_height = (1e3 * side for side in pad.sheet.room_m(tiling.page_m))
    made = []
    for number, ((row, along), (column, across)) in enumerate(
        product(enumerate(rows, 1), enumerate(columns, 1)), 1
    ):
        width, height = 1e3 * (across[1] - across[0]), 1e3 * (along[1] - along[0])
        left = 1e3 * pad.sheet.margin_m + 0.5 * (room_width - width)
        bottom = 1e3 * pad.sheet.margin_m + FOOT_MM + 0.5 * (room_height - height)
        made.append(Tile(number, row, column, along, across, (left, bottom)))
    return made


def draw_pad(pad: Pad) -> list[Page]:
    """All sheets, and after tiles the plan."""
    tiling = pad.tiling()
    sheets = tiles(pad, tiling)
    labels, unlabelled = place_labels(pad, tiling)
    black = [corners for marker in pad.markers for corners in black_cells(pad, marker)]
    pages = []
    for sheet in sheets:
        page = Page(*(1e3 * side for side in tiling.page_m))
        _draw_tile(page, sheet, black, labels)
        unlabelled_here = [marker for marker in unlabelled if sheet.holds(marker.position_pad_m)]
        _draw_foot(page, pad, sheet, len(sheets), unlabelled_here)
        pages.append(page)
    return [*pages, _plan(pad, tiling, sheets)] if len(sheets) > 1 else pages


def black_cells(pad: Pad, marker: Marker) -> list[list[tuple[float, float]]]:
    """The black of a marker as rectangles, corners (x, y) in the pad frame (m)."""
    (x0, y0), (x1, y1), _, (x3, y3) = marker.square_pad_m()
    # from the top left corner to the right, and down the code
    right, down = (x1 - x0, y1 - y0), (x3 - x0, y3 - y0)
    return [
        [
            (x0 + u * right[0] + v * down[0], y0 + u * right[1] + v * down[1])
            for u, v in ((left, top), (end, top), (end, bottom), (left, bottom))
        ]
        for left, top, end, bottom in black_rectangles(pad.printed(marker))
    ]


def clip(corners: Sequence[Point], within: Rectangle) -> list[Point]:
    """The part of a convex polygon within a rectangle (left, top, right, bottom; y up); maybe nothing."""
    left, top, right, bottom = within
    kept = list(corners)
    for axis, sign, bound in ((0, 1.0, left), (0, -1.0, right), (1, 1.0, bottom), (1, -1.0, top)):
        kept = list(_clip_half(kept, axis, sign, bound))
    return kept


def _clip_half(corners: list[Point], axis: int, sign: float, bound: float) -> Iterator[Point]:
    """What is on the side of a line where sign * (coordinate - bound) is positive (Sutherland-Hodgman)."""
    for a, b in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        inside_a, inside_b = (sign * (point[axis] - bound) for point in (a, b))
        if inside_a >= 0.0:
            yield a
        if inside_a * inside_b < 0.0:
            share = inside_a / (inside_a - inside_b)
            yield a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])


# ---------------------------------------------------------------- a sheet


def _draw_tile(
    page: Page, sheet: Tile, black: list[list[tuple[float, float]]], labels: Sequence[Label]
) -> None:
    (left, bottom), (width, height) = sheet.corner_mm, sheet.size_mm
    right, top = left + width, bottom + height
    window = (left - BLEED_MM, top + BLEED_MM, right + BLEED_MM, bottom - BLEED_MM)
    pieces = (clip([sheet.on_sheet_mm(corner) for corner in cell], window) for cell in black)
    page.fill(piece for piece in pieces if len(piece) > 2)
    corners = ((left, bottom, -1, -1), (right, bottom, 1, -1), (left, top, -1, 1), (right, top, 1, 1))
    for x, y, away_x, away_y in corners:
        sideways = [(x + away_x * mark, y) for mark in MARK_MM]
        page.lines([sideways, [(x, y + away_y * mark) for mark in MARK_MM]])
    for label in labels:
        if sheet.holds(label.at_pad_m):
            page.text(sheet.on_sheet_mm(label.at_pad_m), label.words, label.size_pt, va="center")
    front_pt = TEXT_PT * scales(_metres(page))[0]
    page.text((0.5 * (left + right), top + MARK_MM[0]), "▲ front (x of the pad)", front_pt, va="bottom")


def _metres(page: Page) -> tuple[float, float]:
    width, height = page.size_mm
    return 1e-3 * width, 1e-3 * height


def _draw_foot(page: Page, pad: Pad, sheet: Tile, count: int, labels: list[Marker]) -> None:
    margin_mm = 1e3 * pad.sheet.margin_m
    page.ruler(margin_mm, margin_mm)
    board = f"{pad.name}: {1e3 * pad.width_m:g} x {1e3 * pad.length_m:g} mm"
    where = f", sheet {sheet.number} of {count} (row {sheet.row} from the front, column {sheet.column})"
    words = [
        board + (where if count > 1 else "") + ".",
        f"Print at 100 %: the ruler is {RULER_MM} mm long. Cut from mark to mark"
        + ("; lay the sheets edge to edge." if count > 1 else "."),
        *grouped(labels),
    ]
    left = margin_mm + RULER_MM + 8.0
    width_mm = page.size_mm[0] - margin_mm - left
    for scale in scales(_metres(page)):
        # a large sheet has room beside the ruler, and not below it
        texts = words if scale == 1.0 else [" ".join(words)]
        lines = _wrapped(texts, width_mm / (scale * CHARACTER_MM))
        if scale * LINE_MM * len(lines) <= FOOT_TEXT_MM:
            break
    for k, line in enumerate(lines):
        page.text((left, margin_mm + 8.0 - scale * LINE_MM * k), line, scale * TEXT_PT, ha="left")


def _wrapped(texts: Sequence[str], characters: float) -> list[str]:
    return [line for text in texts for line in textwrap.wrap(text, max(int(characters), 20))]


# ---------------------------------------------------------------- the plan


def _number_place(pad: Pad, sheet: Tile, on_plan: Callable[[Point], Point]) -> Point:
    """Upper left corner of a sheet's number on the plan: in the first of its corners that no marker takes."""
    left, top = on_plan((sheet.along_m[1], sheet.across_m[0]))
    right, bottom = on_plan((sheet.along_m[0], sheet.across_m[1]))
    width, height = NUMBER_MM
    places = [
        (x, y)
        for y in (top - PLAN_GAP_MM, bottom + PLAN_GAP_MM + height)
        for x in (left + PLAN_GAP_MM, right - PLAN_GAP_MM - width)
    ]
    markers = [extent(tuple(on_plan(corner) for corner in marker.square_pad_m())) for marker in pad.markers]

    def is_free(place: Point) -> bool:
        x, y = place
        return not any(
            x < x1 and x0 < x + width and y - height < y1 and y0 < y for (x0, x1), (y0, y1) in markers
        )

    return next((place for place in places if is_free(place)), places[0])


def _plan(pad: Pad, tiling: Tiling, sheets: Sequence[Tile]) -> Page:
    """Where each sheet and each marker goes, to no scale."""
    paper = pad.sheet.paper
    page = Page(*(PAPERS_MM["a4"] if paper == "large" else PAPERS_MM[paper]))
    width, height = (side - 2.0 * PLAN_MARGIN_MM for side in page.size_mm)
    scale = min(width / pad.width_m, (height - PLAN_HEAD_MM) / pad.length_m)
    top = page.size_mm[1] - PLAN_MARGIN_MM
    middle = 0.5 * page.size_mm[0], top - PLAN_HEAD_MM - 0.5 * scale * pad.length_m

    def on_plan(point_pad_m: tuple[float, float]) -> Point:
        return middle[0] + scale * point_pad_m[1], middle[1] + scale * point_pad_m[0]

    page.text((middle[0], top), f"{pad.name}: plan, not to scale", 10)
    page.text((middle[0], top - 8.0), f"{len(sheets)} sheets; numbers in markers are their ids", 7)
    x, y = 0.5 * pad.length_m, 0.5 * pad.width_m
    page.text(on_plan((x + 4.0 / scale, 0.0)), "▲ front (x of the pad)", 7, va="center")
    page.lines([[on_plan((cut, -y)), on_plan((cut, y))] for cut in tiling.along_m], dashed=True)
    page.lines([[on_plan((-x, cut)), on_plan((x, cut))] for cut in tiling.across_m], dashed=True)
    for sheet in sheets:
        page.text(_number_place(pad, sheet, on_plan), f"sheet {sheet.number}", 7, ha="left", grey=0.4)
    for marker in pad.markers:
        corners = [on_plan(corner) for corner in marker.square_pad_m()]
        page.lines([[*corners, corners[0]]], 0.6)
        # three digits fit into a square at this size
        (left, right), _ = extent(tuple(corners))
        page.text(on_plan(marker.position_pad_m), f"{marker.id}", min(8.0, 1.1 * (right - left)), va="center")
    return page
