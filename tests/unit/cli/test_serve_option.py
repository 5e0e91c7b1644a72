"""`--serve`, alone or with an address, over the address of the settings."""

from pathlib import Path

import pytest
import typer
from rich.console import Console

from companion.app.command import Output
from companion.base.errors import ConfigError
from companion.cli import SERVE_ADDRESS, cli
from companion.config import CompanionConfig, ServeConfig, validate


def parsed(*words: str) -> object:
    return typer.main.get_command(cli).make_context("companion", list(words)).params["serve"]


@pytest.mark.parametrize(
    ("words", "address"),
    [
        ((), None),
        (("--sitl",), None),
        (("--serve",), SERVE_ADDRESS),
        (("--serve", "--sitl"), SERVE_ADDRESS),
        (("--sitl", "--serve", "0.0.0.0:80"), "0.0.0.0:80"),
        (("--serve=[::1]:80", "--no-ui"), "[::1]:80"),
        (("--serve", "status"), SERVE_ADDRESS),  # a command, which then says that the option is a flight's
    ],
)
def test_alone_it_means_this_machine_s_own_browser(words: tuple[str, ...], address: str | None) -> None:
    assert parsed(*words) == address


def test_it_needs_real_time() -> None:
    with pytest.raises(ConfigError, match="--serve: shows a flight in real time; expected it without --fast"):
        typer.main.get_command(cli).main(["--sitl", "--fast", "--serve"], standalone_mode=False)


def test_it_goes_over_the_settings_and_leaves_the_rest_of_them() -> None:
    serve = {"address": "[::1]:90", "rate_hz": 5.0}
    config = CompanionConfig(serve=validate(ServeConfig, serve, "test"))
    output = Output(Console(), None, None, live=False, serve="127.0.0.1:81")
    assert output.shown(config).serve == ServeConfig(address="127.0.0.1:81", rate_hz=5.0)
    assert Output(Console(), None, None, live=False).shown(config) is config
    wrong = Output(Console(), Path("x"), None, live=False, serve="8080")
    with pytest.raises(ConfigError, match=r"^--serve: address: expected ADDRESS:PORT"):
        wrong.shown(config)
