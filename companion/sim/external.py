"""The user's own autopilot in a SITL flight: where it is, from the command line's options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from companion.config import CONNECTION_FORM, ConfigError


@dataclass(frozen=True, slots=True)
class External:
    """An ArduPilot or PX4 SITL at udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT.

    With `world` the simulated world has a connection of its own and the app goes to `app` directly; without,
    the world goes there and lets the app share it.
    """

    app: str
    world: str | None = None

    @classmethod
    def of(cls, options: Mapping[str, str | None], *, fast: bool) -> External | None:
        """What --autopilot, --connect and --connect-world say; None for the bundled autopilot.

        Raises:
            ConfigError: they do not go together.
        """
        autopilot, connect = options["--autopilot"], options["--connect"]
        if autopilot is None:
            for name in ("--connect", "--connect-world"):
                if options[name] is not None:
                    raise ConfigError(f"{name}: needs --autopilot external")
            return None
        if autopilot != "external":
            raise ConfigError(
                f"--autopilot {autopilot}: expected external; the bundled one's profile is the scenario's "
                "'autopilot: px4' or 'autopilot: ardupilot'"
            )
        if connect is None:
            raise ConfigError(
                "--autopilot external: expected --connect with where it is, as udpin:127.0.0.1:14540"
            )
        if fast:
            raise ConfigError("--fast: expected to be left out; an external autopilot flies in real time")
        for name in ("--connect", "--connect-world"):
            _check(name, options[name])
        return cls(connect, options["--connect-world"])


def _check(name: str, spec: str | None) -> None:
    form = None if spec is None else CONNECTION_FORM.fullmatch(spec)
    if spec is not None and (form is None or form["host"] is None):
        raise ConfigError(f"{name} {spec}: expected udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT")
