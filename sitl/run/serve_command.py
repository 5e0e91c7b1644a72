"""`companion-sitl` without a command: serve a vehicle until it is interrupted."""

from dataclasses import dataclass
from pathlib import Path

from companion.base.autopilot_kind import AutopilotKind
from companion.base.signals import run_until_stopped, signals_held_back
from sitl.external.session import serve_external
from sitl.firmware.spec import FirmwareSpec
from sitl.mavlink.framing import read_key
from sitl.run.process_control import socket_folder, terminated_as_interrupted
from sitl.run.server import Service, serve, serve_child
from sitl.scenario.listing import signed
from sitl.scenario.scenario import load_scenario, read_home


@dataclass(frozen=True, slots=True)
class Served:
    """What the options ask for; `firmware` is its kind, its program and its parameters."""

    scenario: str
    seed: int
    autopilot: AutopilotKind | None
    firmware: tuple[AutopilotKind | None, Path | None, list[str] | None]
    folder: Path | None
    external: str | None
    signing_key: Path | None
    child: bool
    serve_truth: bool
    home: str | None = None
    settings: Path | None = None


def serve_vehicle(served: Served, bind: str, ports: tuple[int, int, int]) -> None:
    """Serve it; `ports` are those for companions, for ground stations (UDP) and for clients (TCP).

    Raises:
        ConfigError: the options, the scenario or a file are wrong.
        FirmwareError: the firmware ended or does not answer.
    """
    loaded = load_scenario(served.scenario)
    if served.autopilot is not None:
        loaded = loaded.model_copy(update={"autopilot": served.autopilot})
    if served.home is not None:
        home, heading_deg = read_home(served.home)
        loaded = loaded.model_copy(update={"home": home, "start_heading_deg": heading_deg})
    kind, program, parameters = served.firmware
    flown = FirmwareSpec.of(kind, program, parameters or ())
    if flown is not None:
        loaded = loaded.model_copy(update={"autopilot": flown.kind})
    key = None if served.signing_key is None else read_key(served.signing_key)
    seed, truth = served.seed, served.serve_truth
    with terminated_as_interrupted(), signals_held_back(), socket_folder(served.folder) as place:
        if served.external is not None:
            run_until_stopped(serve_external(loaded, seed, place, served.external, child=served.child))
        elif served.child:
            run_until_stopped(serve_child(loaded, seed, place, firmware=flown))
        else:
            service = Service(bind, *ports)
            if served.signing_key is not None:
                loaded = signed(loaded, served.signing_key)
            path = served.settings
            run_until_stopped(
                serve(
                    loaded, seed, place, service, key, serve_truth=truth, settings_path=path, firmware=flown
                )
            )
