"""The colours of the marker groups, the same in every plot, picture and page; told apart by colour-blind too.

After Okabe and Ito's set: reddish purple, orange, bluish green.
"""

from typing import Final

from companion.base.messages import MarkerGroup

GROUP_COLOURS: Final[dict[MarkerGroup, str]] = {"F": "#cc79a7", "M": "#e69f00", "C": "#009e73"}


def bgr(colour: str) -> tuple[int, int, int]:
    """`#rrggbb` as OpenCV draws it: blue, green, red."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return blue, green, red
