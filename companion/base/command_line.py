"""What all command lines here have in common: they start fast, and they all end alike.

A command's module is imported when that command runs, not before: `companion --help` on a Raspberry Pi must
not wait for OpenCV, OSQP and MAVSDK. Typer needs the options of a command only when it parses them, so the
group knows each command by its name and one line of help. A command's own module holds its options, sees
whether the files are there, and only then imports what does the work.

Whatever the user can correct ends in one line on standard error that points to the help of the very command,
with exit code 2. A reader that goes away (`| head`) ends it quietly, as SIGPIPE would; output that cannot be
written is said.
"""

from __future__ import annotations

import _thread
import errno
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from itertools import zip_longest
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn, TextIO

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from companion import __version__
from companion.base.errors import ConfigError

if TYPE_CHECKING:
    from rich.console import Console

USER_ERROR: Final = 2
INTERRUPTED: Final = 130
AGAIN_S: Final = 0.01
# of what we print, which has no file name: a full disk or quota, the device's end, a closed output
NOT_WRITTEN: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
OUR_PACKAGES: Final = {"", "companion", "sitl", "calibration"}
PIPE_CLOSED: Final = 141  # as a shell reports a program that SIGPIPE has ended


@dataclass(frozen=True, slots=True)
class Command:
    """A command: `function` as "module:NAME_command", with its help as `NAME_HELP` there, and one line."""

    function: str
    summary: str
    hidden: bool = False

    def load(self, name: str) -> Any:
        """Import the module and build the command that Typer runs."""
        module_name, _, function_name = self.function.partition(":")
        module = import_module(module_name)
        told = getattr(module, f"{function_name.removesuffix('_command').upper()}_HELP")
        app = new_app(add_completion=False)
        app.command(name, help=told)(getattr(module, function_name))
        return typer.main.get_command(app)


def new_app(**options: Any) -> typer.Typer:
    """A Typer application with what all command lines here have in common: errors are one line, by us."""
    settings = {"help_option_names": ["-h", "--help"], **options.pop("context_settings", {})}
    return typer.Typer(
        pretty_exceptions_enable=False, rich_markup_mode=None, context_settings=settings, **options
    )


def lazy_app(
    commands: Mapping[str, Command], *, alone: Mapping[str, str] | None = None, **options: Any
) -> typer.Typer:
    """A Typer application whose `commands` are imported only when they run; others may be added to it.

    `alone` gives the values of options that may stand without one.
    """
    values = dict(alone or {})

    class LazyGroup(TyperGroup):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            return super().parse_args(ctx, _with_values(args, values, commands))

        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            name, stub, rest = super().resolve_command(ctx, args)
            lazy = None if name is None else commands.get(name)
            return name, stub if lazy is None else lazy.load(str(name)), rest

    app = new_app(cls=LazyGroup, **options)
    for name, command in commands.items():
        app.command(name, short_help=command.summary, hidden=command.hidden)(_stands_for_it)
    return app


def _with_values(args: list[str], values: Mapping[str, str], commands: Mapping[str, Command]) -> list[str]:
    """The arguments with a value after each option that stands alone, which Typer does not know."""
    filled = list[str]()
    for word, following in zip_longest(args, args[1:]):
        filled.append(word)
        if word in values and (following is None or following.startswith("-") or following in commands):
            filled.append(values[word])
    return filled


def _stands_for_it() -> None:
    """What the group lists; `resolve_command` puts the real command in its place."""


def print_version(asked: bool) -> None:
    """Callback of an eager `--version` option: the version of this program, and no more.

    Raises:
        typer.Exit: it was asked for.
    """
    if asked:
        print(__version__)
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=print_version)
]
_SERVED: Final = "Show the live picture to browsers at 127.0.0.1:PORT (0: a free one)."
ServeOption = Annotated[int | None, typer.Option("--serve", min=0, max=65535, help=_SERVED, metavar="PORT")]


@dataclass(frozen=True, slots=True)
class Ending:
    """How errors of one kind end: the exit code, and what the line begins with; None: no line."""

    code: int
    lead: str | None = ""


