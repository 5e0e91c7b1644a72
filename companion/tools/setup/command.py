"""`companion setup`: the checklist, gone through one by one; nothing is changed that was not agreed to."""

import os
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import DEFAULT_SETTINGS, must_be_readable

HELP: Final = """Switch on what the wiring needs, on a Raspberry Pi: one by one, each only when agreed to.

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
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = DEFAULT_SETTINGS,
) -> None:
    """Go through the checklist.

    Raises:
        ConfigError: something the user can correct.
        Exit: with 1 when a change failed.
    """
    if plan and yes:
        raise ConfigError("--plan: changes nothing; expected it without --yes")
    if not plan and os.geteuid() != 0:
        raise ConfigError("companion setup: changes files of the system; expected root (sudo), or --plan")
    must_be_readable(config)
    from companion.config import load_config  # noqa: PLC0415 - once all is there
    from companion.tools.setup.job import Answers, go_through  # noqa: PLC0415 - once all is there
    from companion.tools.setup.machine import Machine  # noqa: PLC0415 - once all is there

    answers = Answers.NONE if plan else Answers.SUGGESTED if yes else Answers.ASKED
    machine = Machine(user=os.environ.get("SUDO_USER") or None)
    raise typer.Exit(0 if go_through(machine, load_config(config), answers) else 1)
