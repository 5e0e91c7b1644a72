"""What a pad is printed on, and where it is cut into tiles.

A pad that is larger than its paper is printed as tiles that are cut along marks and laid edge to edge. Cuts
run straight across the whole board. Between markers they are laid where that costs no further sheet; where
`whole_markers` asks for it, they may cost as many as it takes.

Pad frame: x along the heading is up the page, y is to the right; metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from companion.base.printing.paper import FOOT_MM, MARGIN_MM, PAPERS_MM, PaperName
from companion.config import StrictModel

Metres = Annotated[float, Field(gt=0.05, le=12.0)]
Interval = tuple[float, float]
# a cut this far from a marker's edge is between markers; it is laid farther off where that costs nothing
NEAREST_M: Final = 0.001
CLEAR_M: Final = 0.003
# the ruler and what is written beside it take so much
NARROWEST_M: Final = 0.2
# rounding of the numbers in a file
EXACT_M: Final = 1e-9


class Sheet(StrictModel):
    """What the pad is printed on."""

    paper: Literal[PaperName, "large"] = Field(default="large")
    """Tiles of a paper, or one large sheet"""
    size_m: tuple[Metres, Metres] | None = Field(default=None)
    """Size of a large sheet; none: what the board needs"""
    margin_m: float = Field(default=1e-3 * MARGIN_MM, ge=0.006, le=0.1)
    """Margin of a sheet around its part of the board; printers cannot print the outer half of it"""
    dots_per_inch: float = Field(default=300.0, ge=30.0, le=2400.0)
    """Resolution of the printer"""
    whole_markers: bool = Field(default=False)
    """No cut may divide a marker"""

    @model_validator(mode="after")
    def _size_is_of_a_large_sheet(self) -> Sheet:
        if self.size_m is not None and self.paper != "large":
            raise ValueError(f"size_m: expected none with paper {self.paper}, which has its own size")
        return self

    @property
    def dot_m(self) -> float:
        return 0.0254 / self.dots_per_inch

    @property
    def tile_words(self) -> str:
        """How much of the board a sheet of the paper can hold, for messages."""
        # a square sheet holds the same on its side
        rooms = dict.fromkeys(map(self.room_m, self.pages_m()))
        return " or ".join(f"{1e3 * w:g}x{1e3 * h:g} mm" for w, h in rooms)

    def pages_m(self) -> tuple[tuple[float, float], ...]:
        """Width and height of the sheet, upright and on its side; none: a large one as the board needs it."""
        if self.paper != "large":
            width, height = (1e-3 * side for side in PAPERS_MM[self.paper])
        elif self.size_m is not None:
            width, height = self.size_m
        else:
            return ()
        return ((width, height), (height, width))

    def room_m(self, page_m: tuple[float, float]) -> tuple[float, float]:
        """Width and height for the board on a page."""
        return page_m[0] - 2.0 * self.margin_m, page_m[1] - 2.0 * self.margin_m - 1e-3 * FOOT_MM

    def page_for_m(self, board_m: tuple[float, float]) -> tuple[float, float]:
        """Width and height of a page with room for so much of the board, and in any case for the ruler."""
        width = max(board_m[0] + 2.0 * self.margin_m, NARROWEST_M)
        return width, board_m[1] + 2.0 * self.margin_m + 1e-3 * FOOT_MM


@dataclass(frozen=True, slots=True)
class Tiling:
    """Where the board is cut: from edge to edge, both included, `along_m` in x and `across_m` in y."""

    page_m: tuple[float, float]
    along_m: tuple[float, ...]
    across_m: tuple[float, ...]

    @property
    def count(self) -> int:
        return (len(self.along_m) - 1) * (len(self.across_m) - 1)

    def together(self, one: tuple[Interval, Interval], other: tuple[Interval, Interval]) -> bool:
        """Whether no cut runs between the middles of two things in these intervals of x and y."""
        return not any(
            min(sum(a), sum(b)) < 2.0 * cut < max(sum(a), sum(b))
            for a, b, cuts in zip(one, other, (self.along_m, self.across_m), strict=True)
            for cut in cuts
        )

    def divides(self, extent: tuple[Interval, Interval]) -> bool:
        """Whether a cut runs through what lies in these intervals of x and y."""
        return any(
            _divided(cut, [interval])
            for interval, cuts in zip(extent, (self.along_m, self.across_m), strict=True)
            for cut in cuts
        )


def tile(
    sheet: Sheet, size_m: tuple[float, float], extents: Sequence[tuple[Interval, Interval]]
) -> Tiling | None:
    """Cut a board for its sheets; None when one large sheet has no room for it.

    Args:
        size_m: the board's length (x) and width (y).
        extents: for each marker its intervals of x and of y.
    """
    length, width = size_m
    edges = (-0.5 * length, 0.5 * length), (-0.5 * width, 0.5 * width)
    pages = sheet.pages_m()
    if not pages:
        return Tiling(sheet.page_for_m((width, length)), *edges)
    if sheet.paper == "large":
        fits = [
            p
            for p in pages
            if all(a <= b + EXACT_M for a, b in zip((width, length), sheet.room_m(p), strict=True))
        ]
        return Tiling(fits[0], *edges) if fits else None
    tilings = [_on_page(sheet, page, edges, extents) for page in pages]

    def cost(tiling: Tiling) -> tuple[int, int]:
        divided = sum(map(tiling.divides, extents))
        return (divided, tiling.count) if sheet.whole_markers else (tiling.count, divided)

    return min(tilings, key=cost)


def _on_page(
    sheet: Sheet,
    page_m: tuple[float, float],
    edges: tuple[Interval, Interval],
    extents: Sequence[tuple[Interval, Interval]],
) -> Tiling:
    room_across, room_along = sheet.room_m(page_m)
    along = cuts(edges[0], room_along, [x for x, _ in extents], whole=sheet.whole_markers)
    across = cuts(edges[1], room_across, [y for _, y in extents], whole=sheet.whole_markers)
    return Tiling(page_m, along, across)


def cuts(edge: Interval, longest_m: float, markers: Sequence[Interval], *, whole: bool) -> tuple[float, ...]:
    """Where to cut one direction of the board, its two edges included.

    The fewest pieces, of these the fewest divided markers, of these the cuts that stay clear of markers, of
    these the most even pieces; with `whole` the divided markers count before the pieces. Found as a shortest
    path over the places where a cut may be.
    """
    low, high = edge
    places = _places(edge, longest_m, markers)
    best: dict[float, tuple[tuple[float, ...], tuple[float, ...]]] = {low: ((0.0, 0.0, 0.0, 0.0), (low,))}
    for there in places[1:]:
        divided = float(_divided(there, markers))
        first_two = (divided, 1.0) if whole else (1.0, divided)
        lack_m = _lack_m(there, markers)
        ways = []
        for here in (p for p in places if p < there and there - p <= longest_m + EXACT_M and p in best):
            cost, path = best[here]
            step = (*first_two, lack_m, (there - here) ** 2)
            ways.append((tuple(a + b for a, b in zip(cost, step, strict=True)), (*path, there)))
        if ways:
            best[there] = min(ways)
    return best[high][1]


def _places(edge: Interval, longest_m: float, markers: Sequence[Interval]) -> list[float]:
    """Even cuts, and the middles and ends of the gaps between markers."""
    low, high = edge
    pieces = max(1, math.ceil((high - low - EXACT_M) / longest_m))
    places = {low, high} | {low + k * (high - low) / pieces for k in range(1, pieces)}
    edges = sorted({low, high, *(end for interval in markers for end in interval)})
    for a, b in pairwise(edges):
        middle = 0.5 * (a + b)
        if b - a >= 2.0 * NEAREST_M and not _divided(middle, markers):
            clear = min(CLEAR_M, 0.5 * (b - a))
            places |= {a + NEAREST_M, a + clear, middle, b - clear, b - NEAREST_M}
    return sorted(place for place in places if low <= place <= high)


def _divided(cut: float, markers: Sequence[Interval]) -> int:
    return sum(low + EXACT_M < cut < high - EXACT_M for low, high in markers)


def _lack_m(cut: float, markers: Sequence[Interval]) -> float:
    """By how much a cut is nearer to a marker's edge than it should be."""
    nearest = min((abs(cut - end) for interval in markers for end in interval), default=CLEAR_M)
    return max(0.0, round(CLEAR_M - nearest, 9))
