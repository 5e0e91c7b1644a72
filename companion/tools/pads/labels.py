"""Where on a board there is room for what a marker is called: outside every quiet zone.

Pad frame (x up the page, y to the right), metres. Markers in a dense grid have no such place; they are listed
in the sheet's foot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final

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
    """What is printed beside a marker."""
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
