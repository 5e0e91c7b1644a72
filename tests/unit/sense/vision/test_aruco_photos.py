"""OpenCV's tutorial photographs with its reference corners: any list of codes is read, not only a pad's."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.config import CONFIG_FOLDER
from companion.sense.vision.aruco import CodeReader
from companion.sense.vision.corners import refine_quads

PHOTOS = [
    ("singlemarkersoriginal.jpg", None, 6),
    ("gboriginal.jpg", "tutorial_dict.yml", 35),
    ("choriginal.jpg", None, 17),
    ("chocclusion_original.jpg", None, 13),
]
SMALLEST_PX = 12.0


def folder() -> Path:
    data = os.environ.get("COMPANION_DATA", CONFIG_FOLDER.parent.parent / "shared" / "data")
    path = Path(data) / "aruco"
    if not (path / "gold_corners.json").exists():
        pytest.skip(f"{path} is not there: OpenCV's photographs, not part of the project")
    return path


@pytest.mark.parametrize(("name", "dictionary_file", "count"), PHOTOS)
def test_every_marker_of_a_photograph_is_found_and_no_other(
    name: str, dictionary_file: str | None, count: int
) -> None:
    place = folder()
    photographs = json.loads((place / "gold_corners.json").read_text())
    reference = {int(number): np.array(corners) for number, corners in photographs[name].items()}
    if dictionary_file is None:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    else:
        storage = cv2.FileStorage(str(place / dictionary_file), cv2.FILE_STORAGE_READ)
        dictionary = cv2.aruco.Dictionary()
        assert dictionary.readDictionary(storage.root())
    image = cv2.imread(str(place / name), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    # all ids of the dictionary are asked for: what is not in the photograph must not be found
    codes = CodeReader([dictionary], [(0, i) for i in range(len(dictionary.bytesList))]).read(
        np.asarray(image, np.uint8), SMALLEST_PX
    )
    assert {code.number for code in codes} == set(reference)
    assert len(codes) == count
    quads = np.array([code.corners_px for code in codes])
    expected = np.array([reference[code.number] for code in codes], dtype=np.float64)
    assert np.abs(quads - expected).max() <= 1.0
    # the reference are outermost black pixels: the print ends half a pixel farther out
    refined = refine_quads(np.asarray(image, np.uint8), quads, np.full(count, 8.0))
    corners, std_px = refined.corners, refined.corner_std_px
    outward = np.sign(expected - expected.mean(axis=1, keepdims=True))
    missed = np.linalg.norm(corners - expected - 0.5 * outward, axis=2)
    assert missed.mean(axis=1).max() <= 1.0
    assert np.isfinite(std_px).all()
