"""The app's settings against the simulator: the user's file, and over it the simulated vehicle."""

from pathlib import Path
from typing import Any, Final

from companion.base.errors import ConfigError
from companion.base.files import find_file
from companion.config import (
    CameraConfig,
    CompanionConfig,
    GpsConfig,
    ImuConfig,
    VehicleConfig,
    load_config,
    load_model,
    merge,
    validate,
)
from companion.sim.trial import Trial
from sitl.scenario.scenario import Scenario

# what a settings file for a real vehicle may say otherwise, and the simulated one is; a real one's
# calibrations would put wrong what is right here (a scenario of flawed sensors names its own over these)
SIMULATED_HARDWARE: Final[dict[str, Any]] = {
    "mount": None,
    "sense": {
        "imu": ImuConfig().model_dump(
            include={"address", "body_from_sensor_deg", "inertial_calibration", "magnetometer_calibration"}
        ),
        "gps": GpsConfig().model_dump(include={"antenna_position_body_m"}),
        "autopilot": {"magnetometer_calibration": None},
    },
}

# of what two vehicles differ in
MOST_NAMED: Final = 4

# the app's settings when its IMU, compass and GPS are those of the user's own autopilot
_BY_TELEMETRY: Final[dict[str, Any]] = {
    "sense": {"source": "autopilot", "autopilot": {"range_source": "boards"}},
    # it is a simulator's: nobody is surprised by what is set there
    "link": {"set_parameters": True},
}

_MAY_ARM: Final[dict[str, Any]] = {"plan": {"mission": {"may_arm": True}}}


def sitl_settings(config_path: Path, trial: Trial, *, fast: bool) -> CompanionConfig:
    """The app's settings for a trial: the file, and over it what the scenario's operator knows."""
    link: dict[str, Any] = {"link": {"system_id": 1, "set_parameters": True}}
    if trial.external is not None:
        link = {}  # somebody's own autopilot has the number that their settings give
    elif trial.firmware is not None:
        link = {"link": {"system_id": 0}}  # PX4 numbers itself by its instance
    hardware = merge(merge(SIMULATED_HARDWARE, link), _wiring(trial.scenario))
    scenario = trial.scenario
    overrides = merge(merge(hardware, _MAY_ARM), scenario.companion)
    if fast:
        # MAVSDK has threads and a clock of its own; the same actions by our own messages in virtual time
        overrides = merge(overrides, {"link": {"actions": "pymavlink"}})
    if trial.external is not None:
        overrides = merge(overrides, _BY_TELEMETRY)
    # the file by itself first, so that a mistake is reported where it was made
    settings = load_config(config_path).model_dump()
    config = validate(CompanionConfig, merge(settings, overrides), f"{trial.path}: companion")
    _check_pad(config, trial)
    _check_camera(config, trial)
    return config


def calibrations_left_out(config_path: Path, flown: CompanionConfig) -> list[str]:
    """Which calibration files the settings name for a real vehicle that the simulated one does not fly by."""
    named, used = (_files(config) for config in (load_config(config_path), flown))
    return [key for key, file in named.items() if file is not None and used[key] != file]


def vehicle_differs(config: CompanionConfig, trial: Trial) -> str | None:
    """What the app's vehicle says otherwise than the simulated one, in one line; None where they agree.

    None as well where there is no such airframe: the simulator says that.

    Errors of the file may be what a flight is to show, so this is reported and not refused.
    """
    ours = load_model(VehicleConfig, find_file("vehicles", config.vehicle)).model_dump()
    try:
        file = find_file("vehicles", trial.scenario.airframe)
    except ConfigError:
        return None
    theirs = load_model(VehicleConfig, file).model_dump()
    other = [key for key in ours if key != "name" and ours[key] != theirs[key]]
    if not other:
        return None
    named = [f"{key} {_short(ours[key])} (simulated {_short(theirs[key])})" for key in other[:MOST_NAMED]]
    named += [f"{len(other) - MOST_NAMED} more"] if len(other) > MOST_NAMED else []
    airframe = trial.scenario.airframe
    return f"vehicle '{config.vehicle}' is not the scenario's airframe '{airframe}': {', '.join(named)}"


def _short(value: Any) -> str:
    return "..." if isinstance(value, dict) else str(value)


def _files(config: CompanionConfig) -> dict[str, str | None]:
    sense = config.sense
    return {
        "mount": config.mount,
        "sense.imu.inertial_calibration": sense.imu.inertial_calibration,
        "sense.imu.magnetometer_calibration": sense.imu.magnetometer_calibration,
        "sense.autopilot.magnetometer_calibration": sense.autopilot.magnetometer_calibration,
    }


def _wiring(scenario: Scenario) -> dict[str, Any]:
    """The app's settings that go with how the simulated sensors are connected."""
    bus = {"i2c": "i2c:1", "spi": "spi:0.0"}[scenario.sensors.imu_interface]
    return {"sense": {"imu": {"bus": bus}, "range": {"kind": scenario.sensors.ultrasonic}}}


def _check_pad(config: CompanionConfig, trial: Trial) -> None:
    """A pad that the app does not know is never found, which a flight would take minutes to say."""
    there, sought = find_file("pads", trial.scenario.pad.name), find_file("pads", config.pad)
    if there.resolve() != sought.resolve():
        raise ConfigError(
            f"{trial.path}: pad.name is '{trial.scenario.pad.name}' but the app looks for '{config.pad}'; "
            f"expected the same, for instance 'companion: {{pad: {trial.scenario.pad.name}}}'"
        )


def _check_camera(config: CompanionConfig, trial: Trial) -> None:
    """Calibrations may differ, as they do in life; the size of the images may not."""
    theirs = load_model(CameraConfig, find_file("cameras", trial.scenario.camera.config))
    ours = load_model(CameraConfig, find_file("cameras", config.camera))
    if (theirs.width_px, theirs.height_px) != (ours.width_px, ours.height_px):
        raise ConfigError(
            f"{trial.path}: camera.config '{theirs.name}' is {theirs.width_px}x{theirs.height_px} px but the "
            f"app's camera '{ours.name}' {ours.width_px}x{ours.height_px} px; expected the same size"
        )
