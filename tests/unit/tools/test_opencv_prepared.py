"""Commands that look at images prepare OpenCV as flights do."""

from __future__ import annotations

import cv2
import pytest

from companion.config import CONFIG_FOLDER, ConfigError
from companion.tools.check.command import check_command
from companion.tools.pads.command import pad_command


@pytest.fixture
def two_threads() -> None:
    """As OpenCV has it, more than one."""
    cv2.setNumThreads(2)


def test_the_pad_command_has_one_thread(two_threads: None) -> None:
    pad_command("indoor_400")
    assert cv2.getNumThreads() == 1


def test_the_check_has_one_thread(two_threads: None) -> None:
    with pytest.raises(ConfigError):
        check_command(pad=True, config=CONFIG_FOLDER / "nope.yaml")
    assert cv2.getNumThreads() == 1
