"""`companion pad`: what it says, prints and draws, and what it says of what cannot be."""

from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from companion.cli import cli
from companion.config import CONFIG_FOLDER, ConfigError

BAD = """
name: bad
width_m: 0.3
length_m: 0.3
markers:
  - {dictionary: 4x4_50, id: 0, side_m: 0.1, position_pad_m: [0.05, 0.0], group: F}
  - {dictionary: 4x4_50, id: 1, side_m: 0.1, position_pad_m: [-0.06, 0.0], group: F}
"""


def test_a_good_pad_is_reported_in_a_few_lines() -> None:
    result = CliRunner().invoke(cli, ["pad", "indoor_400"])
    assert result.exit_code == 0
    assert result.output.splitlines() == [
        "indoor_400: 400 x 400 mm, 57 markers, good",
        "  F: 4 x 120 mm, 4x4_50",
        "  M: 4 x 56 mm, 4x4_50",
        "  C: 49 x 12 mm, 5x5_50",
        "  6 sheets of 210 x 297 mm (a4)",
    ]


def test_another_paper_takes_the_place_of_the_pad_s_own(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["pad", "indoor_400", "--paper", "a3", "-o", str(tmp_path / "pad.svg")])
    assert result.exit_code == 0
    assert "2 sheets of 420 x 297 mm (a3)" in result.output
    # two sheets and the plan, one to a file
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pad-1.svg", "pad-2.svg", "pad-3.svg"]


def test_the_coverage_is_reported_and_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "coverage.png"
    words = ["pad", "indoor_400", "--coverage", "--camera", "hd_1280x720", "--offset", "0.01"]
    result = CliRunner().invoke(cli, [*words, "-o", str(picture)])
    assert result.exit_code == 0
    assert "predicted recall (%)" in result.output
    assert "hd_1280x720, 1 cm and 5 % of the height off the middle" in result.output
    assert "blind height: " in result.output
    assert cv2.imread(str(picture)) is not None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nobody"], "pads: no 'nobody'"),
        (["bad.yaml"], "bad.yaml: the quiet zone is cut into: 4x4_50 id 0 (16.67 mm) by 4x4_50 id 1"),
        (["indoor_400", "-o", "pad.jpg"], "-o pad.jpg: expected a .pdf, .svg, .png file"),
        (["indoor_400", "-o", "nowhere/pad.pdf"], "-o nowhere/pad.pdf: expected"),
        (["--coverage", "-o", "pad.pdf"], "-o pad.pdf: expected a .png file"),
        (["--coverage", "--camera", "none"], "cameras: no 'none'"),
        (["--tilt", "3"], "--camera, --offset, --tilt and --speed: expected with --coverage"),
        (["whole.yaml", "--paper", "a4"], "whole.yaml on a4: a cut would divide 4x4_50 id 0 (360 mm)"),
    ],
)
def test_what_a_user_gets_wrong_is_one_line(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.yaml").write_text(BAD)
    shipped = (CONFIG_FOLDER / "pads" / "moving_1300.yaml").read_text()
    (tmp_path / "whole.yaml").write_text(
        shipped.replace("{paper: large,", "{whole_markers: true, paper: large,")
    )
    error = CliRunner().invoke(cli, ["pad", *words]).exception
    assert isinstance(error, ConfigError)
    assert str(error).startswith(said)
    assert "\n" not in str(error)
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".yaml"] == []
