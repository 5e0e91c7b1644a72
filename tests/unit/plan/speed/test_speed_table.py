from pathlib import Path

import numpy as np
import pytest
import yaml

from companion.config import CONFIG_FOLDER, ConfigError
from companion.plan.speed.fuzzy_rules import load_rules, mamdani
from companion.plan.speed.speed_table import SpeedTable, load_table, write_table

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


def test_rules_that_are_faster_when_closer_are_refused(tmp_path: Path) -> None:
    rules = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["rules"]
    rules["steady"]["near"] = ["fast", "fast", "fast"]
    with pytest.raises(ConfigError, match=r"mine\.yaml: rules: expected no more speed when closer"):
        load_table(edited(tmp_path, rules=rules))


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


def test_a_rule_for_an_unknown_speed_names_its_cell(tmp_path: Path) -> None:
    rules = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["rules"]
    rules["pushing"]["far"] = ["brisk", "warp", "slow"]
    with pytest.raises(ConfigError, match=r"rules\.pushing\.far: expected 3 of creep, slow"):
        load_table(edited(tmp_path, rules=rules))
    del rules["pushing"]["far"]
    with pytest.raises(ConfigError, match=r"rules\.pushing: expected a row for each of touching"):
        load_table(edited(tmp_path, rules=rules))


def test_rules_that_stand_still_or_back_away_are_refused(tmp_path: Path) -> None:
    speeds = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["speed_m_s"]
    slowest = min(speeds, key=lambda term: speeds[term])
    path = edited(tmp_path, speed_m_s=speeds | {slowest: [-0.4, -0.2, 0.0]})
    with pytest.raises(ConfigError, match=r"rules: expected at least 0.05 m/s, found -0.2"):
        load_table(path)


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


def test_a_gap_in_the_pace_is_said_with_its_place(tmp_path: Path) -> None:
    rules = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["pace"]
    del rules["gust_m_s2"]["breezy"], rules["rules"]["breezy"]
    rules["gust_m_s2"]["gusty"] = [0.9, 1.2, 2.4, 2.4]
    with pytest.raises(ConfigError, match=r"pace: gust_m_s2: no term covers 0.6 to 0.9"):
        load_table(edited(tmp_path, pace=rules))


def test_a_pace_that_stands_still_is_refused(tmp_path: Path) -> None:
    rules = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["pace"]
    rules["factor"]["slow"] = [0.0, 0.05, 0.1]
    with pytest.raises(ConfigError, match=r"rules: expected at least 0.05 m/s, found 0.0"):
        load_table(edited(tmp_path, pace=rules))
