"""`companion-experiments`: the paper's figures from its own settings."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console
from typer.exceptions import TyperException

from companion.config import ConfigError
from companion.experiments import tune_flight_pid

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    no_args_is_help=True,
)


@app.callback()
def experiments() -> None:
    """The paper's experiments, each with a table and a plot."""


@app.command("tune-flight-pid")
def tune_pid(
    *,
    draws: Annotated[int, typer.Option(min=1, help="Gains tried in each of three rounds.")] = 30,
    seed: Annotated[int, typer.Option(min=0, help="Of the draws.")] = 0,
) -> None:
    """Tune the gains of control.pid (a few minutes), and fly them on seeds that tuned nothing."""
    console = Console()
    pid = tune_flight_pid.tune(draws, seed, lambda line: console.print(line, highlight=False))
    tune_flight_pid.show(pid, console)


def main() -> None:
    """Run an experiment: whatever the user got wrong ends in one line on standard error."""
    try:
        code = app(standalone_mode=False)
    except (TyperException, ConfigError) as error:
        text = error.format_message() if isinstance(error, TyperException) else str(error)
        print(f"companion-experiments: {text.rstrip('.')}", file=sys.stderr)
        code = 2
    except typer.Abort:
        code = 1
    sys.exit(code)


if __name__ == "__main__":
    main()
