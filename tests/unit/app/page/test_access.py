"""Who may look: addresses, tokens, hosts and origins."""

import socket
from pathlib import Path

import pytest

from companion.app.page.access import (
    TOKEN_VARIABLE,
    host_is_ours,
    own_names,
    read_access,
    same_origin,
    same_token,
    url_of,
)
from companion.base.errors import ConfigError
from companion.config import ServeConfig, validate
from tests.unit.app.page.starting import TOKEN

NAMES = own_names(("rover.lan",))


def config(**values: object) -> ServeConfig:
    return validate(ServeConfig, values, "serve")


@pytest.mark.parametrize(
    "address", ["127.0.0.1:8080", "[::1]:8080", "0.0.0.0:1", "localhost:65535", "[::]:0"]
)
def test_an_address_is_an_ip_address_and_a_port(address: str) -> None:
    assert config(address=address).address == address


@pytest.mark.parametrize(
    "address",
    ["8080", "127.0.0.1", "::1:8080", "rover:8080", "127.0.0.1:65536", "127.0.0.1:", ":80", "[::1]"],
)
def test_anything_else_is_refused_in_one_line(address: str) -> None:
    with pytest.raises(ConfigError, match=r"^serve: address: expected ADDRESS:PORT[^\n]*$"):
        config(address=address)


@pytest.mark.parametrize(
    ("host", "shown"),
    [
        ("127.0.0.1", "127.0.0.1"),
        ("::1", "[::1]"),
        ("localhost", "localhost"),
        ("192.168.4.1", "192.168.4.1"),
    ],
)
def test_the_address_that_is_told_can_be_typed_into_a_browser(host: str, shown: str) -> None:
    assert url_of(host, 8080) == f"http://{shown}:8080/"
    for every in ("0.0.0.0", "::"):
        url = url_of(every, 8080)
        assert url == f"http://{socket.gethostname()}:8080/"
        assert host_is_ours(url.removeprefix("http://").rstrip("/"), NAMES)


def test_without_an_address_there_is_no_page() -> None:
    assert read_access(config(), {TOKEN_VARIABLE: TOKEN}) is None


def test_only_loopback_without_commands_needs_no_token() -> None:
    for address in ("127.0.0.1:80", "[::1]:80", "localhost:80"):
        access = read_access(config(address=address), {})
        assert access is not None
        assert access.token is None
    for values in ({"address": "0.0.0.0:80"}, {"address": "192.168.4.1:80"}, {"address": "[::]:80"}):
        with pytest.raises(ConfigError, match=r"others reach it; expected a token: serve\.token_file"):
            read_access(config(**values), {})
    with pytest.raises(ConfigError, match=r"serve\.allow_commands; expected a token"):
        read_access(config(address="127.0.0.1:80", allow_commands=True), {})


def test_a_token_comes_from_the_environment_or_a_file_of_its_owner_s(tmp_path: Path) -> None:
    access = read_access(config(address="0.0.0.0:80"), {TOKEN_VARIABLE: f" {TOKEN}\n"})
    assert access is not None
    assert access.token == TOKEN
    assert TOKEN not in repr(access)
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}, in the file\n")
    path.chmod(0o600)
    access = read_access(config(address="0.0.0.0:80", token_file=path), {TOKEN_VARIABLE: TOKEN})
    assert access is not None
    assert access.token == f"{TOKEN}, in the file"
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="mode 0640, others may read it; expected 0600"):
        read_access(config(address="0.0.0.0:80", token_file=path), {})


@pytest.mark.parametrize("content", [b"", b"short", b"x" * 257, "sécret de seize lettres".encode()])
def test_a_token_that_is_none_is_refused_and_not_repeated(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(ConfigError) as error:
        read_access(config(address="0.0.0.0:80", token_file=path), {})
    assert str(path) in str(error.value)
    assert "cret" not in str(error.value)
    with pytest.raises(ConfigError, match="No such file"):
        read_access(config(address="0.0.0.0:80", token_file=tmp_path / "nope"), {})


def test_tokens_are_compared_whatever_is_given() -> None:
    assert same_token(TOKEN, TOKEN)
    for wrong in ("", TOKEN[:-1], TOKEN + " ", None, 7, ["x"], "é" * 20):
        assert not same_token(wrong, TOKEN)


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8080", "192.168.4.1", "[::1]:80", "localhost:1", "Rover.LAN:80", "rover.lan.:80"]
)
def test_an_ip_address_and_our_own_names_are_ours(host: str) -> None:
    assert host_is_ours(host, NAMES)


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "evil.example",
        "127.0.0.1.evil.example",
        "evil.example:8080",
        "x@127.0.0.1",
        "127.0.0.1/x",
        "[::1",
    ],
)
def test_a_foreign_name_is_not_whatever_it_resolves_to(host: str | None) -> None:
    assert not host_is_ours(host, NAMES)


def test_a_websocket_is_opened_by_the_page_that_we_served() -> None:
    assert same_origin("http://127.0.0.1:8080", "127.0.0.1:8080")
    assert same_origin("http://rover.lan", "rover.lan")
    assert same_origin("https://rover.lan", "rover.lan:443")
    for origin, host in (
        (None, "127.0.0.1:8080"),
        ("null", "127.0.0.1:8080"),
        ("http://evil.example", "127.0.0.1:8080"),
        ("http://127.0.0.1:8081", "127.0.0.1:8080"),
        ("http://127.0.0.1:8080@evil.example", "127.0.0.1:8080"),
        ("file://127.0.0.1:8080", "127.0.0.1:8080"),
        ("http://127.0.0.1:8080", None),
    ):
        assert not same_origin(origin, host)
