"""The speed laws that the settings choose among."""

from dataclasses import replace

import numpy as np
import pytest

from companion.base.messages import Conditions
from companion.config import ConfigError, PlanConfig
from companion.plan.speed.laws import LogPolynomial, by_conditions, load_speed_controller, load_speed_law
from companion.plan.speed.speed_table import SpeedTable, load_table

TABLE = load_table("landing")[0]


def _law(name: str, **changes: object) -> PlanConfig:
    return PlanConfig.model_validate({"speed_law": name, **changes})


def test_the_fuzzy_pilot_flies_unless_set_otherwise() -> None:
    law = load_speed_law(PlanConfig())
    assert isinstance(law, SpeedTable)
    assert law == TABLE


def test_a_fixed_speed_knows_no_distance() -> None:
    law = load_speed_law(_law("fixed", fixed_speed_m_s=1.2))
    assert {law(d, v, a) for d in (0.0, 5.0, 50.0) for v in (-1.0, 2.0) for a in (-1.0, 1.0)} == {1.2}


def test_a_fixed_speed_needs_no_rules() -> None:
    load_speed_law(_law("fixed", fuzzy="nobody"))
    with pytest.raises(ConfigError, match="nobody"):
        load_speed_law(_law("log_polynomial", fuzzy="nobody"))


def test_the_log_polynomial_follows_the_pilot_at_rest_and_nothing_else() -> None:
    law = load_speed_law(_law("log_polynomial"))
    for distance in np.linspace(0.0, 8.0, 33).tolist():
        assert law(distance, 0.0, 0.0) == pytest.approx(TABLE(distance, 0.0, 0.0), abs=0.06)
        assert law(distance, 1.4, 1.0) == law(distance, -1.0, -1.0)


def test_the_log_polynomial_is_never_faster_when_closer_and_holds_its_ends() -> None:
    law = LogPolynomial(TABLE)
    speeds = [law(d, 0.0, 0.0) for d in np.linspace(0.0, 12.0, 241).tolist()]
    assert min(np.diff(speeds)) >= -1e-9
    assert law(1e6, 0.0, 0.0) == law(8.0, 0.0, 0.0)
    assert law(-1.0, 0.0, 0.0) == law(0.0, 0.0, 0.0) > 0.2


def test_its_coefficients_are_those_of_the_logarithm() -> None:
    c = LogPolynomial(TABLE).coefficients
    length = np.log1p(3.0)
    expected = c[0] + c[1] * length + c[2] * length**2 + c[3] * length**3
    assert LogPolynomial(TABLE)(3.0, 0.0, 0.0) == pytest.approx(expected)


def test_only_the_fuzzy_pilot_looks_at_the_conditions_and_only_if_asked() -> None:
    storm = Conditions(sight_rad=0.2, relative_speed_m_s=3.0, gust_m_s2=3.0)
    assert load_speed_controller(PlanConfig(pace=True)).pace(storm) == pytest.approx(0.5, abs=0.01)
    assert load_speed_controller(PlanConfig()).pace(storm) == 1.0
    for name in ("fixed", "log_polynomial"):
        assert load_speed_controller(_law(name, pace=True)).pace(storm) == 1.0


def test_rules_without_a_pace_come_in_alike_in_all_conditions() -> None:
    assert by_conditions(replace(TABLE, pace=None))(Conditions(0.2, 3.0, 3.0)) == 1.0
