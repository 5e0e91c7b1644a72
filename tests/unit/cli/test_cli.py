"""The command line's small decisions."""

import subprocess
import sys

import pytest

from companion.app.command import EXIT_CODES
from companion.base.messages import Outcome


def test_every_outcome_has_an_exit_code_of_its_own() -> None:
    assert EXIT_CODES.keys() == set(Outcome)
    assert len(set(EXIT_CODES.values())) == len(Outcome)
    assert EXIT_CODES[Outcome.LANDED] == 0


HEAVY = {
    "cv2",
    "numpy",
    "scipy",
    "osqp",
    "pymavlink",
    "mavsdk",
    "matplotlib",
    "skfuzzy",
    "filterpy",
}
MOST_MODULES = 400  # Typer, pydantic beneath it and the standard library need some 270


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["--help"], 0),
        (["--version"], 0),
        (["nope"], 2),
        (["--config", "nope.yaml"], 2),
        (["--sitl", "--scenario", "nope"], 2),
        (["--sitl", "--config", "nope.yaml"], 2),
    ],
)
def test_help_and_not_found_import_no_library_of_the_flight(words: list[str], status: int) -> None:
    script = (
        "import sys; from companion import cli\n"
        f"sys.argv = ['companion', *{words!r}]\n"
        "try: cli.main()\n"
        "except SystemExit as end: print(end.code, *sys.modules, sep='\\n')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True
    )
    modules = set(done.stdout.splitlines())
    assert str(status) in modules
    assert not modules & HEAVY
    assert len(modules) < MOST_MODULES
