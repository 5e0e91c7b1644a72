"""What is said of settings that describe another vehicle than the simulated one."""

from pathlib import Path

from companion.config import CONFIG_FOLDER
from companion.sim.settings import sitl_settings, vehicle_differs
from companion.sim.trial import Trial


def test_a_vehicle_like_the_airframe_is_not_reported() -> None:
    trial = Trial.load("line", 0)
    assert vehicle_differs(sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True), trial) is None


def test_a_vehicle_that_sits_otherwise_is_reported_with_what_differs(tmp_path: Path) -> None:
    text = (CONFIG_FOLDER / "vehicles" / "x500.yaml").read_text()
    other = tmp_path / "other.yaml"
    other.write_text(text.replace("camera_yaw_deg: 0.0", "camera_yaw_deg: 90.0"))
    trial = Trial.load("line", 0)
    # by the settings, and by the scenario's own overrides of them
    settings = tmp_path / "settings.yaml"
    settings.write_text("vehicle: other.yaml\n")
    scenario = trial.scenario.model_copy(update={"companion": {"vehicle": str(other)}})
    for config, told in (
        (settings, trial),
        (CONFIG_FOLDER / "companion.yaml", Trial(trial.path, scenario, 0)),
    ):
        said = vehicle_differs(sitl_settings(config, told, fast=True), told)
        assert said == (
            f"vehicle '{other}' is not the scenario's airframe 'x500': camera_yaw_deg 90.0 (simulated 0.0)"
        )
