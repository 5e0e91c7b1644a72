"""`companion-sitl`: the simulator by itself. Without a command it serves a vehicle.

Exit codes: 0 success, 1 a run failed, 2 a user error.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Final

import typer
from typer.exceptions import TyperException

from companion.base.messages import Manner
from companion.config import ConfigError
from sitl.campaign.command import HELP as CAMPAIGN_HELP
from sitl.campaign.command import campaign_command
from sitl.external.server import serve_external
from sitl.firmware.options import FirmwareOption, FirmwareParamOption, FirmwarePathOption
from sitl.firmware.process import FirmwareError
from sitl.firmware.spec import FirmwareSpec
from sitl.mavlink.signing import read_key
from sitl.run.hold_command import HELP as HOLD_HELP
from sitl.run.hold_command import hold_command
from sitl.run.port_options import GroundPortOption, PortOption, TcpPortOption
from sitl.run.process_control import socket_folder, terminated_as_interrupted
from sitl.run.server import COMPANION_PORT, GROUND_PORT, LOOPBACK, TCP_PORT, Service, serve, serve_child
from sitl.run.view import HELP as VIEW_HELP
from sitl.run.view import view_command
from sitl.scenario.commands import SCENARIOS_HELP, SCHEMA_HELP, scenarios_command, schema_command
from sitl.scenario.scenario import load_scenario

FIRMWARE_FAILED: Final = 1
USER_ERROR: Final = 2
WITH_CHILD: Final = (
    "scenario", "seed", "autopilot", "folder", "child", "firmware", "firmware_path", "firmware_param",
)  # fmt: skip
WITH_FIRMWARE: Final = (
    "scenario", "seed", "bind", "port", "gcs_port", "tcp_port", "folder",
    "firmware", "firmware_path", "firmware_param",
)  # fmt: skip
WITH_EXTERNAL: Final = ("scenario", "seed", "folder", "child", "external")

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
cli.command("scenarios", help=SCENARIOS_HELP)(scenarios_command)
cli.command("schema", help=SCHEMA_HELP)(schema_command)
cli.command("campaign", help=CAMPAIGN_HELP, short_help="Fly scenarios under many seeds.")(campaign_command)
cli.command("view", help=VIEW_HELP)(view_command)
cli.command("hold", help=HOLD_HELP, short_help="Serve a vehicle that is carried by hand.")(hold_command)


@cli.callback(invoke_without_command=True)
def companion_sitl(
    context: typer.Context,
    *,
    scenario: Annotated[str, typer.Option(help="A name in configs/scenarios, or a file.")] = "line",
    seed: Annotated[int, typer.Option(min=0, help="Repeats a flight.")] = 0,
    autopilot: Annotated[
        Manner | None, typer.Option(help="Autopilot profile, instead of the scenario's.")
    ] = None,
    bind: Annotated[
        str, typer.Option(help="Address to serve at; 0.0.0.0 opens it to the network.", metavar="ADDRESS")
    ] = LOOPBACK,
    port: PortOption = COMPANION_PORT,
    gcs_port: GroundPortOption = GROUND_PORT,
    tcp_port: TcpPortOption = TCP_PORT,
    signing_key: Annotated[
        Path | None,
        typer.Option(help="Accept signed frames only: a file of 32 bytes or a passphrase.", metavar="FILE"),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="Where the sockets go; else a temporary folder.", metavar="DIR"),
    ] = None,
    external: Annotated[
        str | None,
        typer.Option(
            help="No bundled vehicle: pad and camera around that of an ArduPilot or PX4 SITL, at "
            "udp:HOST:PORT (called), udpin:HOST:PORT (listened at) or tcp:HOST:PORT.",
            metavar="CONNECTION",
        ),
    ] = None,
    serve_truth: Annotated[
        bool, typer.Option("--serve-truth", help="Send SIM_STATE / HIL_STATE_QUATERNION on request.")
    ] = False,
    firmware: FirmwareOption = None,
    firmware_path: FirmwarePathOption = None,
    firmware_param: FirmwareParamOption = None,
    child: Annotated[bool, typer.Option("--child", hidden=True)] = False,
) -> None:
    """Serve a simulated quadrotor with a camera over a moving pad."""
    if context.invoked_subcommand is not None:
        other = context.invoked_subcommand
        refuse(context, (), f"applies to a served vehicle; expected it without '{other}'")
        return
    if external is not None:
        refuse(
            context, WITH_EXTERNAL, "has no effect with an external vehicle; expected it without --external"
        )
    elif child:
        refuse(context, WITH_CHILD, "expected it without --child")
    elif firmware is not None:
        refuse(context, WITH_FIRMWARE, "applies to the bundled autopilot; expected it without --firmware")
    loaded = load_scenario(scenario)
    if autopilot is not None:
        loaded = loaded.model_copy(update={"autopilot": autopilot})
    flown = FirmwareSpec.of(firmware, firmware_path, firmware_param or ())
    if flown is not None:
        loaded = loaded.model_copy(update={"autopilot": flown.kind})
    key = None if signing_key is None else read_key(signing_key)
    with terminated_as_interrupted(), socket_folder(folder) as place:
        if external is not None:
            asyncio.run(serve_external(loaded, seed, place, external, child=child))
        elif child:
            asyncio.run(serve_child(loaded, seed, place, firmware=flown))
        else:
            service = Service(bind, port, gcs_port, tcp_port)
            asyncio.run(serve(loaded, seed, place, service, key, serve_truth=serve_truth, firmware=flown))


def refuse(context: typer.Context, allowed: Collection[str], why: str) -> None:
    """Refuse options on the command line that would have no effect, all but `allowed`.

    Raises:
        ConfigError: there is such an option.
    """
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE" and parameter.name not in allowed:
            raise ConfigError(f"{parameter.opts[0]}: {why}")


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: a user error ends in one line on standard error."""
    try:
        code = cli(args=words, standalone_mode=False)
    except TyperException as error:
        # a list of choices takes several lines
        said = " ".join(error.format_message().split()).rstrip(".")
        code = _fail(f"{said}; see companion-sitl --help")
    except ConfigError as error:
        code = _fail(str(error))
    except FirmwareError as error:
        code = _fail(str(error), FIRMWARE_FAILED)
    except (KeyboardInterrupt, typer.Abort):
        code = 0
    sys.exit(code)


def _fail(text: str, code: int = USER_ERROR) -> int:
    print(f"companion-sitl: {text}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
