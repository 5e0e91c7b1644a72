"""`companion replay`: its options and help. The estimators are imported once the log is there."""

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.files import must_be_readable, must_exist, unpacked

REPLAY_HELP: Final = """Run the estimators again over a recorded log, and hold them against what was recorded.

LOG is a flight's folder, its flight.mcap or exported zip, an ArduPilot .bin, or a PX4 .ulg.

\b
companion replay flights/circle
companion replay flights/circle --config mine.yaml -o compared
companion replay 00000042.BIN
"""
EXPECTED: Final = "expected a flight's folder, flight.mcap or zip, an ArduPilot .bin or a PX4 .ulg"


def replay_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The log.", show_default=False)],
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Leave replay.json and plots here; else in replay/NAME.", metavar="DIR"
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Other settings than the flight's own.", metavar="FILE"),
    ] = None,
) -> None:
    """Read, replay, compare and show.

    Raises:
        ConfigError: something the user can correct.
    """
    must_exist(log, EXPECTED)
    if config is not None:
        must_be_readable(config)
    from companion.flightlog.replay.job import replay_and_show  # noqa: PLC0415 - see above

    with unpacked(log) as flight:
        replay_and_show(flight, output, config)
