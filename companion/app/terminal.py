"""The live status in the terminal: one small panel, redrawn in place, with the latest notices under it."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from types import TracebackType
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from companion.app.app import Status
from companion.base.messages import MarkerGroup, Notice

NOTICES_SHOWN: Final = 8
CELLS_A_ROW: Final = 4
LAST_WORDS_S: Final = 1.0  # no longer does the end wait for a terminal that is stopped
SEVERITY_STYLES: Final = {"info": "", "warning": "yellow", "error": "bold red"}
GROUPS: Final[tuple[MarkerGroup, ...]] = ("F", "M", "C")


class StatusView:
    """Shows the app's status; on a terminal as a live panel, elsewhere as one line a notice.

    A thread of its own writes, the newest status and every notice: a terminal that is stopped (Ctrl-S, an ssh
    that stalls) would hold up the control loop. One that goes away is written to no more: a flight does not
    end for want of a reader.
    """

    def __init__(self, console: Console, title: str, *, live: bool) -> None:
        self._console = console
        self._title = title
        self._notices: deque[Notice] = deque(maxlen=NOTICES_SHOWN)
        self._live = Live(console=console, auto_refresh=False) if live and console.is_terminal else None
        self._read = True
        self._waiting: SimpleQueue[Status | None] = SimpleQueue()
        self._writer = threading.Thread(target=self._write, name="terminal", daemon=True)

    def __enter__(self) -> StatusView:
        self._writer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.put(None)
        self._writer.join(LAST_WORDS_S)

    def __call__(self, status: Status) -> None:
        if self._live is not None or status.notices:
            self._waiting.put(status)

    def _write(self) -> None:
        if self._live is not None:
            with self._whoever_reads():
                self._live.start()
        while (status := self._waiting.get()) is not None:
            if self._read:
                with self._whoever_reads():
                    self._show(status)
        if self._live is not None:
            with self._whoever_reads():
                self._live.stop()

    @contextmanager
    def _whoever_reads(self) -> Iterator[None]:
        """Rich makes an exit of a broken pipe; a terminal that hangs up and a full disk are plain errors."""
        try:
            yield
        except OSError:
            self._read = False
        except SystemExit as error:
            if not isinstance(error.__context__, BrokenPipeError):
                raise
            self._read = False

    def _show(self, status: Status) -> None:
        for notice in status.notices:
            self._notices.append(notice)
            if self._live is None:
                self._console.print(_notice_line(notice), highlight=False, soft_wrap=True)
        if self._live is not None:
            self._live.update(self._panel(status), refresh=self._waiting.empty())

    def _panel(self, status: Status) -> Panel:
        lines: list[RenderableType] = [status_table(status)]
        lines += [_notice_line(notice) for notice in self._notices]
        return Panel(Group(*lines), title=self._title, title_align="left")


def status_table(status: Status) -> Table:
    """Phase, height, pad distance and speed, marker groups, frame rate and latency, four in a row."""
    table = Table.grid(padding=(0, 2))
    pad, vehicle, frame = status.pad, status.vehicle, status.last_frame
    height = "-" if vehicle is None else f"{-vehicle.position_ned_m[2]:.1f} m"
    cells: dict[str, str | Text] = {
        "time": f"{status.time_s:6.1f} s",
        "phase": f"{status.phase.value} ({status.mode or '-'})",
        "height": height if pad is None else f"{pad.height_m:.2f} m",
        "pad distance": "-" if pad is None else f"{pad.lateral_m:.2f} m",
        "pad speed": "-" if pad is None else f"{math.hypot(*pad.velocity_ned_m_s[:2]):.2f} m/s",
        "markers F/M/C": "-"
        if frame is None
        else "/".join(str(frame.marker_count.get(g, 0)) for g in GROUPS),
        "frames": f"{status.frame_rate_hz:.0f}/s",
        "latency": "-" if status.latency_ms is None else f"{status.latency_ms:.0f} ms",
    }
    if status.camera_problem is not None:
        cells["frames"] = Text("no camera", style=SEVERITY_STYLES["error"])
    names = list(cells)
    for _ in range(CELLS_A_ROW):
        table.add_column(justify="left", no_wrap=True)
    # all of them side by side take more than the 80 columns of a usual terminal
    for begin in range(0, len(names), CELLS_A_ROW):
        row = names[begin : begin + CELLS_A_ROW]
        table.add_row(*(Text(name, style="dim") for name in row))
        table.add_row(*(cells[name] for name in row))
    return table


def _notice_line(notice: Notice) -> Text:
    return Text(f"{notice.time_s:7.1f} s  {notice.text}", style=SEVERITY_STYLES[notice.severity])
