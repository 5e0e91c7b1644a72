"""Pads that other projects describe in a `landing-target.json`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.config import ConfigError
from companion.pad import Pad, load_pad


def tag(number: int, left: float, top: float, side: float = 0.15, **changes: Any) -> dict[str, Any]:
    """x to the right, y towards the bottom of the print."""
    right, bottom = left + side, top + side
    corners = [[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]]
    return {"family": "tag36h11", "id": number, "object_points": corners, **changes}


def read(folder: Path, *markers: dict[str, Any]) -> Pad:
    path = folder / "landing-target.json"
    path.write_text(json.dumps({"target_num": 0, "markers": markers}), encoding="utf-8")
    return load_pad(path)


def test_markers_lie_where_their_corners_are(tmp_path: Path) -> None:
    given = [tag(3, -0.23, -0.18), tag(12, 0.06, -0.18), tag(41, -0.23, 0.08, side=0.06), tag(77, 0.06, 0.08)]
    pad = read(tmp_path, *given)
    for marker, of in zip(pad.markers, given, strict=True):
        x_y = np.array(of["object_points"])[:, :2]
        assert marker.name == f"apriltag_36h11 id {of['id']}"
        # ours: up the print, to the right; corners in OpenCV's order, as theirs
        assert marker.corners_pad_m()[:, :2] == pytest.approx(np.column_stack((-x_y[:, 1], x_y[:, 0])))
    assert [marker.group for marker in pad.markers] == ["F", "F", "C", "F"]


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turned_marker_keeps_its_order_of_corners(tmp_path: Path, turns: int) -> None:
    turned = tag(5, -0.1, -0.1, side=0.2)
    turned["object_points"] = np.roll(turned["object_points"], turns, axis=0).tolist()
    (marker,) = read(tmp_path, turned).markers
    x_y = np.array(turned["object_points"])[:, :2]
    assert marker.corners_pad_m()[:, :2] == pytest.approx(np.column_stack((-x_y[:, 1], x_y[:, 0])))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"object_points": [[0, 0, 0], [1, 0, 0], [1, 1, 0]]}, "marker 5: .* expected four corners"),
        ({"object_points": [[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]]}, "marker 5: .* expected a square"),
        ({"object_points": [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]]}, "clockwise from its top left"),
        ({"object_points": "here"}, "marker 5: object_points: expected four of x, y, z"),
        ({"family": "tagStandard41h12"}, "dictionary: expected one of"),
    ],
)
def test_what_is_wrong_in_one_is_said(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        read(tmp_path, tag(5, -0.1, -0.1, side=0.2, **changes))
