"""The words of `companion-sitl campaign`, and what a run of it leaves."""

import io
from pathlib import Path

from rich.console import Console

from sitl.campaign.rows import CSV_NAME, read_rows
from sitl.campaign.run import Options, run_campaign


def options(
    folder: Path | None, *sources: str, first_seed: int = 0, runs: int = 2, bars: bool = False
) -> Options:
    return Options(sources or ("static",), runs, first_seed, 2, folder, None, None, bars, quiet=True)


def run(chosen: Options) -> tuple[int, str]:
    out = io.StringIO()
    code = run_campaign(chosen, Console(file=out, width=80))
    return code, out.getvalue()


def seeds(folder: Path) -> list[int]:
    return [each.seed for each in read_rows(folder / CSV_NAME)]
