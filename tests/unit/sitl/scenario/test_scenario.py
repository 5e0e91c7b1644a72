"""Scenarios: the shipped ones load and keep their promises; a wrong one says what is wrong in a line."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config import CONFIG_FOLDER, ConfigError, load_config, validate
from sitl.scenario.scenario import AirframeConfig, Scenario, load_airframe, load_scenario
from sitl.world.world import World

SHIPPED = sorted(path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml"))
BARS = ["circle", "figure_8", "heave", "line", "static"]


def test_the_five_of_the_bars_are_shipped() -> None:
    assert set(BARS) <= set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_loads_under_its_own_name_and_its_settings_suit_the_app(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    load_config(CONFIG_FOLDER / "companion.yaml", scenario.companion)
    World(scenario, 0)


@pytest.mark.parametrize("name", BARS)
def test_the_bounds_are_the_bars(name: str) -> None:
    bounds = load_scenario(name).pass_bounds
    assert (bounds.lateral_error_m, bounds.vertical_speed_m_s) == (0.15, 0.4)
    assert bounds.horizontal_speed_m_s == 0.3
    assert bounds.tilt_deg == 10.0


@pytest.mark.parametrize("name", BARS)
def test_the_pad_can_be_met_at_the_waypoint_and_stays_in_reach(name: str) -> None:
    scenario = load_scenario(name)
    north, east = scenario.companion["plan"]["mission"]["waypoint_ned_m"]
    for seed in range(10):
        pad = World(scenario, seed).pad_motion
        met = min(
            math.hypot(p.position_ned_m[0] - north, p.position_ned_m[1] - east)
            for p in (pad.at(20.0 + 0.5 * i) for i in range(11))
        )
        assert met < 4.0
        if name != "line":
            assert max(math.hypot(*pad.at(float(t)).position_ned_m[:2]) for t in range(91)) < 40.0


def test_the_airframe_is_the_agreed_one() -> None:
    airframe = load_airframe("x500")
    assert airframe.body.mass_kg == 1.5
    assert airframe.body.hover_share() == pytest.approx(0.5, abs=0.005)
    assert airframe.legs.standing_height_m() == 0.18
    assert isinstance(airframe, AirframeConfig)


def written(tmp_path: Path, **values: Any) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"name": "mine", "description": "mine", **values}), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"wind": {"mean_m_s": 50.0}}, ["wind.mean_m_s", "20", "50"]),
        ({"wind": {"turbulence": "wild"}}, ["wind.turbulence", "moderate"]),
        ({"pad": {"motion": {"kind": "zigzag"}}}, ["pad.motion", "zigzag", "circle"]),
        ({"pad": {"motion": {"kind": "line"}}}, ["speed_m_s"]),
        ({"pad": {"motion": {"kind": "line", "speed_m_s": 1.0, "course_deg": "north"}}}, ["course_deg"]),
        (
            {
                "pad": {
                    "surface_height_m": 0.1,
                    "motion": {"kind": "heave", "significant_height_m": 1.0, "peak_period_s": 5.0},
                }
            },
            ["surface_height_m", "0.87"],
        ),
        (
            {"pad": {"motion": {"kind": "random_turns", "speed_m_s": 1.0, "arc_s": [5.0, 2.0]}}},
            ["arc_s", "shortest"],
        ),
        ({"colour": "red"}, ["unknown key", "colour"]),
        (
            {"pad": {"motion": {"kind": "circle", "radus_m": 5}}},
            ["unknown key 'pad.motion.radus_m'; did you mean 'radius_m'?"],
        ),
        (
            {"pad": {"motion": {"kind": "circel", "radius_m": 5}}},
            ["pad.motion.kind: expected one of 'static', 'line', 'circle'", "found 'circel'"],
        ),
        ({"pad": {"motion": {"radius_m": 5}}}, ["pad.motion.kind: expected a value, found none"]),
        (
            {"start_heading_deg": "north"},
            ["start_heading_deg: expected a valid number or 'random', found 'north'"],
        ),
        ({"camera": {"latency_s": 1.0}}, ["camera.latency_s"]),
        ({"camera": {"exposure": {"shortest_s": 0.02}}}, ["shortest_s", "longest_s"]),
        ({"link": {"loss_share": 2.0}}, ["link.loss_share"]),
        ({"light": {"glare": {"elevation_deg": 95.0}}}, ["light.glare.elevation_deg", "90"]),
        ({"pass": {"lateral_error_m": -1.0}}, ["pass.lateral_error_m"]),
        ({"autopilot": "betaflight"}, ["autopilot", "px4"]),
    ],
)
def test_a_wrong_scenario_is_refused_in_one_line(
    tmp_path: Path, values: dict[str, Any], words: list[str]
) -> None:
    path = written(tmp_path, **values)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in [str(path), *words])


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="figure_8"):
        load_scenario("nowhere")


def test_an_unknown_airframe_or_pad_is_refused_when_the_world_is_built() -> None:
    base = {"name": "mine", "description": "mine"}
    with pytest.raises(ConfigError, match="x500"):
        World(validate(Scenario, {**base, "airframe": "zeppelin"}, "mine"), 0)
    with pytest.raises(ConfigError, match="moving_1300"):
        World(validate(Scenario, {**base, "pad": {"name": "none"}}, "mine"), 0)
