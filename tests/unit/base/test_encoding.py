"""How cameras encode light, and the look-up tables there and back."""

import numpy as np
import pytest

from companion.base.encoding import Encoding, decoding_table, encoding_table, grey_of_light, light_of_greys
from companion.config import CameraConfig, ConfigError, find_file, load_model, validate


def test_srgb_is_the_standards() -> None:
    light = light_of_greys("srgb")
    # IEC 61966-2-1: 18 % grey is encoded as 0.4614
    assert np.interp(0.18, light, np.arange(256)) == pytest.approx(0.4614 * 255.0, abs=0.05)
    assert (light[0], light[255]) == (0.0, 1.0)


def test_a_table_holds_at_its_numbers_and_between() -> None:
    light = light_of_greys((0.0, 0.25, 1.0))
    assert light[255] == 1.0
    grey = np.linspace(0.0, 1.0, 256)
    assert light == pytest.approx(np.where(grey < 0.5, 0.5 * grey, 1.5 * grey - 0.5))


@pytest.mark.parametrize("encoding", ["srgb", "linear", (0.0, 0.1, 0.3, 1.0)])
def test_there_and_back_is_the_same_grey(encoding: Encoding) -> None:
    greys = grey_of_light(encoding, light_of_greys(encoding))
    assert greys == pytest.approx(np.arange(256.0), abs=1e-6)
    assert decoding_table(encoding).dtype == np.float32
    # steps of light are coarser than dark greys, no other
    assert (
        np.abs(encoding_table(encoding)[np.rint(decoding_table(encoding)).astype(int)] - np.arange(256)).max()
        < 8
    )


@pytest.mark.parametrize("table", [(0.0, 1.0, 0.5), (0.1, 1.0), (0.0, 0.5, 0.5, 1.0), (1.0,)])
def test_a_table_that_no_camera_has_stops_the_start(table: tuple[float, ...]) -> None:
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    with pytest.raises(ConfigError, match=r"encoding.*expected srgb, linear, or 2 to 256 rising numbers"):
        validate(CameraConfig, {**camera.model_dump(), "encoding": table}, "camera.yaml")
