"""`companion-sitl campaign`: fly many runs, write one row per run, and print a summary.

Exit codes: 0 every run has its row, 1 a run failed (its process died or hung) or, with --bars, a bar does not
hold, 2 a user error, 130 interrupted (the same command continues).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import find_file, must_be_readable
from sitl.campaign import SCENARIOS
from sitl.firmware.options import FirmwareOption, FirmwareParamOption, FirmwarePathOption

ALL: Final = "all"
HELP: Final = """Fly scenarios under many seeds: one row per run, tables, plots, the worst runs.

Each run is what 'companion --sitl --fast' flies for that scenario and seed. Give the same command again after
an interruption, and it continues.

\b
companion-sitl campaign --scenarios line circle --runs 20 --out mine
companion-sitl campaign --scenarios all barge.yaml --runs 100 --jobs 4 \\
    --out all
"""


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
    sources = (*(scenarios or ()), *(more or ())) or SCENARIOS
    _must_exist(sources, config)
    from rich.console import Console  # noqa: PLC0415 - what flies is imported once the files are there

    from sitl.campaign.run import Options, run_campaign  # noqa: PLC0415
    from sitl.firmware.spec import FirmwareSpec  # noqa: PLC0415

    options = Options(
        sources=sources,
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


def _must_exist(sources: Sequence[str], config: Path | None) -> None:
    """What is missing is reported before anything heavy is imported."""
    for source in sources:
        if source != ALL:
            find_file("scenarios", source)
    if config is not None:
        must_be_readable(config)
