"""App and simulator in the bench's own process, for what it puts between them and watches."""

from typing import Any

from companion.app.app import App
from companion.app.hardware import make_own_actions
from companion.config import CompanionConfig
from companion.flightlog.record import FlightLog
from companion.link.transport import memory_pair
from companion.sim.runner import hardware_of
from companion.sim.trial import Trial
from sitl.run.in_process import InProcess


def app_and_vehicle(
    trial: Trial, config: CompanionConfig, log: FlightLog, *, stays: bool = False, **vehicle: Any
) -> tuple[App, InProcess]:
    """An app on a trial's vehicle; neither runs yet. `vehicle`: more for `InProcess`.

    Raises:
        ConfigError: a settings file that the scenario names is missing or wrong.
    """
    app_end, vehicle_end = memory_pair()
    made = InProcess(
        trial.scenario,
        trial.seed,
        link=vehicle_end,
        gps_baud=config.sense.gps.baud,
        firmware=trial.firmware,
        **vehicle,
    )
    return App(config, hardware_of(made, app_end, config), log, make_own_actions, stays=stays), made
