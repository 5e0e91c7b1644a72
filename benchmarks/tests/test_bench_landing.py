"""The bench of random landings: those as built are the same flights, by vehicles that are not as told."""

from benchmarks.campaign.bench_landing import as_built_bars, random_bars
from benchmarks.campaign.landing_cases import as_built_landings, random_landings
from sitl.scenario.scenario import Scenario
from tests.unit.sitl.campaign.campaign_parts import row


def test_as_built_it_is_the_same_landing_by_a_vehicle_that_is_not_as_told() -> None:
    told, built = random_landings(6, 40).flights, as_built_landings(6, 40).flights
    for (believed, number), (wrong, seed) in zip(told, built, strict=True):
        assert seed == number
        usual, other = Scenario.model_validate(believed), Scenario.model_validate(wrong)
        assert (other.pad, other.wind, other.camera) == (usual.pad, usual.wind, usual.camera)
        assert other.companion == usual.companion
        assert usual.as_built is None
        assert (other.as_built is not None, other.mass_factor) == (True, 1.0)
    assert {Scenario.model_validate(content).autopilot for content, _ in built} == {"px4", "ardupilot"}


def test_one_contact_that_was_not_planned_fails_the_bars_though_all_landed() -> None:
    rows = [row("case", seed, lateral_m=0.01) for seed in range(100)]
    rows = [one.model_copy(update={"vertical_speed_m_s": 0.15}) for one in rows]
    touched = [rows[0].model_copy(update={"unplanned_contacts": 1}), *rows[1:]]
    for bars in (random_bars, as_built_bars):
        assert all(bar.holds for bar in bars(rows))
        assert [bar.name for bar in bars(touched) if not bar.holds] == [
            next(bar.name for bar in bars(rows) if "unplanned" in bar.name)
        ]
