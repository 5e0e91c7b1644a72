"""`companion-sitl campaign`: fly many runs, write one row per run, and print a summary.

Exit codes: 0 every run has its row, 1 a run failed (its process died or hung) or, with --bars, a bar does not
hold, 2 a user error, 130 interrupted (the same command continues).
"""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import tempfile
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console

from companion.base.files import write_atomically
from companion.config import ConfigError
from sitl.campaign import SCENARIOS
from sitl.campaign.manifest import MANIFEST_NAME, CampaignRun, Plan, check_goes_on, make_plan, read_manifest
from sitl.campaign.pool import fly_locally
from sitl.campaign.progress import Meter
from sitl.campaign.rows import CSV_NAME, Row, RunsFile, make_row, pending, read_rows, write_parquet
from sitl.campaign.worker import RunResult
from sitl.firmware.options import FirmwareOption, FirmwareParamOption, FirmwarePathOption
from sitl.firmware.spec import FirmwareSpec
from sitl.run.process_control import terminated_as_interrupted

INTERRUPTED: Final = 130
FAILED: Final = 1
SUMMARY_NAME: Final = "summary.txt"
SUMMARY_COLUMNS: Final = 160
HELP: Final = """Fly scenarios under many seeds: one row per run, tables, plots, the worst runs.

Each run is what 'companion --sitl --fast' flies for that scenario and seed. Give the same command again after
an interruption, and it continues.

\b
companion-sitl campaign --scenarios line circle --runs 20 --out mine
companion-sitl campaign --scenarios all barge.yaml --runs 100 --jobs 4 --out all
"""


@dataclass(frozen=True, slots=True)
class Options:
    """The options of the command. `folder` None stores nothing."""

    sources: tuple[str, ...]
    runs: int
    first_seed: int
    jobs: int
    folder: Path | None
    config: Path | None
    scheduler: str | None
    bars: bool
    quiet: bool
    firmware: FirmwareSpec | None = None

    @property
    def command(self) -> str:
        """The command line that continues it."""
        words = ["companion-sitl", "campaign", "--scenarios", *self.sources, "--runs", str(self.runs)]
        given = {
            "--first-seed": self.first_seed or None,
            "--jobs": None if self.scheduler else self.jobs,
            "--out": self.folder,
            "--config": self.config,
            "--scheduler": self.scheduler,
        }
        words += [word for name, value in given.items() if value is not None for word in (name, str(value))]
        words += () if self.firmware is None else self.firmware.options
        return shlex.join(words + ["--bars"] * self.bars + ["--quiet"] * self.quiet)


def campaign_command(
    *,
    scenarios: Annotated[
        list[str] | None,
        typer.Option(
            help="Names in configs/scenarios, or files; 'all' is every shipped one.",
            metavar="NAME...",
            show_default=" ".join(SCENARIOS),
        ),
    ] = None,
    more: Annotated[list[str] | None, typer.Argument(hidden=True, metavar="NAME")] = None,
    runs: Annotated[int, typer.Option(min=1, help="Runs of each scenario, one a seed.", metavar="N")] = 10,
    first_seed: Annotated[int, typer.Option(min=0, help="The first of the seeds.", metavar="N")] = 0,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Runs side by side; else as many as there are cores.", metavar="J"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Rows, tables and plots go there; else nothing is kept.", metavar="DIR"),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="The app's settings.", metavar="FILE")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Fly on the Dask cluster of this scheduler (extra 'campaign').", metavar="ADDRESS"),
    ] = None,
    firmware: FirmwareOption = None,
    firmware_path: FirmwarePathOption = None,
    firmware_param: FirmwareParamOption = None,
    bars: Annotated[bool, typer.Option("--bars", help="Judge the landings by the project's bars.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No live bar: lines, as for a log.")] = False,
) -> None:
    """Fly a campaign, or go on with one.

    Raises:
        ConfigError: a user error.
    """
    if scheduler is not None and jobs is not None:
        raise ConfigError("--jobs: the cluster has its own; expected it without --scheduler")
    options = Options(
        sources=(*(scenarios or ()), *(more or ())) or SCENARIOS,
        runs=runs,
        first_seed=first_seed,
        jobs=jobs or len(os.sched_getaffinity(0)),
        folder=out,
        config=config,
        scheduler=scheduler,
        bars=bars,
        quiet=quiet,
        firmware=FirmwareSpec.of(firmware, firmware_path, firmware_param or ()),
    )
    raise typer.Exit(run_campaign(options, Console()))


