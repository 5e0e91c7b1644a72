"""`companion-sitl`: the simulator by itself. Without a command it serves a vehicle; the commands do the rest.

Exit codes: 0 well, 1 a run failed, 2 something the user can mend.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import typer
from typer.exceptions import TyperException

from companion.config import ConfigError
from sitl.campaign.command import HELP as CAMPAIGN_HELP
from sitl.campaign.command import campaign_command
from sitl.external_server import serve_external
from sitl.scenario import load_scenario
from sitl.scenario_commands import SCENARIOS_HELP, SCHEMA_HELP, scenarios_command, schema_command
from sitl.server import serve
from sitl.view import HELP as VIEW_HELP
from sitl.view import view_command

USER_ERROR: Final = 2

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
cli.command("scenarios", help=SCENARIOS_HELP)(scenarios_command)
cli.command("schema", help=SCHEMA_HELP)(schema_command)
cli.command("campaign", help=CAMPAIGN_HELP, short_help="Fly scenarios under many seeds.")(campaign_command)
cli.command("view", help=VIEW_HELP)(view_command)


@cli.callback(invoke_without_command=True)
def companion_sitl(
    context: typer.Context,
    *,
    scenario: Annotated[str, typer.Option(help="A name in configs/scenarios, or a file.")] = "line",
    seed: Annotated[int, typer.Option(min=0, help="Repeats a flight.")] = 0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="UDP port; 0 takes a free one.")] = 0,
    folder: Annotated[
        Path | None,
        typer.Option(help="Where the sockets go; else a temporary folder.", metavar="DIR"),
    ] = None,
    external: Annotated[
        str | None,
        typer.Option(
            help="No vehicle of its own: pad and camera about that of an ArduPilot or PX4 SITL, at "
            "udp:HOST:PORT (called), udpin:HOST:PORT (listened at) or tcp:HOST:PORT.",
            metavar="CONNECTION",
        ),
    ] = None,
    serve_truth: Annotated[
        bool, typer.Option("--serve-truth", help="Send SIM_STATE / HIL_STATE_QUATERNION when asked for.")
    ] = False,
    child: Annotated[bool, typer.Option("--child", hidden=True)] = False,
) -> None:
    """Serve a simulated quadrotor with a camera over a pad that moves."""
    if context.invoked_subcommand is not None:
        return
    loaded = load_scenario(scenario)
    with contextlib.ExitStack() as stack:
        place = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="companion-sitl-")))
        if not os.access(place, os.W_OK) or not place.is_dir():
            raise ConfigError(f"--folder {place}: expected a folder that can be written to")
        if external is not None:
            asyncio.run(serve_external(loaded, seed, place, external, child=child))
        else:
            asyncio.run(serve(loaded, seed, place, port, serve_truth=serve_truth))


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: whatever the user got wrong ends in one line on standard error."""
    try:
        code = cli(args=words, standalone_mode=False)
    except TyperException as error:
        code = _fail(f"{error.format_message().rstrip('.')}; see companion-sitl --help")
    except ConfigError as error:
        code = _fail(str(error))
    except (KeyboardInterrupt, typer.Abort):
        code = 0
    sys.exit(code)


def _fail(text: str) -> int:
    print(f"companion-sitl: {text}", file=sys.stderr)
    return USER_ERROR


if __name__ == "__main__":
    main()
