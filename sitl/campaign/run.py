"""A campaign flown: many runs, one row per run, a summary; what was begun goes on."""

from __future__ import annotations

import contextlib
import io
import shlex
import tempfile
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from companion.base.files import make_folder, write_atomically
from companion.config import ConfigError
from sitl.campaign.manifest import MANIFEST_NAME, CampaignRun, Plan, check_goes_on, make_plan, read_manifest
from sitl.campaign.rows import CSV_NAME, Row, RunsFile, make_row, pending, read_rows, write_parquet
from sitl.campaign.worker import RunResult, fly_locally
from sitl.firmware.spec import FirmwareSpec
from sitl.run.process_control import terminated_as_interrupted

INTERRUPTED: Final = 130
FAILED: Final = 1
SUMMARY_NAME: Final = "summary.txt"
SUMMARY_COLUMNS: Final = 160


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


def run_campaign(options: Options, console: Console) -> int:
    """Fly the runs without a row, then print the summary; returns the exit code."""
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
    runs = RunsFile(make_folder("--out", folder))
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
        CampaignMeter(console, runs.rows, len(flights), quiet=options.quiet) as meter,
    ):
        for flown in ended:
            row = make_row(flown, f"{plan.manifest.version}+{plan.manifest.code}")
            runs.append(row)
            meter.take(row)


def _flown(flights: Sequence[CampaignRun], options: Options) -> Generator[RunResult, None, None]:
    if options.scheduler is None:
        return fly_locally(flights, options.jobs)
    try:
        from sitl.campaign.cluster import fly_on_cluster  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"--scheduler: needs Dask ({error}); install the extra: pip install 'companion-landing[campaign]'"
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
    from sitl.campaign.tables import bars as judge  # noqa: PLC0415 - as above

    failed = any(row.outcome == "failed" for row in rows)
    if not bars:
        return FAILED if failed else 0
    judged = judge(rows)
    console.print(f"bars: {', '.join(map(str, judged))}", highlight=False, soft_wrap=True)
    return 0 if all(bar.holds for bar in judged) else FAILED


# ---------------------------------------------------------------- progress

LINES_IN_ALL: Final = 10


class CampaignMeter:
    """Counts runs and landings; prints each run that did not land, and the command that repeats it."""

    def __init__(self, console: Console, rows: Sequence[Row], total: int, *, quiet: bool) -> None:
        """Begin with the rows there are; `total` counts them too. Quiet: lines, as for a log."""
        self._console = console
        self._total = total
        self._done = len(rows)
        self._landed = sum(row.landed for row in rows)
        self._bar = None if quiet or not console.is_terminal else _bar(console)

    def __enter__(self) -> CampaignMeter:
        if self._bar is not None:
            self._bar.start()
            self._task = self._bar.add_task(
                "runs", total=self._total, completed=self._done, words=self._words()
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def take(self, row: Row) -> None:
        tenth = self._done * LINES_IN_ALL // self._total
        self._done += 1
        self._landed += row.landed
        if not row.landed:
            said = row.reason or row.error
            self._console.print(
                f"{row.outcome}: {said}: {row.command}", highlight=False, markup=False, soft_wrap=True
            )
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, words=self._words())
        elif self._done * LINES_IN_ALL // self._total > tenth:
            self._console.print(f"{self._done} of {self._total} runs, {self._words()}", highlight=False)

    def _words(self) -> str:
        return f"{self._landed} landed" + (
            f" ({100 * self._landed / self._done:.0f} %)" if self._done else ""
        )


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[words]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