def run_campaign(options: Options, console: Console) -> int:
    """Fly the runs without a row, then print the summary; returns the exit code.

    Raises:
        ConfigError: a user error.
    """
    plan = make_plan(options.sources, options.first_seed, options.runs, options.config, options.firmware)
    with contextlib.ExitStack() as stack:
        folder = options.folder or Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="companion-campaign-"))
        )
        runs = _open(folder, plan)
        stack.callback(runs.close)
        try:
            with terminated_as_interrupted():
                _fly(plan, runs, options, console)
                rows = _in_order(plan, runs.rows)
                _publish(folder, plan, rows, console)
        except KeyboardInterrupt:
            _say_how_to_go_on(console, options, runs, len(list(plan.flights())))
            return INTERRUPTED
        if options.folder is not None:
            console.print(f"rows, tables and plots in {folder}", highlight=False, soft_wrap=True)
        return _verdict(rows, console, bars=options.bars)


def _open(folder: Path, plan: Plan) -> RunsFile:
    """The campaign's file of rows, once it is sure that it is this one's.

    The file of rows is opened first: who has it is alone with the folder, the manifest included.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {folder}: cannot be written: {error.strerror}") from error
    runs = RunsFile(folder)
    try:
        _check_is_ours(folder, plan, runs)
        write_atomically(folder / MANIFEST_NAME, plan.manifest.model_dump_json(indent=2) + "\n")
    except BaseException:
        runs.close()
        raise
    return runs


def _check_is_ours(folder: Path, plan: Plan, runs: RunsFile) -> None:
    old = read_manifest(folder)
    if old is not None:
        check_goes_on(old, plan.manifest, folder)
    elif runs.rows:
        raise ConfigError(
            f"--out {folder}: has a {CSV_NAME} without its {MANIFEST_NAME}; expected a new folder"
        )
    planned = {(flight.scenario, flight.seed) for flight in plan.flights()}
    for number, row in enumerate(runs.rows, start=2):
        run = (row.scenario, row.seed)
        if run not in planned:
            raise ConfigError(
                f"{runs.path}:{number}: '{row.scenario}', seed {row.seed} is in the file twice, or none of "
                "this campaign's; expected one row a run"
            )
        planned.remove(run)


def _fly(plan: Plan, runs: RunsFile, options: Options, console: Console) -> None:
    flights = list(plan.flights())
    left = pending(flights, runs.rows)
    if len(left) < len(flights):
        text = f"{len(flights) - len(left)} of {len(flights)} runs are in {runs.path} already"
        console.print(text, highlight=False, soft_wrap=True)
    if not left:
        return
    with (
        contextlib.closing(_flown(left, options)) as ended,
        Meter(console, runs.rows, len(flights), quiet=options.quiet) as meter,
    ):
        for flown in ended:
            row = make_row(flown, f"{plan.manifest.version}+{plan.manifest.code}")
            runs.append(row)
            meter.take(row)


def _flown(flights: Sequence[CampaignRun], options: Options) -> Generator[RunResult, None, None]:
    """Where they are flown."""
    if options.scheduler is None:
        return fly_locally(flights, options.jobs)
    try:
        from sitl.campaign.cluster import fly_on_cluster  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"--scheduler: needs Dask ({error}); install the extra: pip install 'companion[campaign]'"
        ) from error
    return fly_on_cluster(flights, options.scheduler)


def _say_how_to_go_on(console: Console, options: Options, runs: RunsFile, total: int) -> None:
    if options.folder is None:
        console.print(f"stopped after {len(runs.rows)} of {total} runs; without --out none is kept")
        return
    kept = len(read_rows(runs.path))  # the interruption may have come just after a row was written
    console.print(
        f"stopped: {kept} of {total} runs are in {runs.path}; to continue:\n  {options.command}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def _in_order(plan: Plan, rows: Sequence[Row]) -> list[Row]:
    """The rows scenario by scenario and seed by seed, however they came."""
    places = {name: place for place, name in enumerate(plan.scenarios)}
    return sorted(rows, key=lambda row: (places[row.scenario], row.seed))


def _publish(folder: Path, plan: Plan, rows: Sequence[Row], console: Console) -> None:
    from sitl.campaign.plots import write_plots  # noqa: PLC0415 - drawing and statistics take seconds to load,
    from sitl.campaign.tables import print_summary  # noqa: PLC0415   which the simulator alone need not spend

    bounds = {name: scenario.pass_bounds for name, scenario in plan.scenarios.items()}
    print_summary(console, rows, bounds)
    text = io.StringIO()
    print_summary(Console(file=text, width=SUMMARY_COLUMNS), rows, bounds)
    write_atomically(folder / SUMMARY_NAME, text.getvalue())
    write_plots(folder, rows, plan.scenarios)
    write_parquet(rows, folder)


def _verdict(rows: Sequence[Row], console: Console, *, bars: bool) -> int:
    from sitl.campaign.figures import bars as judge  # noqa: PLC0415 - as above

    failed = any(row.outcome == "failed" for row in rows)
    if not bars:
        return FAILED if failed else 0
    judged = judge(rows)
    console.print(f"bars: {', '.join(map(str, judged))}", highlight=False, soft_wrap=True)
    return 0 if all(bar.holds for bar in judged) else FAILED