def run_program(
    app: typer.Typer,
    program: str,
    words: Sequence[str] | None = None,
    *,
    endings: Mapping[type[Exception], Ending] | None = None,
    interrupted: Ending = Ending(INTERRUPTED, "interrupted"),
) -> NoReturn:
    """Run a program to its end; `endings` are those of its own kinds of errors.

    Raises:
        SystemExit: always, with the exit code.
    """
    own = dict(endings or {})
    before, sys.unraisablehook = sys.unraisablehook, _deliver_again
    try:
        code = _run(app, program, words, own, interrupted)
        sys.stdout.flush()
    except BrokenPipeError:
        code = PIPE_CLOSED
        _let_go_of(sys.stdout)
    except OSError as error:
        if error.filename is None and error.errno not in NOT_WRITTEN:
            raise
        where = error.filename or "the output cannot be written"
        code = print_error(program, f"{where}: {error.strerror or error}", USER_ERROR)
        _let_go_of(sys.stdout)
    finally:
        sys.unraisablehook = before
    sys.exit(code)


def _run(
    app: typer.Typer,
    program: str,
    words: Sequence[str] | None,
    endings: Mapping[type[Exception], Ending],
    interrupted: Ending,
) -> int:
    """The exit code; what went wrong has been said."""
    try:
        code = _typer_code(app, program, words)
        # typer's own answer to Ctrl-C
        return _end(program, interrupted, "") if code == INTERRUPTED else int(code)
    except (KeyboardInterrupt, typer.Abort):
        return _end(program, interrupted, "")
    except TyperException as error:
        # a list of choices takes several lines
        said = " ".join(error.format_message().split()).rstrip(".").replace("Value error, ", "")
        context = getattr(error, "ctx", None)
        asked = program if context is None else context.command_path
        return print_error(program, f"{said}; see {asked} --help", USER_ERROR)
    except (ConfigError, RecursionError, ModuleNotFoundError) as error:
        return print_error(program, _said_of(error), USER_ERROR)
    except tuple(endings) as error:
        ending = next(end for kind, end in endings.items() if isinstance(error, kind))
        return _end(program, ending, str(error))
    except Exception as error:
        if not _is_of_an_interrupt(error):
            raise
        return _end(program, interrupted, "")


def _is_of_an_interrupt(error: BaseException | None) -> bool:
    """Whether a library has made another error of Ctrl-C; pydantic, as it builds a model, has words only."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt) or KeyboardInterrupt.__name__ in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _deliver_again(lost: sys.UnraisableHookArgs) -> None:
    """Ctrl-C that falls into a destructor or a library's callback would be printed and forgotten."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        # not here, where it would be lost again
        threading.Timer(AGAIN_S, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(lost)


def _typer_code(app: typer.Typer, program: str, words: Sequence[str] | None) -> Any:
    """What the command returns.

    Raises:
        BrokenPipeError: nobody reads what it prints, even where Rich has made an exit with status 1 of that.
    """
    try:
        return typer.main.get_command(app)(args=words, prog_name=program, standalone_mode=False) or 0
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):
            raise error.__context__ from None
        raise


def _said_of(error: ConfigError | RecursionError | ModuleNotFoundError) -> str:
    """What a user can correct.

    Raises:
        ModuleNotFoundError: what is missing is a module of ours, which is a fault of ours.
    """
    if isinstance(error, RecursionError):
        return "a file that it read is nested too deeply"
    if isinstance(error, ConfigError):
        return str(error)
    missing = (error.name or "").partition(".")[0]
    if missing in OUR_PACKAGES:
        raise error
    return f"needs {missing}; expected it installed, see docs/reference/package.md"


def _end(program: str, ending: Ending, text: str) -> int:
    if ending.lead is None:
        return ending.code
    return print_error(program, f"{ending.lead}{text}", ending.code)


def _let_go_of(stream: TextIO) -> None:
    """Nothing more is written to a stream that takes nothing: at its end Python would fail once more."""
    with suppress(OSError, ValueError):
        target = os.open(os.devnull, os.O_WRONLY)
        os.dup2(target, stream.fileno())
        os.close(target)


def say(console: Console, *lines: str) -> None:
    """Print lines as they are: whole, whatever the terminal's width, with nothing in them coloured."""
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def print_error(program: str, text: str, code: int) -> int:
    """Say in one line on standard error what went wrong, whatever is quoted in it; returns the exit code."""
    print(f"{program}: {' '.join(text.splitlines())}", file=sys.stderr)
    return code
