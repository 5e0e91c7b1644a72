"""Where the vehicle stands on Earth: the autopilots' usual places, a scenario's own, and the field there."""

from typing import Any

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import quat_rotate, vector3
from companion.base.magnetic_field import field_ned_ut
from companion.base.messages import MagSample
from companion.config import CONFIG_FOLDER, ConfigError, ImuConfig, validate
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sim.external import External
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.run.in_process import carried
from sitl.scenario.home import HomeSettings, magnetic_field_ned_ut, read_home
from sitl.scenario.scenario import Scenario

CMAC = (-35.363262, 149.165237, 584.0)
ELSEWHERE = {"latitude_deg": 60.0, "longitude_deg": -150.0, "altitude_m": 20.0}


def scenario(**settings: Any) -> Scenario:
    return validate(Scenario, {"name": "here", "description": "somewhere", **settings}, "the test")


@pytest.mark.parametrize(("kind", "place"), [("px4", (47.397742, 8.545594, 488.0)), ("ardupilot", CMAC)])
def test_without_a_home_it_stands_where_its_autopilots_simulator_does(
    kind: AutopilotKind, place: tuple[float, float, float]
) -> None:
    assert scenario(autopilot=kind).place == place
    assert scenario(autopilot=kind, home=ELSEWHERE).place == (60.0, -150.0, 20.0)


@pytest.mark.parametrize("settings", [{"autopilot": "ardupilot"}, {"home": ELSEWHERE}])
def test_the_sensors_and_the_autopilot_are_at_that_place(settings: dict[str, Any]) -> None:
    there = scenario(**settings)

    async def main() -> tuple[Any, list[MagSample], Any]:
        async with carried(there, 0, "still", camera=False) as vehicle:
            clock, driver, fields = Clock(), Mpu9250(vehicle.imu_bus, ImuConfig()), list[MagSample]()
            while clock.now_s() < 4.0:
                fields += driver.poll(clock.now_s)[1]
                await clock.sleep_until(clock.now_s() + 0.01)
            simulation = vehicle.simulation
            return simulation.autopilot.geodetic((0.0, 0.0, 0.0)), fields, simulation.world.state.attitude

    origin, fields, attitude = run_in_virtual_time(main())
    assert origin == pytest.approx(there.place, abs=1e-6)
    mean = vector3(np.mean([sample.field_body_ut for sample in fields], axis=0).tolist())
    left_by_calibration_ut = 2.5
    expected = field_ned_ut(*there.place, 2026.0)
    assert quat_rotate(attitude, mean) == pytest.approx(expected, abs=left_by_calibration_ut)


def test_the_app_is_reported_the_field_of_the_place_unless_the_scenario_tells_it_otherwise() -> None:
    path = CONFIG_FOLDER / "companion.yaml"

    def told(flown: Scenario, external: External | None = None) -> tuple[float, ...]:
        return sitl_settings(path, Trial(path, flown, 0, external), fast=True).estimate.magnetic_field_ned_ut

    assert told(scenario(home=ELSEWHERE)) == magnetic_field_ned_ut((60.0, -150.0, 20.0))
    mistaken = {"estimate": {"magnetic_field_ned_ut": [20.0, 0.0, 40.0]}}
    assert told(scenario(home=ELSEWHERE, companion=mistaken)) == (20.0, 0.0, 40.0)
    assert told(scenario(home=ELSEWHERE), External("udp:127.0.0.1:14550", None)) == (20.9, 0.6, 42.9)


def test_the_option_is_that_of_ardupilots_simulator() -> None:
    home, heading_deg = read_home("-35.363262,149.165237,584,353")
    assert (home, heading_deg) == (
        HomeSettings(latitude_deg=CMAC[0], longitude_deg=CMAC[1], altitude_m=CMAC[2]),
        353.0,
    )


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("47.4,8.5", "--home: expected LAT,LON,ALT,HEADING"),
        ("here", "found 'here'"),
        ("95,8.5,0,0", "--home: latitude_deg"),
        ("47.4,8.5,nan,0", "--home: altitude_m"),
        ("47.4,8.5,488,900", "expected a heading of -360 to 360 degrees, found 900"),
    ],
)
def test_a_home_that_is_none_is_refused_in_a_line(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint) as refused:
        read_home(text)
    assert "\n" not in str(refused.value)
