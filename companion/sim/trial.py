"""What is flown against the simulator: a scenario under a seed, on whose autopilot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.base.errors import ConfigError
from companion.base.files import find_file
from companion.sim.external import External
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.scenario import Scenario, load_scenario

# an external autopilot may still be booting, and finding its position before it arms
EXTERNAL_PATIENCE_S: Final = 60.0


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
        """Take a scenario by name or path; a firmware flies as itself, whatever the scenario says.

        Raises:
            ConfigError: no such scenario, its file breaks a rule, or somebody else's vehicle is to fly by a
                firmware of ours.
        """
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
