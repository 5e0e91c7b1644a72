"""The speed laws that the settings choose among."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.base.messages import Conditions, Phase
from companion.config import CONFIG_FOLDER, ConfigError, PlanConfig
from companion.plan.planner import Planner
from companion.plan.speed.conditions import ConditionMonitor, PaceLaw, constant_pace
from companion.plan.speed.fuzzy_rules import INPUTS, load_rules, mamdani
from companion.plan.speed.laws import LogPolynomial, by_conditions, load_speed_controller
from companion.plan.speed.speed_table import SpeedTable, load_table, write_table
from companion.tools.fuzzy_check import sample_points, table_error, worst_slips
from tests.unit.control.controller_inputs import pad_state, vehicle_state
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import TABLE, VEHICLE, PlanFlight, PlanWorld

SHIPPED_TABLE = load_table("landing")[0]
Block = dict[str, Any]


def _law(name: str, **changes: object) -> PlanConfig:
    return PlanConfig.model_validate({"speed_law": name, **changes})


def test_the_fuzzy_pilot_flies_unless_set_otherwise() -> None:
    law = load_speed_controller(PlanConfig()).law
    assert isinstance(law, SpeedTable)
    assert law == SHIPPED_TABLE


def test_a_fixed_speed_knows_no_distance() -> None:
    law = load_speed_controller(_law("fixed", fixed_speed_m_s=1.2)).law
    assert {law(d, v, a) for d in (0.0, 5.0, 50.0) for v in (-1.0, 2.0) for a in (-1.0, 1.0)} == {1.2}


def test_a_fixed_speed_needs_no_rules() -> None:
    load_speed_controller(_law("fixed", fuzzy="nobody"))
    with pytest.raises(ConfigError, match="nobody"):
        load_speed_controller(_law("log_polynomial", fuzzy="nobody"))


def test_the_log_polynomial_follows_the_pilot_at_rest_and_nothing_else() -> None:
    law = load_speed_controller(_law("log_polynomial")).law
    for distance in np.linspace(0.0, 8.0, 33).tolist():
        assert law(distance, 0.0, 0.0) == pytest.approx(SHIPPED_TABLE(distance, 0.0, 0.0), abs=0.06)
        assert law(distance, 1.4, 1.0) == law(distance, -1.0, -1.0)


def test_the_log_polynomial_is_never_faster_when_closer_and_holds_its_ends() -> None:
    law = LogPolynomial(SHIPPED_TABLE)
    speeds = [law(d, 0.0, 0.0) for d in np.linspace(0.0, 12.0, 241).tolist()]
    assert min(np.diff(speeds)) >= -1e-9
    assert law(1e6, 0.0, 0.0) == law(8.0, 0.0, 0.0)
    assert law(-1.0, 0.0, 0.0) == law(0.0, 0.0, 0.0) > 0.2


def test_its_coefficients_are_those_of_the_logarithm() -> None:
    c = LogPolynomial(SHIPPED_TABLE).coefficients
    length = np.log1p(3.0)
    expected = c[0] + c[1] * length + c[2] * length**2 + c[3] * length**3
    assert LogPolynomial(SHIPPED_TABLE)(3.0, 0.0, 0.0) == pytest.approx(expected)


def test_only_the_fuzzy_pilot_looks_at_the_conditions_and_only_if_asked() -> None:
    storm = Conditions(sight_rad=0.2, relative_speed_m_s=3.0, gust_m_s2=3.0)
    assert load_speed_controller(PlanConfig(pace=True)).pace(storm) == pytest.approx(0.5, abs=0.01)
    assert load_speed_controller(PlanConfig()).pace(storm) == 1.0
    for name in ("fixed", "log_polynomial"):
        assert load_speed_controller(_law(name, pace=True)).pace(storm) == 1.0


def test_rules_without_a_pace_come_in_alike_in_all_conditions() -> None:
    assert by_conditions(SHIPPED_TABLE.model_copy(update={"pace": None}))(Conditions(0.2, 3.0, 3.0)) == 1.0


# ---------------- The conditions that the pace goes by: what raises each of the three, and what does not

STEP_S = 0.05


def felt(
    seconds: float, *, gust_m_s2: float = 0.0, off_m_s: float = 0.0, height_m: float = 5.0
) -> Conditions:
    """Over a pad in a steady wind with gusts once a second, at a speed over the pad beyond the planned."""
    monitor = ConditionMonitor()
    for k in range(round(seconds / STEP_S)):
        now_s = k * STEP_S
        swing = gust_m_s2 * math.sqrt(2.0) * math.sin(2.0 * math.pi * now_s)
        vehicle = replace(vehicle_state(now_s), side_force_ned_m_s2=(2.0 + swing, -1.0, 0.0))
        # the plan flies to the west by 1 m/s, the pad comes nearer by that and the speed off it
        sight = pad_state(now_s, (0.0, 0.0, height_m), (off_m_s, 1.0, 0.3))
        conditions = monitor.update(sight, vehicle, (0.0, -1.0, 0.3), now_s)
    assert conditions is not None
    return conditions


def test_a_steady_wind_and_a_planned_speed_are_no_bad_conditions() -> None:
    conditions = felt(6.0)
    assert conditions.gust_m_s2 == pytest.approx(0.0, abs=1e-6)
    assert conditions.relative_speed_m_s == pytest.approx(0.0, abs=1e-9)
    assert by_conditions(TABLE)(conditions) == pytest.approx(1.25, abs=0.01)


def test_gusts_are_the_spread_of_the_winds_force() -> None:
    assert felt(12.0, gust_m_s2=1.0).gust_m_s2 == pytest.approx(1.0, rel=0.1)


def test_the_relative_speed_is_what_the_plan_does_not_mean() -> None:
    assert felt(4.0, off_m_s=0.6).relative_speed_m_s == pytest.approx(0.6, abs=0.01)


def test_sight_is_the_error_as_seen_from_the_vehicle() -> None:
    near, far = felt(0.5, height_m=1.0), felt(0.5, height_m=10.0)
    assert near.sight_rad == pytest.approx(0.01, rel=0.01)
    assert far.sight_rad == pytest.approx(0.001, rel=0.01)


def test_there_are_no_conditions_before_a_pad_is_seen() -> None:
    monitor = ConditionMonitor()
    assert monitor.update(None, vehicle_state(0.0), None, 0.0) is None


def flown(pace: PaceLaw) -> PlanFlight:
    world = PlanWorld(still())
    world.planner = Planner(world.config, VEHICLE, 20, 0.1, TABLE, pace=pace)
    return world.fly(90.0)


def test_the_pace_sets_the_way_to_the_pad_and_leaves_the_final_descent_alone() -> None:
    usual, slow = flown(constant_pace), flown(lambda _conditions: 0.5)
    assert usual.phase is slow.phase is Phase.LANDED

    def took_s(flight: PlanFlight, begins: Phase, ends: Phase) -> float:
        return flight.entered(ends) - flight.entered(begins)

    way = (Phase.APPROACH, Phase.TOUCHDOWN)
    assert took_s(slow, *way) > 1.3 * took_s(usual, *way)
    final = (Phase.TOUCHDOWN, Phase.LANDED)
    assert took_s(slow, *final) == pytest.approx(took_s(usual, *final), abs=0.5)
    told = {step.phase for step in slow.steps if step.conditions is not None}
    assert told == {Phase.APPROACH, Phase.DESCEND}


# ---------------- test_speed_table

SHIPPED = CONFIG_FOLDER / "fuzzy" / "landing.yaml"


@pytest.fixture(scope="module")
def table() -> SpeedTable:
    return load_table("landing")[0]


def edited(folder: Path, **changes: object) -> Path:
    data = yaml.safe_load(SHIPPED.read_text(encoding="utf-8")) | changes
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_the_shipped_table_belongs_to_the_shipped_rules() -> None:
    # else the start takes seconds: run companion fuzzy landing --write-table
    assert load_table("landing")[1] == "stored"


def test_the_table_flies_what_scikit_fuzzy_says_within_a_hundredth(table: SpeedTable) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform((0.0, -2.0, -1.5), (10.0, 3.0, 1.5), (1500, 3))
    truth = mamdani(load_rules("landing"), points)
    flown = np.array([table(*(float(x) for x in point)) for point in points])
    assert np.max(np.abs(flown - truth) / truth) < 0.01


def test_a_single_compute_of_scikit_fuzzy_agrees_too(table: SpeedTable) -> None:
    # the vectorised surface is not an artefact of its vectorisation
    one = mamdani(load_rules("landing"), np.array([[2.4, 0.5, -0.2]]))
    assert one.shape == (1,)
    assert table(2.4, 0.5, -0.2) == pytest.approx(float(one[0]), rel=0.01)


def test_never_faster_when_closer_at_the_same_speed(table: SpeedTable) -> None:
    for velocity in np.linspace(-1.5, 2.0, 15):
        for acceleration in np.linspace(-1.2, 1.2, 9):
            speeds = [table(d, float(velocity), float(acceleration)) for d in np.linspace(0.0, 12.0, 121)]
            assert min(np.diff(speeds)) >= -1e-9


def test_slower_when_already_rushing_or_pushing(table: SpeedTable) -> None:
    assert table(2.0, 1.4, 0.0) < table(2.0, 0.0, 0.0)
    assert table(2.0, 0.2, 1.0) < table(2.0, 0.2, 0.0)


def test_there_is_a_speed_everywhere_and_it_is_a_sane_one(table: SpeedTable) -> None:
    rng = np.random.default_rng(4)
    for d, v, a in rng.uniform((-1.0, -20.0, -20.0), (500.0, 20.0, 20.0), (300, 3)):
        assert 0.2 <= table(float(d), float(v), float(a)) <= 1.9


def test_beyond_the_grid_its_edge_holds(table: SpeedTable) -> None:
    assert table(1000.0, -9.0, -9.0) == table(8.0, -1.0, -1.0)
    assert table(0.0, 9.0, 9.0) == table(0.0, 1.4, 1.0)


def test_edited_rules_do_not_fly_from_the_old_table(tmp_path: Path) -> None:
    # GIVEN rules stored with their table
    path = edited(tmp_path)
    written = write_table(path)
    assert load_table(path)[1] == "stored"
    # WHEN the fastest speed is turned down
    speeds = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["speed_m_s"]
    edited(tmp_path, speed_m_s=speeds | {"fast": [1.5, 1.6, 1.7]})
    # THEN the table is computed afresh, and the old file is left alone
    slower, how = load_table(path)
    assert how == "computed"
    assert slower(9.0, 0.0, 0.0) == pytest.approx(1.6, abs=0.02)
    assert written.exists()


def test_a_damaged_table_is_computed_afresh(tmp_path: Path, table: SpeedTable) -> None:
    path = edited(tmp_path)
    path.with_suffix(".table.json").write_text('{"fingerprint": "x"', encoding="utf-8")
    found, how = load_table(path)
    assert how == "computed"
    # the terms' order in the file (here by the alphabet) does not matter
    assert found == table


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"distance_m": {"near": [0, 0, 1], "far": [2, 3, 4, 4]}}, "distance_m: no term covers 1.0 to 2.0"),
        ({"velocity_m_s": {"easy": [0, 0, 1]}}, "velocity_m_s: expected at least two terms"),
        (
            {"speed_m_s": {"creep": [0.4, 0.3, 0.2], "fast": [1, 2, 3]}},
            "speed_m_s.creep: expected corners that rise",
        ),
        ({"rules": {"braking": {}}}, "rules: expected one block for each of braking, steady, pushing"),
        ({"speed": 3}, "unknown key 'speed'"),
    ],
)
def test_what_is_wrong_with_rules_is_said_in_one_line(
    tmp_path: Path, changes: dict[str, object], said: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_table(edited(tmp_path, **changes))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def closer_is_faster(block: Block) -> None:
    block["rules"]["steady"]["near"] = ["fast", "fast", "fast"]


def unknown_speed(block: Block) -> None:
    block["rules"]["pushing"]["far"] = ["brisk", "warp", "slow"]


def row_missing(block: Block) -> None:
    del block["rules"]["pushing"]["far"]


def backs_away(block: Block) -> None:
    slowest = min(block["speed_m_s"], key=lambda term: block["speed_m_s"][term])
    block["speed_m_s"][slowest] = [-0.4, -0.2, 0.0]


def gap_in_the_pace(block: Block) -> None:
    pace = block["pace"]
    del pace["gust_m_s2"]["breezy"], pace["rules"]["breezy"]
    pace["gust_m_s2"]["gusty"] = [0.9, 1.2, 2.4, 2.4]


def pace_that_stands_still(block: Block) -> None:
    block["pace"]["factor"]["slow"] = [0.0, 0.05, 0.1]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (closer_is_faster, r"mine\.yaml: rules: expected no more speed when closer"),
        (unknown_speed, r"rules\.pushing\.far: expected 3 of creep, slow"),
        (row_missing, r"rules\.pushing: expected a row for each of touching"),
        (backs_away, r"rules: expected at least 0.05 m/s, found -0.2"),
        (gap_in_the_pace, r"pace: gust_m_s2: no term covers 0.6 to 0.9"),
        (pace_that_stands_still, r"rules: expected at least 0.05 m/s, found 0.0"),
    ],
)
def test_shipped_rules_with_one_change_are_refused_with_its_place(
    tmp_path: Path, spoil: Callable[[Block], None], said: str
) -> None:
    rules = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    spoil(rules)
    with pytest.raises(ConfigError, match=said):
        load_table(edited(tmp_path, **rules))


# ---------------------------------------------------------------- the pace


def pace(sight_rad: float, relative_speed_m_s: float, gust_m_s2: float, table: SpeedTable) -> float:
    assert table.pace is not None
    return table.pace(sight_rad, relative_speed_m_s, gust_m_s2)


def test_quick_in_good_conditions_and_slow_in_bad_ones(table: SpeedTable) -> None:
    assert pace(0.008, 0.1, 0.2, table) == pytest.approx(1.25, abs=0.01)
    assert pace(0.2, 0.0, 0.0, table) == pytest.approx(0.5, abs=0.01)
    assert pace(0.008, 2.0, 0.2, table) == pytest.approx(0.75, abs=0.01)
    assert pace(0.008, 0.1, 2.0, table) == pytest.approx(0.75, abs=0.01)


def test_never_quicker_in_worse_conditions(table: SpeedTable) -> None:
    assert table.pace is not None
    for axis in range(3):
        assert np.diff(np.array(table.pace.factor), axis=axis).max() <= 1e-9


def test_the_pace_flies_what_scikit_fuzzy_says_within_a_hundredth(table: SpeedTable) -> None:
    rules = load_rules("landing").pace
    assert rules is not None
    points = np.random.default_rng(5).uniform((0.0, 0.0, 0.0), (0.15, 2.5, 3.0), (800, 3))
    truth = mamdani(rules, points)
    flown = np.array([pace(x, y, z, table) for x, y, z in points.tolist()])
    assert np.max(np.abs(flown - truth) / truth) < 0.01


# ---------------- The checks of the speed table find what they are for, and the shipped table passes them

RULES = load_rules("landing")


def test_the_shipped_table_is_within_a_hundredth_in_and_beyond_the_grid(table: SpeedTable) -> None:
    error = table_error(RULES, table, 1200, np.random.default_rng(7))
    assert error.holds
    assert 0.0 < error.rms < error.worst <= 0.01
    assert error.points == 1200


def test_the_samples_lie_on_every_side_of_the_grid(table: SpeedTable) -> None:
    points = sample_points(RULES, table, 2000, np.random.default_rng(0))
    for column, name in enumerate(INPUTS):
        axis = getattr(table, name)
        assert points[:, column].max() > axis[-1]
        assert points[:, column].min() < axis[0] or name == "distance_m"
    assert points[:, 0].min() >= 0.0


def test_a_wrong_entry_is_found_and_placed(table: SpeedTable) -> None:
    # one plane of distance is 5 % too fast
    row = 20
    planes = list(table.speed_m_s)
    planes[row] = tuple(tuple(1.05 * speed for speed in line) for line in planes[row])
    wrong = table.model_copy(update={"speed_m_s": tuple(planes)})
    error = table_error(RULES, wrong, 1200, np.random.default_rng(7))
    assert not error.holds
    assert table.distance_m[row - 1] < error.worst_at[0] < table.distance_m[row + 1]


def test_the_shipped_rules_are_a_pilots(table: SpeedTable) -> None:
    assert max(worst_slips(RULES, table).values()) < 1e-3


@pytest.mark.parametrize("axis", range(3))
def test_the_other_way_round_is_no_pilots(table: SpeedTable, axis: int) -> None:
    name = INPUTS[axis]
    flipped = np.flip(np.array(table.speed_m_s), axis=axis).tolist()
    slips = worst_slips(RULES, table.model_copy(update={"speed_m_s": flipped}))
    assert slips[name] > 0.05
    assert [other for other, slip in slips.items() if slip > 0.01] == [name]


def test_the_pace_is_checked_likewise(table: SpeedTable) -> None:
    assert RULES.pace is not None
    assert table.pace is not None
    assert sample_points(RULES.pace, table.pace, 500, np.random.default_rng(0)).min() >= 0.0
    assert table_error(RULES.pace, table.pace, 600, np.random.default_rng(7)).holds
    assert max(worst_slips(RULES.pace, table.pace).values()) < 1e-3
    flipped = np.flip(np.array(table.pace.factor), axis=2).tolist()
    rash = table.pace.model_copy(update={"factor": flipped})
    assert worst_slips(RULES.pace, rash)["gust_m_s2"] > 0.05
