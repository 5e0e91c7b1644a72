"""`companion-sitl`: the simulator by itself. Without a command it serves a vehicle.

Exit codes: 0 success, 1 a run failed, 2 a user error.
"""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.autopilot_kind import AutopilotKind
from companion.base.command_line import INTERRUPTED, Ending, VersionOption, new_app, run_program
from companion.base.errors import ConfigError
from companion.base.files import find_file
from companion.base.signals import run_until_stopped, signals_held_back
from sitl.commands import (
    CAMPAIGN_HELP,
    HAND_HELD_HELP,
    SCENARIOS_HELP,
    SCHEMA_HELP,
    VIEW_HELP,
    FirmwareOption,
    FirmwareParamOption,
    FirmwarePathOption,
    FolderOption,
    GroundPortOption,
    PortOption,
    TcpPortOption,
    campaign_command,
    hand_held_command,
    scenarios_command,
    schema_command,
    view_command,
)
from sitl.firmware import FirmwareError
from sitl.run import COMPANION_PORT, GROUND_PORT, LOOPBACK, TCP_PORT

PROGRAM: Final = "companion-sitl"
FIRMWARE_FAILED: Final = 1
WITH_CHILD: Final = (
    "scenario", "seed", "autopilot", "folder", "child", "firmware", "firmware_path", "firmware_param",
)  # fmt: skip
WITH_FIRMWARE: Final = (
    "scenario", "seed", "home", "bind", "port", "gcs_port", "tcp_port", "folder", "settings",
    "firmware", "firmware_path", "firmware_param",
)  # fmt: skip
WITH_EXTERNAL: Final = ("scenario", "seed", "folder", "child", "external")

cli = new_app()
cli.command("scenarios", help=SCENARIOS_HELP, short_help="List scenarios, or print one.")(scenarios_command)
cli.command("schema", help=SCHEMA_HELP, short_help="Print the JSON schema of scenario files.")(schema_command)
cli.command("campaign", help=CAMPAIGN_HELP, short_help="Fly scenarios under many seeds.")(campaign_command)
cli.command("view", help=VIEW_HELP)(view_command)
cli.command("hand-held", help=HAND_HELD_HELP, short_help="Serve a vehicle carried by hand.")(
    hand_held_command
)


@cli.callback(invoke_without_command=True)
def companion_sitl(
    context: typer.Context,
    *,
    scenario: Annotated[str, typer.Option(help="A name in configs/scenarios, or a file.")] = "line",
    seed: Annotated[int, typer.Option(min=0, help="Repeats a flight.")] = 0,
    autopilot: Annotated[
        AutopilotKind | None, typer.Option(help="Autopilot profile, instead of the scenario's.")
    ] = None,
    home: Annotated[
        str | None,
        typer.Option(
            help="Where it stands; else where its autopilot's own simulator starts.",
            metavar="LAT,LON,ALT,HEADING",
        ),
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
    folder: FolderOption = None,
    settings: Annotated[
        Path | None, typer.Option(help="Write the app's settings for it here, for --config.", metavar="FILE")
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
    version: VersionOption = False,
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
    find_file("scenarios", scenario)
    # what simulates is imported once the scenario is there
    from sitl.external.session import serve_external  # noqa: PLC0415
    from sitl.firmware.spec import FirmwareSpec  # noqa: PLC0415
    from sitl.mavlink.framing import read_key  # noqa: PLC0415
    from sitl.run.process_control import socket_folder, terminated_as_interrupted  # noqa: PLC0415
    from sitl.run.server import Service, serve, serve_child  # noqa: PLC0415
    from sitl.scenario.listing import signed  # noqa: PLC0415
    from sitl.scenario.scenario import load_scenario, read_home  # noqa: PLC0415

    spec = FirmwareSpec.of(firmware, firmware_path, firmware_param or ())
    loaded = load_scenario(scenario)
    if autopilot is not None:
        loaded = loaded.model_copy(update={"autopilot": autopilot})
    if home is not None:
        place, heading_deg = read_home(home)
        loaded = loaded.model_copy(update={"home": place, "start_heading_deg": heading_deg})
    if spec is not None:
        loaded = loaded.model_copy(update={"autopilot": spec.kind})
    key = None if signing_key is None else read_key(signing_key)
    with terminated_as_interrupted(), signals_held_back(), socket_folder(folder) as there:
        if external is not None:
            serving = serve_external(loaded, seed, there, external, child=child)
        elif child:
            serving = serve_child(loaded, seed, there, firmware=spec)
        else:
            if signing_key is not None:
                loaded = signed(loaded, signing_key)
            service = Service(bind, port, gcs_port, tcp_port)
            serving = serve(
                loaded,
                seed,
                there,
                service,
                key,
                serve_truth=serve_truth,
                settings_path=settings,
                firmware=spec,
            )
        run_until_stopped(serving)


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
    """Entry point: a user error ends in one line on standard error; what Ctrl-C ends has said so."""
    run_program(
        cli,
        PROGRAM,
        words,
        endings={FirmwareError: Ending(FIRMWARE_FAILED)},
        interrupted=Ending(INTERRUPTED, None),
    )


if __name__ == "__main__":
    main()
