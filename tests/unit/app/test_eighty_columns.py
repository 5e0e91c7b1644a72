"""What is shown live fits the 80 columns of a usual terminal: nothing that tells what to do is cut off."""

import io

import numpy as np
from rich.console import Console

from calibration.magnetometer.collect import CoverageProgress, drawn
from calibration.magnetometer.ellipsoid import CELLS
from companion.app.app import Status
from companion.app.terminal import status_table
from companion.base.messages import Phase


def shown(what: object) -> list[str]:
    file = io.StringIO()
    Console(file=file, width=80, force_terminal=False).print(what)
    return file.getvalue().splitlines()


def test_the_status_names_the_whole_mode() -> None:
    status = Status(1234.5, Phase.TOUCHDOWN, "AUTO.LOITER", None, None, None, 30.0, 123.0, ())
    text = shown(status_table(status))
    assert "touchdown (AUTO.LOITER)" in "".join(text)
    assert "123 ms" in "".join(text)
    assert max(map(len, text)) <= 80


def test_the_magnetometer_s_instruction_is_whole() -> None:
    hint = "roll right by 90 degrees and nose down by 45 degrees, then turn it once right round like that"
    now = CoverageProgress(12345, np.zeros(CELLS, dtype=bool), None, hint)
    text = shown(drawn(now, 123.0))
    assert max(map(len, text)) <= 80
    assert hint in " ".join(" ".join(text).split())
