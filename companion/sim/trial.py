"""What is flown against the simulator: a scenario under a seed, on whose autopilot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.base.files import find_file
from companion.config import CONNECTION_FORM, ConfigError
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.scenario import Scenario, load_scenario

# an external autopilot may still be booting, and finding its position before it arms
EXTERNAL_PATIENCE_S: Final = 60.0


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
        """What --autopilot, --connect and --connect-world say; None for the bundled autopilot."""
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
            spec = options[name]
            form = None if spec is None else CONNECTION_FORM.fullmatch(spec)
            if spec is not None and (form is None or form["host"] is None):
                raise ConfigError(f"{name} {spec}: expected udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT")
        return cls(connect, options["--connect-world"])


@dataclass(frozen=True, slots=True)
class Trial:
    """What is to be flown: a scenario (and the file it came from) under a seed, on whose autopilot."""

    path: Path
    scenario: Scenario
    seed: int
    external: External | None = None
    firmware: FirmwareSpec | None = None

    @classmethod
    def load(
        cls, name: str, seed: int, external: External | None = None, firmware: FirmwareSpec | None = None
    ) -> Trial:
        """Take a scenario by name or path; a firmware flies as itself, whatever the scenario says."""
        if external is not None and firmware is not None:
            raise ConfigError("--firmware: expected to be left out with --autopilot external")
        path = find_file("scenarios", name)
        scenario = load_scenario(path)
        if firmware is not None:
            scenario = scenario.model_copy(update={"autopilot": firmware.kind})
        return cls(path, scenario, seed, external, firmware)

    @property
    def time_limit_s(self) -> float:
        """How long the flight may take, from the app's start."""
        patience_s = 0.0 if self.external is None else EXTERNAL_PATIENCE_S
        return self.scenario.time_limit_s + patience_s
