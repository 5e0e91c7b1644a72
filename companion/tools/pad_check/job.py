"""What `companion check` does once its options are right: checks, shows and writes."""

import json
from pathlib import Path
from typing import Final

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.app.hardware import open_hardware
from companion.app.sensing import forced_calibrations
from companion.base.files import write_atomically
from companion.base.formats.mjpeg import serving
from companion.base.signals import run_until_stopped
from companion.config import CompanionConfig, ConfigError, load_config
from companion.sense.vision.opencv import prepare_opencv
from companion.tools.pad_check.session import PadCheck
from companion.tools.pad_check.wizard import Report, Say
from companion.tools.preflight.findings import (
    STYLES,
    Finding,
    FindingState,
    findings_json,
    findings_table,
    not_looked_at,
    summary_line,
    worst,
)
from companion.tools.preflight.parameters import GROUP, parameter_file, parameters_read
from companion.tools.preflight.run import preflight


def report_table(report: Report) -> Table:
    table = Table(title="check over the pad", title_justify="left", show_lines=False)
    for heading in ("", "question", "measured"):
        table.add_column(heading)
    for finding in report.findings:
        table.add_row("[green]ok[/]" if finding.passed else "[bold red]NO[/]", finding.name, finding.detail)
    return table


def cause_lines(report: Report) -> list[str]:
    """What to correct, one line a cause, with the questions that it answers."""
    questions: dict[str, list[str]] = {}
    for name, cause in report.causes.items():
        questions.setdefault(cause, []).append(name)
    return [f"{', '.join(names)}: {cause}" for cause, names in questions.items()]


def verdict_line(report: Report) -> str:
    bad = sum(not finding.passed for finding in report.findings)
    if not bad:
        return (
            f"all {len(report.findings)} answers are right: right is right, forward is forward, down is down"
        )
    return f"{bad} of {len(report.findings)} answers are wrong: not ready to fly"


def report_json(report: Report) -> str:
    """The result as JSON: `passed`, and for each question `name`, `passed`, `detail`, `values`, `cause`."""
    checks = [
        {
            "name": finding.name,
            "passed": finding.passed,
            "detail": finding.detail,
            "blamed": list(finding.blamed),
            "cause": report.causes.get(finding.name),
            "values": {name: round(value, 4) for name, value in finding.values.items()},
        }
        for finding in report.findings
    ]
    return json.dumps({"passed": report.passed, "checks": checks}, indent=2, ensure_ascii=False) + "\n"


# ---------------------------------------------------------------- the check

STANDARD_OUTPUT: Final = Path("-")
_STYLES: Final = {
    "order": ("→ ", "bold"),
    "good": ("  ok  ", "green"),
    "bad": ("  NO  ", "bold red"),
    "note": ("  ", ""),
}


def check_vehicle(
    config: Path,
    json_file: Path | None,
    record: Path | None,
    *,
    linked: bool,
    params_file: Path | None = None,
) -> None:
    """The preflight check; the autopilot's parameters that differ go to `params_file`.

    Raises:
        ConfigError: something the user can correct, also that no parameter could be read.
        Exit: with 1 when something is not well.
    """
    prepare_opencv()
    found = run_until_stopped(preflight(load_config(config), config, record, linked=linked))
    show_findings(found, json_file)
    if params_file is not None:
        if not parameters_read(found):
            why = next(item for item in found if item.group == GROUP)
            raise ConfigError(
                f"--write-params {params_file}: not written, since no parameter was read: {why.detail}; "
                f"expected {why.hint or 'an autopilot that answers'}"
            )
        write_atomically(params_file, parameter_file(found))
    raise typer.Exit(1 if worst(found) is FindingState.FAIL else 0)


def show_findings(found: list[Finding], json_file: Path | None) -> None:
    """The table and one line for all; as JSON instead when that is for standard output."""
    if json_file != STANDARD_OUTPUT:
        console = Console()
        console.print(findings_table(found))
        state = worst(found)
        if state is FindingState.OK and not_looked_at(found):
            state = FindingState.WARNING
        console.print(Text(summary_line(found), STYLES[state]), soft_wrap=True)
    _write_json(json_file, findings_json(found))


def _write_json(json_file: Path | None, text: str) -> None:
    if json_file == STANDARD_OUTPUT:
        print(text, end="")
    elif json_file is not None:
        write_atomically(json_file, text)


def check_over_pad(config: Path, json_file: Path | None, *, linked: bool, port: int | None) -> None:
    """The check held over the pad; `port` shows the picture there.

    Raises:
        ConfigError: something the user can correct.
        Exit: with 1 when something is not well.
    """
    prepare_opencv()
    settings = load_config(config)
    if not linked and (settings.sense.source == "autopilot" or settings.sense.range_by_telemetry):
        raise ConfigError("--no-link: sense.source is autopilot; expected boards, or the autopilot's link")
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    for doubt in forced_calibrations(settings):
        console.print(f"warning: {doubt}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    report = run_until_stopped(_check(settings, console, linked=linked, port=port))
    show(report, console)
    _write_json(json_file, report_json(report))
    raise typer.Exit(0 if report.passed else 1)


async def _check(config: CompanionConfig, console: Console, *, linked: bool, port: int | None) -> Report:
    def say(said: Say) -> None:
        console.print(line(said), highlight=False, soft_wrap=True)

    async with (
        serving(port, lambda text: console.print(text, highlight=False)) as page,
        open_hardware(config, linked=linked) as hardware,
    ):
        return await PadCheck(config, hardware, say, page=page, linked=linked).run()


def show(report: Report, console: Console) -> None:
    console.print(report_table(report))
    for cause in cause_lines(report):
        console.print(Text(cause), soft_wrap=True)
    console.print(Text(verdict_line(report), style="green" if report.passed else "bold red"), soft_wrap=True)


def line(said: Say) -> Text:
    lead, style = _STYLES[said.kind]
    return Text(f"{lead}{said.text}", style=style)
