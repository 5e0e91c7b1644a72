"""Sheets of paper: their sizes, and what a printed page keeps free of its picture. Millimetres."""

from typing import Final, Literal

PaperName = Literal["a4", "a3", "letter"]

# width and height upright (mm)
PAPERS_MM: Final[dict[PaperName, tuple[float, float]]] = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "letter": (215.9, 279.4),
}
# no printer reaches the very edge
MARGIN_MM: Final = 10.0
# below the picture, for the ruler and what is written
FOOT_MM: Final = 14.0
MM_PER_INCH: Final = 25.4
