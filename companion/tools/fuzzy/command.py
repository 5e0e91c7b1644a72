"""`companion fuzzy`: its options and help. What computes and draws is imported once the rules are there."""

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import find_file

HELP: Final = """Show the fuzzy speed controller behind eq. 37: its rules, and what its flight table is worth.

RULES is a name in configs/fuzzy or a .yaml file; else the shipped landing rules. The table that flies is held
against scikit-fuzzy at random inputs in and beyond its grid.

\b
companion fuzzy
companion fuzzy --plot fuzzy.png
companion fuzzy mine.yaml --write-table

Exit codes: 0 the table holds and the rules are a pilot's, 1 one of the two is not so, 2 something to mend.
"""


def fuzzy_command(
    rules: Annotated[str, typer.Argument(metavar="RULES", show_default=False)] = "landing",
    *,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="Draw membership functions and the speed.", metavar="FILE.png"),
    ] = None,
    rewrite: Annotated[
        bool, typer.Option("--write-table", help="Compute the flight table and store it beside the rules.")
    ] = False,
    points: Annotated[int, typer.Option("--points", min=1, help="Random inputs to compare at.")] = 20000,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of these inputs.")] = 0,
) -> None:
    """Show, check and draw.

    Raises:
        ConfigError: the rules cannot be read or break a rule, or a file cannot be written.
    """
    if plot is not None and (plot.suffix.lower() != ".png" or not plot.parent.is_dir()):
        raise ConfigError(f"--plot {plot}: expected a .png file in a folder that exists")
    find_file("fuzzy", rules)
    from companion.tools.fuzzy.run import run_fuzzy  # noqa: PLC0415 - see above

    raise typer.Exit(0 if run_fuzzy(rules, plot, points, seed, rewrite=rewrite) else 1)
