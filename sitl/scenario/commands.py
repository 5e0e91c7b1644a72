"""`companion-sitl scenarios` and `companion-sitl schema`: their options and help."""

from __future__ import annotations

import shutil
import sys
from typing import Annotated, Final

import typer

from companion.base.files import find_file

SCENARIOS_HELP: Final = "List the shipped scenarios; with a name or a file, print all its settings."
SCHEMA_HELP: Final = "Print the JSON schema of scenario files, for editors."


def scenarios_command(
    name: Annotated[
        str | None, typer.Argument(help="A name in configs/scenarios, or a file.", show_default=False)
    ] = None,
) -> None:
    """List, or show one.

    Raises:
        ConfigError: there is no such scenario, or it breaks a rule.
    """
    if name is not None:
        find_file("scenarios", name)
    from sitl.scenario.listing import listing, settings_text  # noqa: PLC0415 - not for what is not there
    from sitl.scenario.scenario import load_scenario  # noqa: PLC0415

    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    typer.echo(listing(width) if name is None else settings_text(load_scenario(name)), nl=False)


def schema_command() -> None:
    """Print the schema."""
    from sitl.scenario.listing import schema_text  # noqa: PLC0415 - as above

    typer.echo(schema_text(), nl=False)
