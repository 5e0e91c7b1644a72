"""Where on a board there is room for what a marker is called: outside every quiet zone.

Pad frame (x up the page, y to the right), metres. Markers in a dense grid have no such place; they are listed
in the sheet's foot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class Label:
    """Words about a marker, centred at (x, y)."""

    marker: Marker
    words: str
    at_pad_m: tuple[float, float]


def words_of(marker: Marker) -> str:
    """What is printed beside a marker."""
    return f"{marker.dictionary} {marker.id}  {1e3 * marker.side_m:g} mm"


def place_labels(pad: Pad, tiling: Tiling) -> tuple[list[Label], list[Marker]]:
    """The labels that have a place on the board, and the markers for whose there is none."""
    zones = [marker.square_pad_m(marker.quiet_m) for marker in pad.markers]
    placed: list[Label] = []
    left_out: list[Marker] = []
    taken = list(zones)
    for marker, zone in zip(pad.markers, zones, strict=True):
        words = words_of(marker)
        near = (b for b in _boxes(zone, words) if tiling.together(extent(zone), extent(b)))
        box = next((b for b in near if _free(b, taken, pad, tiling)), None)
        if box is None:
            left_out.append(marker)
            continue
        (x0, x1), (y0, y1) = extent(box)
        placed.append(Label(marker, words, (0.5 * (x0 + x1), 0.5 * (y0 + y1))))
        taken.append(box)
    return placed, left_out


def _boxes(zone: Corners, words: str) -> Iterator[Corners]:
    """Boxes for the words below, above and beside a quiet zone, the nearest to its lower left first."""
    (x0, x1), (y0, y1) = extent(zone)
    height, width = HEIGHT_M, CHARACTER_M * len(words)
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
