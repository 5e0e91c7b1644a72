"""The tools' commands: their options and their help.

What does the work, and takes long to import, is imported once the files are seen to be there. Whatever is
wrong with them is a ConfigError; exit codes are in each command's help.
"""
# ruff: noqa: PLC0415 - see above

import os
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer

from companion.base.command_line import ServeOption
from companion.base.errors import ConfigError
from companion.base.files import (
    DEFAULT_SETTINGS,
    find_file,
    must_be_readable,
    must_be_writable,
    must_exist,
    unpacked,
)
from companion.base.printing.paper import PaperName

ConfigOption = Annotated[Path, typer.Option("--config", help="The app's settings.", metavar="FILE")]

# ---------------------------------------------------------------- companion check

CHECK_HELP: Final = """\
Check, before a flight, all that can be checked of a vehicle that stands there disarmed.

Settings, calibrations, camera, IMU, GPS, ultrasonic, link, the autopilot's parameters, clock, disk and
service: a line each, with what to do about it. Nothing is written to the autopilot. Exit code 0: nothing
fails, 1: something does, 2: it could not be checked.

With --pad, before a first flight, that right is right, forward is forward and down is down: take the
propellers off, keep the vehicle disarmed and hold it over the pad. Instructions say what to do (hold, raise,
move right and forward, turn, tilt), each move is recognised by itself, and camera, IMU, ultrasonic and
compass are held against it and against one another. What is wrong is named with the setting that mends it.

\b
Examples:
  companion check --config mine.yaml
  companion check --config mine.yaml --json -
  companion check --config mine.yaml --write-params changes.params
  companion check --pad --config mine.yaml
  companion check --pad --config mine.yaml --no-link --json check.json
  companion check --pad --config mine.yaml --serve 8080
"""


def check_command(
    *,
    pad: Annotated[bool, typer.Option("--pad", help="Held by hand over the pad.")] = False,
    config: ConfigOption = DEFAULT_SETTINGS,
    no_link: Annotated[
        bool, typer.Option("--no-link", help="Without an autopilot, which else has to be there and disarmed.")
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="Write the result here; '-': to standard output.", metavar="FILE"),
    ] = None,
    params_file: Annotated[
        Path | None,
        typer.Option(
            "--write-params",
            help="Write the autopilot's parameters that differ here, for QGroundControl and Mission Planner.",
            metavar="FILE",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", help="Where flights are kept; else the service's folder.", metavar="DIR"),
    ] = None,
    serve: ServeOption = None,  # with --pad
) -> None:
    must_be_readable(config)
    if json_file is not None and str(json_file) != "-":
        must_be_writable("--json", json_file)
    if params_file is not None:
        must_be_writable("--write-params", params_file)
    if params_file is not None and (pad or no_link):
        other = "--pad" if pad else "--no-link"
        raise ConfigError(f"--write-params: reads the autopilot's parameters; expected it without {other}")
    if serve is not None and not pad:
        raise ConfigError("--serve: belongs to --pad; expected both, or neither")
    from companion.tools.pad_check.job import check_over_pad, check_vehicle

    if pad:
        check_over_pad(config, json_file, linked=not no_link, port=serve)
    else:
        check_vehicle(config, json_file, record, linked=not no_link, params_file=params_file)


# ---------------------------------------------------------------- companion detect

DETECT_HELP: Final = """Find the pad in your own photos and videos, by the vision that flies.

SOURCE is a photo, a video or a folder of them, taken with the calibrated camera at the calibrated size. One
line for each picture: the markers that the pose is made of, the distance with its stated error, and the time
that it took. --out draws markers, pad and axes on the pictures.

\b
companion detect photo.jpg --pad indoor_400 --camera camera.yaml --out seen
companion detect frames --camera camera.yaml
companion detect --config companion.yaml flight.mp4 --out seen

Exit codes: 0 the pad was seen, 1 in no picture, 2 something to correct.
"""


def detect_command(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SOURCE", help="Photos, videos or folders of them.", show_default=False),
    ],
    *,
    pad: Annotated[
        str | None,
        typer.Option("--pad", help="A name in configs/pads, or a file; else the settings'.", metavar="NAME"),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera", help="The calibration: a name in configs/cameras, or a file; else the settings'."
        ),
    ] = None,
    config: ConfigOption = DEFAULT_SETTINGS,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the overlays to this folder.", metavar="DIR")
    ] = None,
    sends: Annotated[
        bool,
        typer.Option(
            "--send", help="Send each as LANDING_TARGET to the autopilot at the settings' link.connection."
        ),
    ] = False,
) -> None:
    for source in sources:
        must_exist(source, "expected a photo, a video or a folder of them")
    for folder, name in (("pads", pad), ("cameras", camera)):
        if name is not None:
            find_file(folder, name)
    must_be_readable(config)
    if out is not None and out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: a file; expected a folder")
    from companion.tools.detect.run import detect_all, find_with

    finder = find_with(config, pad, camera)
    if not sends:
        raise typer.Exit(0 if detect_all(sources, finder, out) else 1)
    from companion.config import load_config
    from companion.tools.detect.send import TargetLink

    with TargetLink(load_config(config)).opened() as link:
        raise typer.Exit(0 if detect_all(sources, finder, out, link.send) else 1)


# ---------------------------------------------------------------- companion fuzzy

