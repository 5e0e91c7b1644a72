"""Who may look and who may give orders: the address, the token, and where a browser says it comes from.

A page of somebody else's, open in the same browser, can send requests to addresses that only that browser
reaches. Its WebSocket carries its own Origin, which is refused (cross-site WebSocket hijacking). A name of
its own that suddenly means our address (DNS rebinding) makes Origin and Host agree; so Host must be an IP
address or a name that is ours. Source: RFC 6455, section 10.2, and OWASP's WebSocket cheat sheet.
"""

import hmac
import ipaddress
import os
import socket
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from companion.base.errors import ConfigError
from companion.config import ServeConfig
from companion.config.service import LOCALHOST, host_and_port, is_ip, is_loopback

TOKEN_VARIABLE: Final = "COMPANION_SERVE_TOKEN"
SHORTEST_TOKEN: Final = 16
LONGEST_TOKEN: Final = 256
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


@dataclass(frozen=True, slots=True)
class Access:
    """Where to listen, and what is asked for; the token is in no `repr`."""

    host: str
    port: int
    token: str | None = field(repr=False)


def read_access(config: ServeConfig, variables: Mapping[str, str] = os.environ) -> Access | None:
    """The page's access by the settings; None: there is no page.

    Raises:
        ConfigError: a token is missing, too short or open to others.
    """
    if config.address is None:
        return None
    host, port = host_and_port(config.address)
    token = _read_token(config.token_file, variables.get(TOKEN_VARIABLE))
    reason = None if is_loopback(host) else f"serve.address {config.address}: others reach it"
    reason = "serve.allow_commands" if config.allow_commands else reason
    if reason is not None and token is None:
        raise ConfigError(
            f"{reason}; expected a token: serve.token_file, or {TOKEN_VARIABLE} in the environment"
        )
    return Access(host, port, token)


def _read_token(path: Path | None, variable: str | None) -> str | None:
    where, text = TOKEN_VARIABLE, variable
    if path is not None:
        where = f"serve.token_file {path}"
        try:
            text, mode = path.read_text(encoding="ascii"), path.stat().st_mode
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "not ASCII text"
            raise ConfigError(f"{where}: {reason}; expected a file with the token") from None
        if mode & _OTHERS:
            raise ConfigError(f"{where}: mode {stat.S_IMODE(mode):04o}, others may read it; expected 0600")
    if text is None:
        return None
    token = text.strip()
    if not SHORTEST_TOKEN <= len(token) <= LONGEST_TOKEN or not token.isascii():
        raise ConfigError(f"{where}: expected {SHORTEST_TOKEN} to {LONGEST_TOKEN} characters of ASCII")
    return token


def same_token(given: object, token: str) -> bool:
    """Whether the token is right; takes as long for every wrong one of a length."""
    return isinstance(given, str) and hmac.compare_digest(given.encode(), token.encode())


def own_names(host_names: tuple[str, ...]) -> frozenset[str]:
    """The names by which a browser may call us, beside IP addresses."""
    here = socket.gethostname().lower()
    return frozenset({LOCALHOST, here, f"{here}.local", *(name.lower() for name in host_names)})


def url_of(host: str, port: int) -> str:
    """What is typed into a browser; a page on every address is called by our name."""
    if is_ip(host) and ipaddress.ip_address(host).is_unspecified:
        host = socket.gethostname()
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


def host_is_ours(host: str | None, names: frozenset[str]) -> bool:
    """Whether the Host header names us: by an IP address, which no name server gives, or by our name."""
    parts = _split(f"//{host}") if host else None
    return parts is not None and (is_ip(parts[0]) or parts[0].rstrip(".") in names)


def same_origin(origin: str | None, host: str | None) -> bool:
    """Whether the page that opens a WebSocket came from the address that it opens it to; none came: no."""
    if not origin or not host or not origin.startswith(("http://", "https://")):
        return False
    theirs = _split(origin)
    return theirs is not None and theirs == _split(f"{urlsplit(origin).scheme}://{host}")


_PORTS: Final = {"http": 80, "https": 443}


def _split(url: str) -> tuple[str, int | None] | None:
    """Host in lower case, and port; None for what is no address."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        return None
    if parts.username is not None or parts.path or parts.query or parts.fragment or not parts.hostname:
        return None
    return parts.hostname, port or _PORTS.get(parts.scheme)
