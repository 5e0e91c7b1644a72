"""What makes a pad one that can be printed and read: each rule finds what breaks it, in one line.

Markers are squares in the pad's plane, turned by their yaw; lengths in metres, in messages millimetres.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from companion.base.geometry import FloatArray
from companion.pad.marker import ERROR_CORRECTION_RATE, Corners, Marker, dictionary_named
from companion.pad.sheet import EXACT_M, Interval, tile

if TYPE_CHECKING:
    from companion.pad.layout import Pad

# of a cell: single markers on dark ground were read as well with 0.67 of a cell of white around them as with
# a whole one; with 0.6 a fifth of the large ones was lost, with 0.5 half
LEAST_QUIET_CELLS: Final = 0.66
# an edge is printed up to half a dot off: with 8 dots that is a sixteenth of a cell
LEAST_DOTS: Final = 8.0
MOST_NAMED: Final = 4
# of a cell's side, by which vision reads it; places across that
MIDDLE_SHARE: Final = 0.6
MIDDLES: Final = 8


def impossible(pad: Pad) -> str | None:
    """Why there can be no such pad, naming the markers; None when there can."""
    return _first((_repeated, _over_the_edge, _overlapping, _illegible), pad)


def unfit(pad: Pad) -> str | None:
    """Why the pad cannot be printed, or not be read once it is, naming the markers; None when it can."""
    rules = (_without_quiet_zone, _quiet_zone_over_the_edge, _quiet_zone_cut_into, _too_fine, _too_large)
    return _first((*rules, _divided), pad)


def _first(rules: Sequence[Callable[[Pad], str | None]], pad: Pad) -> str | None:
    return next((text for rule in rules if (text := rule(pad)) is not None), None)


def extent(corners: Corners) -> tuple[Interval, Interval]:
    xs, ys = zip(*corners, strict=True)
    return (min(xs), max(xs)), (min(ys), max(ys))


def overlap(a: Corners, b: Corners) -> bool:
    """Whether two squares share more than an edge: no side of either has the other beyond it."""
    return not any(_apart(a, b, side) for side in (*_directions(a), *_directions(b)))


def _repeated(pad: Pad) -> str | None:
    names = [marker.name for marker in pad.markers]
    repeated = _named(dict.fromkeys(name for name in names if names.count(name) > 1))
    return repeated and f"markers repeated: {repeated}; expected each dictionary and id once"


def _over_the_edge(pad: Pad) -> str | None:
    over = _named(marker.name for marker in pad.markers if not _on_board(marker.square_pad_m(), pad))
    return over and f"over the board's edge: {over}; expected markers within it"


def _overlapping(pad: Pad) -> str | None:
    pairs = ((a, b) for a, b in combinations(pad.markers, 2) if _may_meet(a, b, 0.0) and not _nested(a, b))
    found = _named(f"{a.name} and {b.name}" for a, b in pairs if overlap(a.square_pad_m(), b.square_pad_m()))
    return found and f"markers overlap: {found}"


def _nested(a: Marker, b: Marker) -> bool:
    """Whether one of the two lies within the other's code."""
    return a.cells_under(b) is not None or b.cells_under(a) is not None


def _illegible(pad: Pad) -> str | None:
    """What lies within a code may change no more of its cells than are corrected.

    They become white, but those whose middle the other's black square fills to more than a half: these are
    read by luck.
    """
    found = []
    for marker in pad.markers:
        dictionary = dictionary_named(marker.dictionary)
        code = np.asarray(cv2.aruco.generateImageMarker(dictionary, marker.id, marker.cells)) < 128
        changed = np.zeros_like(code)
        for other in pad.markers:
            if other is marker or not _may_meet(marker, other, 0.0):
                continue
            if (under := marker.cells_under(other)) is not None:
                changed[under] |= code[under] | (_filled(marker, other)[under] > 0.5)
        most = int(ERROR_CORRECTION_RATE * dictionary.maxCorrectionBits)
        if (lost := int(changed.sum())) > most:
            found.append(f"{marker.name} ({lost}; expected {most} or fewer)")
    named = _named(found)
    return named and f"markers within another's code change too many of its cells: {named}"


def _filled(marker: Marker, other: Marker) -> FloatArray:
    """How much of the middle of each cell (n, n) another marker's square fills."""
    (x0, y0), (x1, y1), _, (x3, y3) = marker.square_pad_m()
    share = (np.arange(MIDDLES * marker.cells) % MIDDLES + 0.5) / MIDDLES * MIDDLE_SHARE
    share = (share + 0.5 * (1.0 - MIDDLE_SHARE) + np.arange(len(share)) // MIDDLES) / marker.cells
    down, right = share[:, None, None], share[None, :, None]
    places = np.array((x0, y0)) + right * (x1 - x0, y1 - y0) + down * (x3 - x0, y3 - y0)
    yaw = math.radians(other.yaw_deg)
    away = (places - other.position_pad_m) @ ((math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw)))
    inside = (np.abs(away) < 0.5 * other.side_m).all(axis=2)
    return np.asarray(inside.reshape(marker.cells, MIDDLES, -1, MIDDLES).mean(axis=(1, 3)))


