"""Commands that look at images prepare OpenCV as flights do."""

from pathlib import Path

import cv2
import pytest

from companion.config import ConfigError
from companion.tools.commands import check_command, pad_command


@pytest.fixture
def two_threads() -> None:
    """As OpenCV has it, more than one."""
    cv2.setNumThreads(2)


def test_the_pad_command_has_one_thread(two_threads: None) -> None:
    pad_command("indoor_400")
    assert cv2.getNumThreads() == 1


def test_the_check_has_one_thread(two_threads: None, tmp_path: Path) -> None:
    settings = tmp_path / "mine.yaml"
    settings.write_text("sense: {source: autopilot}\n")
    with pytest.raises(ConfigError, match="--no-link"):
        check_command(pad=True, config=settings, no_link=True)
    assert cv2.getNumThreads() == 1
