"""The pad as data: the vision, the renderer and the printer all read the same layout.

Pad frame: origin at the centre of the surface, x along the pad's heading, y to its right, z down; metres.
Loading a pad checks it: what cannot be printed, or could not be distinguished from the air, is refused.
"""

from companion.pad.layout import Pad, checked, load_pad
from companion.pad.marker import DICTIONARIES, ERROR_CORRECTION_RATE, Marker, dictionary_named
from companion.pad.sheet import Sheet

__all__ = [
    "DICTIONARIES",
    "ERROR_CORRECTION_RATE",
    "Marker",
    "Pad",
    "Sheet",
    "checked",
    "dictionary_named",
    "load_pad",
]
