"""The status in the terminal: what a person sees, with and without a pad in sight."""

import io
import os
from dataclasses import replace

import pytest
from rich.console import Console

from companion.app.status import Status
from companion.app.terminal import StatusView
from companion.base.geometry import ZERO3
from companion.base.messages import FrameReport, Notice, PadState, Phase, VehicleState

VEHICLE = VehicleState(
    1.0, (1, 0, 0, 0), ZERO3, (0.0, 0.0, -6.5), ZERO3, ZERO3, ZERO3, ZERO3, 0, 0, 0, True, True
)
PAD = PadState(1.0, (0.3, -0.4, 2.0), ZERO3, (1.2, 0.9, 0.0), ZERO3, 0.0, 1.25, 0.01, 0.1, 0.95)
FRAME = FrameReport(1.0, 1.04, 1.06, 30, {"F": 2, "M": 11, "C": 0}, seen=True, searched_whole_frame=False)


def status(pad: PadState | None, *notices: Notice) -> Status:
    return Status(
        time_s=12.5,
        phase=Phase.DESCEND,
        mode="OFFBOARD",
        vehicle=VEHICLE,
        pad=pad,
        last_frame=None if pad is None else FRAME,
        frame_rate_hz=29.7,
        latency_ms=None if pad is None else 61.4,
        notices=notices,
    )


def shown(*states: Status, terminal: bool, live: bool = True) -> str:
    """What has been printed after these states."""
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=terminal, width=140, color_system=None)
    with StatusView(console, "circle, seed 1", live=live) as view:
        for state in states:
            view(state)
    return screen.getvalue()


def test_the_panel_shows_phase_height_pad_markers_rate_and_latency() -> None:
    text = shown(status(PAD), terminal=True)
    for words in ("circle, seed 1", "12.5 s", "descend (OFFBOARD)", "2.00 m", "0.50 m", "1.50 m/s", "2/11/0"):
        assert words in text
    assert "30/s" in text
    assert "61 ms" in text


def test_without_a_pad_the_height_is_the_vehicles_and_the_rest_is_a_dash() -> None:
    text = shown(status(None), terminal=True)
    assert "6.5 m" in text
    assert " - " in text


def test_a_camera_that_is_lost_shows_in_place_of_its_rate() -> None:
    text = shown(replace(status(None), camera_problem="no frame for 0.25 s"), terminal=True)
    assert "no camera" in text
    assert "30/s" not in text


def test_where_there_is_no_terminal_each_notice_is_one_line() -> None:
    first = Notice(3.0, "phase", "arm: ready: " + "a long word " * 20, "info")
    second = Notice(4.0, "phase", "take off", "info")
    text = shown(status(None, first), status(None, second), status(None), terminal=False)
    lines = text.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("    3.0 s  arm: ready: a long word")
    assert lines[1] == "    4.0 s  take off"


def test_no_ui_prints_notices_on_a_terminal_too() -> None:
    text = shown(status(PAD, Notice(3.0, "phase", "arm", "info")), terminal=True, live=False)
    assert text.strip() == "3.0 s  arm"


class Gone(io.StringIO):
    """A reader that has gone away."""

    def __init__(self, error: OSError) -> None:
        super().__init__()
        self.error, self.writes = error, 0

    def write(self, text: str) -> int:
        self.writes += 1
        raise self.error

    def flush(self) -> None:
        raise self.error


@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "Input/output error")])
def test_a_reader_that_goes_away_ends_no_flight(
    error: OSError, terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Gone(error)
    console = Console(file=screen, force_terminal=terminal, width=140, color_system=None)
    monkeypatch.setattr(os, "dup2", lambda *_: None)  # Rich would take the tests' own output away
    notice = Notice(1.0, "phase", "landed", "info")
    with StatusView(console, "circle, seed 1", live=False) as view:
        view(status(PAD, notice))
        assert screen.writes <= 1
        view(status(PAD, notice))
        assert screen.writes <= 1