def _without_quiet_zone(pad: Pad) -> str | None:
    bare = _named(
        f"{m.name} ({_mm(m.quiet_m)}; expected {_mm(LEAST_QUIET_CELLS * m.cell_m)} or more)"
        for m in pad.markers
        if m.quiet_m < LEAST_QUIET_CELLS * m.cell_m - EXACT_M
    )
    return bare and f"too narrow a quiet zone about {bare}"


def _quiet_zone_over_the_edge(pad: Pad) -> str | None:
    cut = _named(
        f"{marker.name} ({_mm(marker.quiet_m)})"
        for marker in pad.markers
        if not _on_board(marker.square_pad_m(marker.quiet_m), pad)
    )
    return cut and f"the quiet zone is cut by the board's edge: {cut}; expected so much white within it"


def _quiet_zone_cut_into(pad: Pad) -> str | None:
    cut = _named(
        f"{a.name} ({_mm(a.quiet_m)}) by {b.name}"
        for pair in combinations(pad.markers, 2)
        if _may_meet(*pair, max(m.quiet_m for m in pair)) and not _nested(*pair)
        for a, b in (pair, pair[::-1])
        if overlap(a.square_pad_m(a.quiet_m), b.square_pad_m())
    )
    return cut and f"the quiet zone is cut into: {cut}; expected so much white between them"


def _too_fine(pad: Pad) -> str | None:
    least_m = LEAST_DOTS * pad.sheet.dot_m
    fine = _named(f"{m.name} ({_mm(m.cell_m)})" for m in pad.markers if m.cell_m < least_m - EXACT_M)
    return fine and (
        f"cells too small to print: {fine}; expected {LEAST_DOTS:g} dots, "
        f"{_mm(least_m)} at {pad.sheet.dots_per_inch:g} dots an inch"
    )


def _too_large(pad: Pad) -> str | None:
    if tile(pad.sheet, (pad.length_m, pad.width_m), ()) is not None:
        return None
    board = f"{_mm(pad.width_m)} x {_mm(pad.length_m)}"
    return f"sheet: no room for a board of {board}; expected one of at most {pad.sheet.tile_words}"


def _divided(pad: Pad) -> str | None:
    if not pad.sheet.whole_markers:
        return None
    extents = [extent(marker.square_pad_m()) for marker in pad.markers]
    tiling = tile(pad.sheet, (pad.length_m, pad.width_m), extents)
    pairs = zip(pad.markers, extents, strict=True)
    divided = _named(
        f"{m.name} ({_mm(m.side_m)})" for m, span in pairs if tiling is not None and tiling.divides(span)
    )
    return divided and (
        f"a cut would divide {divided}; with sheet.whole_markers on {pad.sheet.paper} expected tiles of "
        f"at most {pad.sheet.tile_words} between markers"
    )


def _on_board(corners: Corners, pad: Pad) -> bool:
    x, y = 0.5 * pad.length_m + EXACT_M, 0.5 * pad.width_m + EXACT_M
    return all(abs(a) <= x and abs(b) <= y for a, b in corners)


def _may_meet(a: Marker, b: Marker, margin_m: float) -> bool:
    """Whether the squares' boxes come so near one another: spares most pairs the exact question."""
    reach = 0.75 * (a.side_m + b.side_m) + 1.5 * margin_m
    (ax, ay), (bx, by) = a.position_pad_m, b.position_pad_m
    return abs(ax - bx) < reach and abs(ay - by) < reach


def _directions(corners: Corners) -> Iterator[tuple[float, float]]:
    (ax, ay), (bx, by), (cx, cy), _ = corners
    side = ((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5
    yield (bx - ax) / side, (by - ay) / side
    yield (cx - bx) / side, (cy - by) / side


def _apart(a: Corners, b: Corners, direction: tuple[float, float]) -> bool:
    u, v = direction
    along_a, along_b = ([u * x + v * y for x, y in corners] for corners in (a, b))
    return min(along_b) > max(along_a) - EXACT_M or min(along_a) > max(along_b) - EXACT_M


def _named(found: Iterable[str]) -> str | None:
    """The first few, and how many more; None when there are none."""
    names = list(found)
    if not names:
        return None
    more = len(names) - MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.4g} mm"
