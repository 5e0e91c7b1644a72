"""Pages to be printed at their true size: black shapes, a ruler to check the print by, lines and small text.

Coordinates on a page are millimetres from its lower left corner, as PDF has them. Pages are saved as PDF,
SVG or PNG by the ending of the file's name; the same pages give the same file.
"""

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.files import write_atomically
from companion.base.printing.paper import MM_PER_INCH
from companion.config import ConfigError

RULER_MM: Final = 100
PNG_DPI: Final = 300
# of a PNG's longer side: a metre at 300 dots an inch would need a gigabyte to draw
LARGEST_PNG_PX: Final = 6000
# a PDF's page is at most 14400 points long
LARGEST_PDF_MM: Final = 14400 / 72 * MM_PER_INCH
ENDINGS: Final = (".pdf", ".svg", ".png")
Point = tuple[float, float]
# left, top, right, bottom
Rectangle = tuple[float, float, float, float]


class Page:
    """One sheet, to be drawn on."""

    def __init__(self, width_mm: float, height_mm: float) -> None:
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow

        self.size_mm = (width_mm, height_mm)
        self.figure = Figure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH))
        self._axes: Any = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set(xlim=(0.0, width_mm), ylim=(0.0, height_mm))
        self._axes.axis("off")

    def fill(self, outlines: Iterable[Sequence[Point]]) -> None:
        """Fill polygons that do not overlap with black."""
        from matplotlib.patches import PathPatch  # noqa: PLC0415
        from matplotlib.path import Path as Outline  # noqa: PLC0415

        shapes = [Outline([*corners, corners[0]], closed=True) for corners in outlines]
        if not shapes:
            return
        # one shape: between two, a viewer may show a hairline
        whole = PathPatch(Outline.make_compound_path(*shapes), facecolor="black", edgecolor="none")
        whole.set_snap(False)
        self._axes.add_patch(whole)

    def lines(self, lines: Iterable[Sequence[Point]], width_pt: float = 0.3, *, dashed: bool = False) -> None:
        from matplotlib.patches import PathPatch  # noqa: PLC0415
        from matplotlib.path import Path as Outline  # noqa: PLC0415

        whole = Outline.make_compound_path(*(Outline(points) for points in lines))
        style = "dashed" if dashed else "solid"
        patch = PathPatch(whole, fill=False, linewidth=width_pt, linestyle=style, capstyle="butt")
        patch.set_snap(False)
        self._axes.add_patch(patch)

    def text(
        self,
        at: Point,
        words: str,
        size_pt: float,
        *,
        ha: Literal["left", "center", "right"] = "center",
        va: Literal["top", "center", "bottom"] = "top",
        grey: float = 0.0,
    ) -> None:
        """Words; `ha` and `va` say which part of them is at the point; `grey` 0 is black, 1 white."""
        # a $ in a pad's name is no formula
        self._axes.text(*at, words, fontsize=size_pt, ha=ha, va=va, color=str(grey), parse_math=False)

    def ruler(self, left: float, bottom: float) -> None:
        """A ruler of `RULER_MM` with a mark each millimetre, to be held against a real one."""
        self.lines([[(left, bottom), (left + RULER_MM, bottom)]], 0.5)
        lengths = ((mm, 4.0 if mm % 10 == 0 else 2.0) for mm in range(RULER_MM + 1))
        self.lines([(left + mm, bottom), (left + mm, bottom + length)] for mm, length in lengths)
        for mm in range(0, RULER_MM + 1, 10):
            self.text((left + mm, bottom + 4.5), f"{mm}", 5, va="bottom")


def code_rectangles(dictionary: cv2.aruco.Dictionary, identity: int) -> list[Rectangle]:
    """A marker's black cells: see `black_rectangles`."""
    cells = dictionary.markerSize + 2
    return black_rectangles(np.asarray(cv2.aruco.generateImageMarker(dictionary, identity, cells)))


def black_rectangles(image: NDArray[np.generic]) -> list[Rectangle]:
    """What is black of a marker's cells (n, n), as (left, top, right, bottom), y down; the marker is 1 wide.

    Neighbours in a row are one; none overlap.
    """
    cells, found = len(image), list[Rectangle]()
    for row, line in enumerate(np.asarray(image, dtype=float) < 128.0):
        edges = np.flatnonzero(np.diff(np.pad(line.astype(int), 1)))
        found += [
            (a / cells, row / cells, b / cells, (row + 1) / cells) for a, b in edges.reshape(-1, 2).tolist()
        ]
    return found


def save(pages: Sequence[Page], path: Path) -> list[Path]:
    """Write pages by the ending of the name, and return what was written.

    PNG and SVG hold one page: of several, each becomes a file, NAME-1, NAME-2 and so on.

    Raises:
        ConfigError: another ending, a page that is too large for a PDF, or a file that cannot be written.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ConfigError(f"{path}: expected a file that ends in {', '.join(ENDINGS)}")
    if ending == ".pdf":
        write_atomically(path, _pdf(pages, path))
        return [path]
    numbers = range(1, len(pages) + 1)
    names = [path.with_stem(f"{path.stem}-{k}") for k in numbers] if len(pages) > 1 else [path]
    for name, page in zip(names, pages, strict=True):
        write_atomically(name, _png(page) if ending == ".png" else _svg(page))
    return names


def png_dpi(size_mm: tuple[float, float]) -> int:
    return min(PNG_DPI, int(LARGEST_PNG_PX / (max(size_mm) / MM_PER_INCH)))


def _pdf(pages: Sequence[Page], path: Path) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages  # noqa: PLC0415

    longest = max(max(page.size_mm) for page in pages)
    if longest > LARGEST_PDF_MM:
        raise ConfigError(
            f"{path}: a page of {longest:.0f} mm: expected at most {LARGEST_PDF_MM:.0f} mm in a PDF; "
            "use .svg, or print tiles"
        )
    data = io.BytesIO()
    # no date: the same pages give the same file
    with PdfPages(data, metadata={"CreationDate": None}) as document:
        for page in pages:
            document.savefig(page.figure)
    return data.getvalue()


def _svg(page: Page) -> bytes:
    import matplotlib as mpl  # noqa: PLC0415

    data = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "companion"}):
        page.figure.savefig(data, format="svg", metadata={"Date": None})
    return data.getvalue()


def _png(page: Page) -> bytes:
    data = io.BytesIO()
    page.figure.savefig(data, format="png", dpi=png_dpi(page.size_mm))
    return data.getvalue()
