"""A pad as another project's `landing-target.json` has it: AprilTags by their corners.

`markers` there have `family` (tag36h11), `id` and `object_points`: four corners (x, y, z), metres, in the
order in which OpenCV's ArUco module returns them, x to the right and y towards the bottom of the print
(Wingxtra's precision landing; Landmark exports it). Our pad has x up the print and y to the right.
"""

from __future__ import annotations

import math
from typing import Any, Final

CORNERS: Final = 4
# sides and diagonals of a square, of its side: what was rounded to a millimetre may be off by
SQUARE: Final = 0.02
MARGIN_CELLS: Final = 1.0 / 6.0  # of a marker's side, at the least: a cell of those of the fewest


def is_landing_target(data: Any) -> bool:
    markers = data.get("markers") if isinstance(data, dict) else None
    return bool(
        isinstance(markers, list)
        and markers
        and all(isinstance(marker, dict) and "object_points" in marker for marker in markers)
    )


def pad_of(data: dict[str, Any]) -> dict[str, Any]:
    """The same as a pad's settings, on a board that is as large as the markers and their white need.

    Raises:
        ValueError: no square, or not in one plane; the line names the marker.
    """
    markers = [_marker(given) for given in data["markers"]]
    reach = max(
        max(map(abs, marker["position_pad_m"])) + (math.sqrt(0.5) + MARGIN_CELLS) * marker["side_m"]
        for marker in markers
    )
    board_m = math.ceil(2e3 * reach) / 1e3
    name = str(data.get("name", f"landing_target_{data.get('target_num', 0)}"))
    return {"name": name, "width_m": board_m, "length_m": board_m, "markers": markers}


def _marker(given: dict[str, Any]) -> dict[str, Any]:
    number = given.get("id")
    try:
        points = [tuple(map(float, point)) for point in given["object_points"]]
        corners = [(-y, x) for x, y, *_ in points]
    except (TypeError, ValueError):
        raise ValueError(f"marker {number}: object_points: expected four of x, y, z (m)") from None
    if len(corners) != CORNERS or any(abs(z) > 1e-3 for _, _, *high in points for z in high):
        raise ValueError(f"marker {number}: object_points: expected four corners in one plane, z 0")
    sides = [math.dist(corners[k], corners[k - 1]) for k in range(CORNERS)]
    diagonals = [math.dist(corners[k], corners[k + 2]) / math.sqrt(2.0) for k in range(2)]
    side_m = sum(sides) / CORNERS
    (x0, y0), (x1, y1), (x2, y2), _ = corners
    clockwise = (x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1) > 0.0
    if any(abs(each - side_m) > SQUARE * side_m for each in (*sides, *diagonals)) or not clockwise:
        raise ValueError(f"marker {number}: object_points: expected a square, clockwise from its top left")
    family = str(given.get("family", "")).lower()
    dictionary = family.replace("tag", "apriltag_", 1) if family.startswith("tag") else family
    # from OpenCV's top left corner to its top right one lies to the right of its top
    top_deg = math.degrees(math.atan2(y1 - y0, x1 - x0)) - 90.0
    upside_down = 180.0 if dictionary.startswith("apriltag") else 0.0
    return {
        "dictionary": dictionary,
        "id": number,
        "side_m": round(side_m, 6),
        "position_pad_m": [round(sum(axis) / CORNERS, 6) for axis in zip(*corners, strict=True)],
        "yaw_deg": round((top_deg - upside_down + 180.0) % 360.0 - 180.0, 3),
    }
