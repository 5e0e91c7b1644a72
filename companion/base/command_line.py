"""Command lines that start fast: a command's module is imported when that command runs, not before.

`companion --help` on a Raspberry Pi must not wait for OpenCV, OSQP and MAVSDK. Typer needs the options of a
command only when it parses them, so the group knows each command by its name and one line of help.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module, metadata
from typing import Annotated, Any

import typer
from typer.core import TyperGroup


@dataclass(frozen=True, slots=True)
class Command:
    """A command: `function` as "package.module:name", one line, and where in that module its help is."""

    function: str
    summary: str
    help_name: str = "HELP"
    hidden: bool = False

    def load(self, name: str) -> Any:
        """Import the module and build the command that Typer runs."""
        module_name, _, function_name = self.function.partition(":")
        module = import_module(module_name)
        app = new_app()
        app.command(name, help=getattr(module, self.help_name))(getattr(module, function_name))
        return typer.main.get_command(app)


def new_app(**options: Any) -> typer.Typer:
    """A Typer application with what all command lines here have in common: errors are one line, by us."""
    return typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, **options)


def lazy_app(commands: Mapping[str, Command], **options: Any) -> typer.Typer:
    """A Typer application whose `commands` are imported only when they run."""

    class LazyGroup(TyperGroup):
        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            name, stub, rest = super().resolve_command(ctx, args)
            return name, stub if name is None else commands[name].load(name), rest

    app = new_app(cls=LazyGroup, **options)
    for name, command in commands.items():
        app.command(name, short_help=command.summary, hidden=command.hidden)(_stands_for_it)
    return app


def _stands_for_it() -> None:
    """What the group lists; `resolve_command` puts the real command in its place."""


def print_version(asked: bool) -> None:
    """Callback of an eager `--version` option: the version of the installed package, and no more.

    Raises:
        typer.Exit: it was asked for.
    """
    if asked:
        print(metadata.version("companion"))
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=print_version)
]


def print_error(program: str, text: str, code: int) -> int:
    """Say in one line on standard error what went wrong; returns the exit code."""
    print(f"{program}: {text}", file=sys.stderr)
    return code
