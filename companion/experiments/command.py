"""`companion-experiments`: the paper's figures from its own settings."""

from __future__ import annotations

import typer

from companion.experiments.fig14_command import fig14

app = typer.Typer(help="The paper's experiments, each with a table and a plot.", no_args_is_help=True)


@app.callback()
def experiments() -> None:
    """The paper's experiments, each with a table and a plot."""


app.command()(fig14)


def main() -> None:
    """Run an experiment."""
    app()


if __name__ == "__main__":
    main()
