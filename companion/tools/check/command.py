"""`companion check`: the preflight check; with --pad the first-flight check, held over the pad."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.text import Text

from companion.app.calibration_warnings import forced_calibrations
from companion.app.hardware import open_hardware
from companion.base.files import write_atomically
from companion.base.formats.mjpeg import MjpegServer
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, load_config
from companion.sense.vision.opencv import prepare_opencv
from companion.tools.check.report import cause_lines, report_json, report_table, verdict_line
from companion.tools.check.session import Outlets, PadCheck
from companion.tools.check.steps import Say
from companion.tools.check.wizard import Report
from companion.tools.preflight.doctor import preflight
from companion.tools.preflight.findings import Finding, State, worst
from companion.tools.preflight.report import STYLES, findings_json, findings_table, summary_line

STANDARD_OUTPUT: Final = Path("-")
HELP: Final = """Check, before a flight, all that can be checked of a vehicle that stands there disarmed.

Settings, calibrations, camera, IMU, GPS, ultrasonic, link, the autopilot's parameters, clock, disk and
service: a line each, with what to do about it. Nothing is written to the autopilot. Exit code 0: nothing
fails, 1: something does, 2: it could not be checked.

With --pad, before a first flight, that right is right, forward is forward and down is down: take the
propellers off, keep the vehicle disarmed and hold it over the pad. You are told what to do (hold, raise,
move right and forward, turn, tilt), each move is recognised by itself, and camera, IMU, ultrasonic and
compass are held against it and against one another. What is wrong is named with the setting that mends it.

\b
Examples:
  companion check --config mine.yaml
  companion check --config mine.yaml --json -
  companion check --pad --config mine.yaml
  companion check --pad --config mine.yaml --no-link --json check.json
  companion check --pad --config mine.yaml --serve 8080
"""
_STYLES: Final = {
    "order": ("→ ", "bold"),
    "good": ("  ok  ", "green"),
    "bad": ("  NO  ", "bold red"),
    "note": ("  ", ""),
}


def check_command(
    *,
    pad: Annotated[bool, typer.Option("--pad", help="Held by hand over the pad.")] = False,
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = CONFIG_FOLDER / "companion.yaml",
    no_link: Annotated[
        bool, typer.Option("--no-link", help="Without an autopilot, which else has to be there and disarmed.")
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="Write the result here; '-': to standard output.", metavar="FILE"),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", help="Where flights are kept; else the service's folder.", metavar="DIR"),
    ] = None,
    serve: Annotated[
        int | None,
        typer.Option(
            "--serve",
            min=0,
            max=65535,
            help="With --pad: the picture with its arrows for browsers at 127.0.0.1:PORT (0: a free one).",
            metavar="PORT",
        ),
    ] = None,
) -> None:
    """Check, show and write.

    Raises:
        ConfigError: something the user can correct.
        Exit: with 1 when something is not well.
    """
    prepare_opencv()
    settings = load_config(config)
    if json_file not in (None, STANDARD_OUTPUT) and not json_file.resolve().parent.is_dir():
        raise ConfigError(f"--json {json_file}: cannot be written; expected a file in an existing folder")
    if not pad:
        if serve is not None:
            raise ConfigError("--serve: belongs to --pad; expected both, or neither")
        found = asyncio.run(preflight(settings, config, record, linked=not no_link))
        show_findings(found, json_file)
        raise typer.Exit(1 if worst(found) is State.FAIL else 0)
    _check_over_pad(settings, json_file, linked=not no_link, port=serve)


def show_findings(found: list[Finding], json_file: Path | None) -> None:
    """The table and one line for all; as JSON instead when that is for standard output."""
    if json_file == STANDARD_OUTPUT:
        print(findings_json(found), end="")
        return
    console = Console()
    console.print(findings_table(found))
    console.print(Text(summary_line(found), STYLES[worst(found)]), soft_wrap=True)
    if json_file is not None:
        write_atomically(json_file, findings_json(found))


def _check_over_pad(
    settings: CompanionConfig, json_file: Path | None, *, linked: bool, port: int | None
) -> None:
    if not linked and (settings.sense.source == "autopilot" or settings.sense.range_by_telemetry):
        raise ConfigError("--no-link: sense.source is autopilot; expected boards, or the autopilot's link")
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    for doubt in forced_calibrations(settings):
        console.print(f"warning: {doubt}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    report = asyncio.run(_check(settings, console, linked=linked, port=port))
    show(report, console)
    if json_file == STANDARD_OUTPUT:
        print(report_json(report), end="")
    elif json_file is not None:
        write_atomically(json_file, report_json(report))
    raise typer.Exit(0 if report.passed else 1)


async def _check(config: CompanionConfig, console: Console, *, linked: bool, port: int | None) -> Report:
    page = None if port is None else MjpegServer()
    try:
        if page is not None:
            console.print(f"picture at http://127.0.0.1:{await _open(page, port or 0)}", highlight=False)
        async with open_hardware(config, linked=linked) as hardware:
            outlets = Outlets(lambda said: console.print(line(said), highlight=False, soft_wrap=True), page)
            return await PadCheck(config, hardware, outlets, linked=linked).run()
    finally:
        if page is not None:
            await page.close()


async def _open(page: MjpegServer, port: int) -> int:
    try:
        return await page.start(port)
    except OSError as error:
        raise ConfigError(
            f"--serve {port}: cannot be listened at: {error.strerror}; expected a free port"
        ) from error


def show(report: Report, console: Console) -> None:
    """The table, the likely causes and the verdict."""
    console.print(report_table(report))
    for cause in cause_lines(report):
        console.print(Text(cause), soft_wrap=True)
    console.print(Text(verdict_line(report), style="green" if report.passed else "bold red"), soft_wrap=True)


def line(said: Say) -> Text:
    """One line for a person."""
    lead, style = _STYLES[said.kind]
    return Text(f"{lead}{said.text}", style=style)
