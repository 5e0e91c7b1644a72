"""The words of `calibrate-mount`, run in this process."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibration.command_line import run
from calibration.mount.command import NAME, cli


def calibrate(*words: str | Path) -> int:
    """Run the program; its exit code."""
    with pytest.raises(SystemExit) as ended:
        run(cli, NAME, [str(word) for word in words])
    code = ended.value.code
    assert isinstance(code, int)
    return code
