"""Whole flights for the experiments: the app against the simulator in virtual time, with its truth.

The flight is the one that `companion --sitl --fast` flies under the shipped settings, but for what an
experiment says otherwise. Times count from the app's first cycle; NED from the simulator's home, SI units.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from companion.base.geometry import Vector3
from companion.base.messages import GpsFix, Phase, Truth
from companion.config import CONFIG_FOLDER, CompanionConfig, merge, validate
from companion.flightlog.record import FlightLog
from companion.flightlog.result import Result, from_start
from companion.sim.runner import fly
from companion.sim.scoring import score
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.scenario.scenario import USUAL_HOMES

SETTINGS: Final = CONFIG_FOLDER / "companion.yaml"


class _Keeping(FlightLog):
    """A log in memory that keeps the GPS fixes besides what every log keeps."""

    def write(self, topic: str, message: Any, time_s: float) -> None:
        if isinstance(message, GpsFix):
            self.kept[topic].append(message)
        super().write(topic, message, time_s)


@dataclass(frozen=True, slots=True)
class EndedFlight:
    """One flight that has ended: its score, what the app logged by topic, and the truth."""

    result: Result
    truth: Sequence[Truth]
    kept: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    home: Vector3 = USUAL_HOMES["px4"]  # latitude (deg), longitude (deg), altitude (m) of the truth's origin

    def first_s(self, phase: Phase) -> float | None:
        """When a phase began for the first time."""
        return next((plan.time_s for plan in self.kept.get("plan", ()) if plan.phase is phase), None)

    def contact_s(self, after_s: float = -math.inf) -> float | None:
        """When the vehicle touched something after it had been in the air, by truth.

        A take-off in gusts may touch the ground once more: `after_s` looks at what comes later.
        """
        airborne = False
        for record in self.truth:
            if record.time_s < after_s:
                continue
            if airborne and record.in_contact:
                return record.time_s
            airborne = airborne or not record.in_contact
        return None


def fly_scenario(scenario: str, seed: int, settings: Mapping[str, Any] | None = None) -> EndedFlight:
    """Fly a scenario under a seed, with `settings` laid over the shipped ones.

    Raises:
        ConfigError: no such scenario, or the settings are wrong.
    """
    trial = Trial.load(scenario, seed)
    config = sitl_settings(SETTINGS, trial, fast=True)
    config = validate(CompanionConfig, merge(config.model_dump(), dict(settings or {})), "the experiment")
    log = _Keeping(None, start_unix_s=0.0)
    flight = fly(config, trial, log, lambda _status: None, fast=True)
    result = score(trial, flight, log)
    kept, truth = from_start(log.kept, flight.report.truth)
    return EndedFlight(result, truth, kept, trial.scenario.place)
