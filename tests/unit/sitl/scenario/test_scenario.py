"""Scenarios: the shipped ones load and keep their promises; a wrong one says what is wrong in a line."""

import json
import math
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import GRAVITY_M_S2, ZERO3, norm, quat_rotate, vector3
from companion.base.magnetic_field import field_ned_ut
from companion.base.messages import MagSample
from companion.config import CONFIG_FOLDER, ConfigError, ImuConfig, load_config, validate
from companion.pad import load_pad
from companion.sense.imu.mpu9250 import Mpu9250
from sitl.faults.lines import LinkSettings
from sitl.run.in_process import carried
from sitl.scenario.as_built import AS_BELIEVED, NOTHING_ELSE, AsBuiltSettings, BuiltVehicle, draw
from sitl.scenario.listing import listing, schema_text, shipped
from sitl.scenario.scenario import (
    AirframeConfig,
    HomeSettings,
    Scenario,
    load_airframe,
    load_scenario,
    read_home,
)
from sitl.sensors.inertial import felt_at
from sitl.vehicle.quadrotor import Motors, QuadrotorState, RotorValues
from sitl.world.world import World
from tests.programs import ProgramHere

SHIPPED = sorted(path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml"))
BARS = ["circle", "figure_8", "heave", "line", "static"]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_loads_under_its_own_name_and_its_settings_suit_the_app(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    load_config(CONFIG_FOLDER / "companion.yaml", scenario.companion)
    World(scenario, 0)


@pytest.mark.parametrize("name", BARS)
def test_the_bounds_are_the_bars_and_the_pad_can_be_met_at_the_waypoint_and_stays_in_reach(name: str) -> None:
    scenario = load_scenario(name)
    bounds = scenario.pass_bounds
    assert (bounds.lateral_error_m, bounds.vertical_speed_m_s) == (0.15, 0.4)
    assert (bounds.horizontal_speed_m_s, bounds.tilt_deg) == (0.3, 10.0)
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


def moving(**motion: Any) -> dict[str, Any]:
    return {"pad": {"surface_height_m": 0.1, "motion": motion}}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"wind": {"mean_m_s": 50.0}}, ["wind.mean_m_s", "20", "50"]),
        ({"wind": {"turbulence": "wild"}}, ["wind.turbulence", "moderate"]),
        (moving(kind="zigzag"), ["pad.motion", "zigzag", "circle"]),
        (moving(kind="line"), ["speed_m_s"]),
        (moving(kind="line", speed_m_s=1.0, course_deg="north"), ["course_deg"]),
        (moving(kind="heave", significant_height_m=1.0, peak_period_s=5.0), ["surface_height_m", "0.87"]),
        (moving(kind="random_turns", speed_m_s=1.0, arc_s=[5.0, 2.0]), ["arc_s", "shortest"]),
        ({"colour": "red"}, ["unknown key", "colour"]),
        (moving(kind="circle", radus_m=5), ["unknown key 'pad.motion.radus_m'; did you mean 'radius_m'?"]),
        (
            moving(kind="circel", radius_m=5),
            ["pad.motion.kind: expected one of 'static', 'line', 'circle'", "found 'circel'"],
        ),
        (moving(radius_m=5), ["pad.motion.kind: expected a value, found none"]),
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


def test_an_unknown_scenario_airframe_or_pad_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="figure_8"):
        load_scenario("nowhere")
    # when the world is built
    for wrong, known in (({"airframe": "zeppelin"}, "x500"), ({"pad": {"name": "none"}}, "moving_1300")):
        with pytest.raises(ConfigError, match=known):
            World(scenario_here(**wrong), 0)


# ---------------- `companion-sitl scenarios` and `schema`

FIRST_LINE = "# yaml-language-server: $schema=scenario.schema.json"


def test_every_shipped_scenario_has_a_line_of_what_it_is(program: ProgramHere) -> None:
    ended = program("companion-sitl", "scenarios")
    lines = ended.out.splitlines()
    assert ended.code == 0
    assert lines[0].split() == ["name", "pad", "wind", "faults", "description"]
    assert [line.split()[0] for line in lines[1:]] == shipped()
    by_name = {line.split()[0]: line for line in lines[1:]}
    for name, words in {
        "deck": ["line 0.5 m/s, at sea", "4 m/s, light", "A ship's deck"],
        "static": ["static", "calm", " - "],
        "gps_loss": ["gps_jump, gps_lost"],
        "gust": ["2 m/s, gusts"],
    }.items():
        assert [word for word in words if word not in by_name[name]] == []


def test_a_name_prints_settings_that_give_the_same_scenario_again(
    tmp_path: Path, program: ProgramHere
) -> None:
    for name in ("deck", "figure_8", "lossy_link"):
        out = program("companion-sitl", "scenarios", name).out
        copy = tmp_path / f"{name}.yaml"
        copy.write_text(out)
        assert load_scenario(copy) == load_scenario(name)
        assert yaml.safe_load(out)["camera"]["exposure"]["longest_s"] == 0.01