FUZZY_HELP: Final = """\
Show the fuzzy speed controller behind eq. 37: its rules, and what its flight table is worth.

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
    if plot is not None and (plot.suffix.lower() != ".png" or not plot.parent.is_dir()):
        raise ConfigError(f"--plot {plot}: expected a .png file in a folder that exists")
    find_file("fuzzy", rules)
    from companion.tools.fuzzy import run_fuzzy

    raise typer.Exit(0 if run_fuzzy(rules, plot, points, seed, rewrite=rewrite) else 1)


# ---------------------------------------------------------------- companion identify

IDENTIFY_HELP: Final = """Hover thrust and the autopilot's response, from a recorded flight.

LOG is a flight's folder, its flight.mcap or its exported zip. Prints what it finds with its standard
deviations, and the lines for configs/vehicles and the settings; writes nothing. A number that predicts a
flight worse than the assumed one is withheld.

\b
companion identify flights/circle
companion identify flights/circle --check flights/line

Exit codes: 0 found, 1 a number was withheld, 2 something to correct, or the flight shows nothing.
"""


def identify_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The flight.", show_default=False)],
    *,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Another flight, to hold the numbers against.", metavar="LOG"),
    ] = None,
) -> None:
    for path in (log,) if check is None else (log, check):
        must_exist(path, "expected a flight's folder, its flight.mcap or its exported zip")
    from companion.tools.identify.run import identify_and_show

    with unpacked(log) as flight, nullcontext() if check is None else unpacked(check) as other:
        found = identify_and_show(flight, other)
    raise typer.Exit(0 if found else 1)


# ---------------------------------------------------------------- companion pad

PAD_HELP: Final = """Check a pad, print it at its true size, or predict how well a camera sees it.

PAD is a name in configs/pads or a .yaml file; else the shipped moving_1300; or 'single', one marker alone,
whose .yaml file -o writes beside the print. What cannot be printed, or not be read from the air, is refused
in one line that names the markers.

\b
companion pad mine.yaml
companion pad mine.yaml -o mine.pdf
companion pad mine.yaml --paper a3 -o mine.pdf
companion pad mine.yaml --coverage --camera hd_1280x720 -o coverage.png
companion pad single --family apriltag_36h11 --id 0 --size 0.4 -o tag.pdf
"""


def pad_command(
    pad: Annotated[str, typer.Argument(metavar="PAD", show_default=False)] = "moving_1300",
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Print here: .pdf, .svg or .png; single: or .yaml alone.", metavar="FILE"
        ),
    ] = None,
    paper: Annotated[
        Literal[PaperName, "large"] | None,
        typer.Option("--paper", help="Instead of the pad's own sheet: tiles, or one large sheet."),
    ] = None,
    coverage: Annotated[
        bool, typer.Option("--coverage", help="Predict the recall by height; -o: a .png of it.")
    ] = False,
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera", help="With --coverage: a name in configs/cameras, or a file.", metavar="CAM"
        ),
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option("--offset", help="With --coverage: off the middle (m), a standard deviation.", min=0.0),
    ] = None,
    tilt: Annotated[
        float | None, typer.Option("--tilt", help="The same of the tilt (degrees).", min=0.0, max=45.0)
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", help="Across the pad (m/s), which blurs.", min=0.0)
    ] = None,
    family: Annotated[
        str | None, typer.Option("--family", help="single: 4x4_50, ... Default: apriltag_36h11.")
    ] = None,
    number: Annotated[int | None, typer.Option("--id", help="single: its id. Default: 0.", min=0)] = None,
    size: Annotated[
        float | None, typer.Option("--size", help="single: side of its black square (m). Default: 0.4.")
    ] = None,
) -> None:
    given = _given(offset_m=offset, tilt_deg=tilt, speed_m_s=speed)
    if not coverage and (given or camera is not None):
        raise ConfigError("--camera, --offset, --tilt and --speed: expected with --coverage")
    alone = _given(dictionary=family, id=number, side_m=size)
    single = alone if pad == "single" else None
    if single is None:
        if alone:
            raise ConfigError("--family, --id and --size: expected with single")
        find_file("pads", pad)
    if camera is not None:
        find_file("cameras", camera)
    from companion.tools.pads.run import run_pad

    run_pad(pad, output, paper, coverage=coverage, camera=camera, spread=given, single=single)


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


# ---------------------------------------------------------------- companion setup

SETUP_HELP: Final = """\
Switch on what the wiring needs, on a Raspberry Pi: one by one, each only when agreed to.

UARTs for the model at hand, the serial login console off, I2C with its speed and i2c-dev, SPI, groups, system
packages, time synchronisation. What the settings need is suggested. It says what it changes, and can be run
again: what is done is found done. Exit code 0: done or left out, 1: a change failed, 2: it could not begin.

\b
Examples:
  companion setup --plan
  sudo companion setup
  sudo companion setup --yes
"""


def setup_command(
    *,
    plan: Annotated[
        bool, typer.Option("--plan", help="Show what would be changed, and change nothing.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Agree to all that the settings need.")] = False,
    config: ConfigOption = DEFAULT_SETTINGS,
) -> None:
    if plan and yes:
        raise ConfigError("--plan: changes nothing; expected it without --yes")
    if not plan and os.geteuid() != 0:
        raise ConfigError("companion setup: changes files of the system; expected root (sudo), or --plan")
    must_be_readable(config)
    from companion.config import load_config
    from companion.tools.setup.job import Answers, go_through
    from companion.tools.setup.machine import Machine

    answers = Answers.NONE if plan else Answers.SUGGESTED if yes else Answers.ASKED
    machine = Machine(user=os.environ.get("SUDO_USER") or None)
    raise typer.Exit(0 if go_through(machine, load_config(config), answers) else 1)