def test_an_unknown_name_is_one_line_and_exit_code_2(program: ProgramHere) -> None:
    err = program("companion-sitl", "scenarios", "nowhere").refusal
    assert "nowhere" in err
    assert "figure_8" in err


def test_the_shipped_schema_is_current(program: ProgramHere) -> None:
    out = program("companion-sitl", "schema").out
    assert out == schema_text()
    path = CONFIG_FOLDER / "scenarios" / "scenario.schema.json"
    assert path.read_text(encoding="utf-8") == out, (
        "run: companion-sitl schema > configs/scenarios/scenario.schema.json"
    )


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_scenario_names_the_schema_and_uses_its_words(name: str) -> None:
    text = (CONFIG_FOLDER / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8")
    assert text.splitlines()[0] == FIRST_LINE
    schema = read_schema()
    assert unknown_words(yaml.safe_load(text), schema, schema) == []


@cache
def read_schema() -> dict[str, Any]:
    """The schema, made once."""
    schema: dict[str, Any] = json.loads(schema_text())
    return schema


def unknown_words(data: dict[str, Any], part: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    """Keys of a file, and of the mappings in it, that the schema does not have."""
    unknown = []
    for key, value in data.items():
        known = part.get("properties", {}).get(key)
        if known is None:
            unknown.append(key)
        elif isinstance(value, dict) and (inner := referred(known, schema, value)) is not None:
            unknown += unknown_words(value, inner, schema)
    return unknown


def referred(known: dict[str, Any], schema: dict[str, Any], value: dict[str, Any]) -> dict[str, Any] | None:
    """The definition that a property leads to, of several the one of the value's kind."""
    leads = [known, *known.get("anyOf", ()), *known.get("oneOf", ()), *known.get("allOf", ())]
    for lead in leads:
        if "$ref" in lead:
            definition: dict[str, Any] = schema["$defs"][lead["$ref"].rpartition("/")[2]]
            kind = definition["properties"].get("kind", {}).get("const")
            if kind in (None, value.get("kind")):
                return definition
    return None


def test_the_list_fits_a_narrow_terminal() -> None:
    narrow = listing(80)
    assert max(map(len, narrow.splitlines())) <= 80
    for scenario in map(load_scenario, shipped()):
        assert f"{scenario.name}\n  {scenario.description[:20]}" in narrow
    assert listing(1000) == listing()


# ----------------
# Where the vehicle stands on Earth: the autopilots' usual places, a scenario's own, and the field there.

CMAC = (-35.363262, 149.165237, 584.0)
ELSEWHERE = {"latitude_deg": 60.0, "longitude_deg": -150.0, "altitude_m": 20.0}


def scenario_here(**settings: Any) -> Scenario:
    return validate(Scenario, {"name": "here", "description": "somewhere", **settings}, "the test")


@pytest.mark.parametrize(("kind", "place"), [("px4", (47.397742, 8.545594, 488.0)), ("ardupilot", CMAC)])
def test_without_a_home_it_stands_where_its_autopilots_simulator_does(
    kind: AutopilotKind, place: tuple[float, float, float]
) -> None:
    assert scenario_here(autopilot=kind).place == place
    assert scenario_here(autopilot=kind, home=ELSEWHERE).place == (60.0, -150.0, 20.0)


@pytest.mark.parametrize("settings", [{"autopilot": "ardupilot"}, {"home": ELSEWHERE}])
def test_the_sensors_and_the_autopilot_are_at_that_place(settings: dict[str, Any]) -> None:
    there = scenario_here(**settings)

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


# ----------------
# What the builder got wrong: drawn by the seed, given to the world, and to nobody who believed otherwise.

SEEDS = range(200)
BODY = load_airframe("x500").body


def built_scenario(**section: Any) -> Scenario:
    return Scenario.model_validate({"name": "t", "description": "t", "as_built": section})


def test_every_error_is_drawn_within_its_size_on_both_sides_and_by_the_seed() -> None:
    drawn = [draw(AsBuiltSettings(), seed) for seed in SEEDS]
    assert drawn[3] == draw(AsBuiltSettings(), 3)
    bounds = {
        "hover_thrust": (0.65, 1.35), "thrust_exponent": (0.6, 2.0), "mass": (0.8, 1.2),
        "leg_height_m": (-0.03, 0.03), "focal_length": (0.985, 1.015), "pad_print": (0.985, 1.015),
        "stamp_s": (-0.02, 0.02), "delay_to_app_s": (0.0, 0.04), "delay_to_vehicle_s": (0.0, 0.04),
        "vibration": (1.0, 15.0), "yaw_reset_deg": (-15.0, 15.0),
    }  # fmt: skip
    for name, (low, high) in bounds.items():
        found = [getattr(built, name) for built in drawn]
        assert low <= min(found) < low + 0.1 * (high - low), name
        assert high - 0.1 * (high - low) < max(found) <= high, name
    assert max(norm(built.imu_offset_body_m) for built in drawn) <= 0.1
    assert all(min(built.delay_to_app_s, built.delay_to_vehicle_s) == 0.0 for built in drawn)


def test_the_size_of_one_error_leaves_the_others_as_they_are() -> None:
    usual, other = draw(AsBuiltSettings(), 7), draw(AsBuiltSettings(mass=0.0), 7)
    changed = {f.name for f in fields(BuiltVehicle) if getattr(usual, f.name) != getattr(other, f.name)}
    assert (changed, other.mass) == ({"mass"}, 1.0)


def test_without_the_section_and_with_all_left_out_all_is_as_believed() -> None:
    assert draw(None, 5) == AS_BELIEVED
    left_out = draw(AsBuiltSettings(**NOTHING_ELSE), 5)
    when = {"yaw_reset_s"}  # of a reset by nothing
    assert all(
        np.all(np.equal(getattr(left_out, f.name), getattr(AS_BELIEVED, f.name)))
        for f in fields(BuiltVehicle)
        if f.name not in when
    )


def test_a_value_that_is_set_is_not_drawn_and_a_wrong_one_is_refused_in_one_line() -> None:
    section = {**NOTHING_ELSE, "exactly": {"hover_thrust": 0.6, "imu_offset_body_m": [0.1, 0.0, 0.0]}}
    built = built_scenario(**section).built(1)
    assert (built.hover_thrust, built.imu_offset_body_m, built.mass) == (0.6, (0.1, 0.0, 0.0), 1.0)
    for wrong in ({"hover": 0.6}, {"hover_thrust": [0.6, 0.7]}, {"place_deg": 3.0}):
        with pytest.raises(ConfigError, match="exactly: "):
            validate(AsBuiltSettings, {"exactly": wrong}, "a.yaml")


@pytest.mark.parametrize("seed", range(20))
def test_it_hovers_at_what_was_told_over_the_error_and_its_rate_loops_are_tuned_on_what_was_built(
    seed: int,
) -> None:
    built = draw(AsBuiltSettings(), seed)
    true, step = BODY.hover_share() / built.hover_thrust, 1e-4
    motors, full_n = Motors(built.thrust_exponent), built.body(BODY).max_thrust_n
    low, mid, high = (motors.given((true + by,) * 4)[0] * full_n for by in (-step, 0.0, step))
    # the world's rotors at the true command carry the true weight; the autopilot believes the told one
    assert 4.0 * mid == pytest.approx(built.mass * BODY.mass_kg * GRAVITY_M_S2)
    told = built.told_body(BODY)
    assert told.hover_share() == pytest.approx(BODY.hover_share())
    # a change of command about hover gives the torque that the autopilot's mixer takes it for
    assert (high - low) / (2.0 * step) == pytest.approx(told.max_thrust_n, rel=1e-4)
    assert built.rate_scale(BODY) == pytest.approx(BODY.max_thrust_n / told.max_thrust_n)


def test_the_world_stands_on_its_own_legs_and_its_own_print() -> None:
    exactly = {"leg_height_m": 0.03, "pad_print": 0.985, "mass": 1.2}
    world = World(built_scenario(**{**NOTHING_ELSE, "exactly": exactly}), 0)
    assert world.landed_reference_height_m == pytest.approx(0.21)
    assert world.board.half_length_m == pytest.approx(0.5 * 0.985 * load_pad("moving_1300").length_m)
    assert world.airframe.body.mass_kg == pytest.approx(1.2 * world.believed_airframe.body.mass_kg)
    world.step((0.0,) * 4, 0.0025)
    assert world.truth().in_contact or world.height_m == pytest.approx(0.21, abs=1e-3)


def test_it_flies_elsewhere_and_the_app_is_told_nothing_of_it() -> None:
    believed = Scenario.model_validate({"name": "t", "description": "t"})
    as_built = built_scenario()
    assert as_built.companion == believed.companion
    assert as_built.built(0).home(as_built.place)[:2] != believed.place[:2]


def test_an_imu_off_the_centre_feels_the_turning() -> None:
    spinning = QuadrotorState((0.0, 0.0, 0.0), rate_body_rad_s=(0.0, 0.0, 3.0))
    ahead = felt_at((0.1, 0.0, 0.0), spinning)
    assert ahead == pytest.approx((-0.9, 0.0, -GRAVITY_M_S2))  # centripetal
    turning = QuadrotorState((0.0, 0.0, 0.0), angular_acceleration_body_rad_s2=(0.0, 5.0, 0.0))
    assert felt_at((0.1, 0.0, 0.0), turning) == pytest.approx((0.0, 0.0, -GRAVITY_M_S2 - 0.5))
    assert felt_at(ZERO3, spinning) is spinning.specific_force_body_m_s2


def test_a_delay_is_on_one_side_of_the_line_and_motors_that_are_believed_rightly_pass_the_command_on() -> (
    None
):
    line = LinkSettings(delay_s=0.01)
    to_app, to_vehicle = BuiltVehicle(delay_to_app_s=0.03).links(line)
    assert to_app.delay_s == pytest.approx(0.04)
    assert to_vehicle is line
    command: RotorValues = (0.1, 0.2, 0.3, 0.4)
    assert Motors().given(command) is command
    assert Motors(2.0).given((0.5, 0.5, -0.1, 1.2)) == pytest.approx((0.25, 0.25, 0.0, 1.0))
