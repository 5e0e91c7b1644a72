"""Wind: directions, the standard's variances and spectra, gusts."""

import math

import numpy as np
import pytest

from sitl.world.wind import (
    FADE_HEIGHT_M,
    FOOT_M,
    KNOT_M_S,
    TURBULENCE_STEP_S,
    W20_M_S,
    DiscreteGust,
    DrydenTurbulence,
    GustSettings,
    Wind,
    WindSettings,
    shear,
)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    ("from_deg", "towards"),
    [(0.0, (-4.0, 0.0)), (90.0, (0.0, -4.0)), (180.0, (4.0, 0.0)), (270.0, (0.0, 4.0))],
)
def test_blows_from_where_it_is_said_to(from_deg: float, towards: tuple[float, float]) -> None:
    wind = Wind(WindSettings(mean_m_s=4.0, from_deg=from_deg), rng())
    assert wind.at(3.0, 20 * FOOT_M) == pytest.approx((*towards, 0.0), abs=1e-9)


@pytest.mark.parametrize(("height", "share"), [(6.096, 1.0), (3.0, 0.855), (1.0, 0.631), (0.5, 0.489)])
def test_the_wind_is_weaker_near_the_ground(height: float, share: float) -> None:
    assert shear(height) == pytest.approx(share, abs=0.001)
    wind = Wind(WindSettings(mean_m_s=10.0, from_deg=180.0), rng())
    assert wind.at(0.0, height)[0] == pytest.approx(10.0 * share, abs=0.01)
    # the profile ends before the logarithm does
    assert shear(0.0) == shear(-1.0) == shear(0.3) > 0.3


def test_turbulence_has_the_standards_variance_from_the_first_sample_on_and_the_drydens_memory() -> None:
    field, lag, generator = DrydenTurbulence(10.0, 8.0, rng()), 40, rng(7)
    expected = (field.std_horizontal_m_s, field.std_horizontal_m_s, field.std_vertical_m_s)
    assert field.std_vertical_m_s == pytest.approx(1.0)
    assert field.std_horizontal_m_s == pytest.approx(1.93, abs=0.01)  # 0.1935 ** -0.4
    walks = []
    for _ in range(3000):
        independent = DrydenTurbulence(10.0, 8.0, generator)
        walk = [independent.step() for _ in range(1 + lag)]
        walks.append((walk[0], walk[lag]))
    samples = np.array(walks)
    # the estimate's own deviation is 1.3 %
    np.testing.assert_allclose(samples.std(axis=0), np.array([expected, expected]), rtol=0.05)
    # correlation after tau: exp(-tau / T) along the wind; exp(-tau / T) (1 - tau / 2T) across it
    correlation = [np.corrcoef(samples[:, 0, i], samples[:, 1, i])[0, 1] for i in range(3)]
    tau = lag * TURBULENCE_STEP_S
    along = math.exp(-tau / field.time_horizontal_s)
    across = along * (1.0 - 0.5 * tau / field.time_horizontal_s)
    vertical = math.exp(-tau / field.time_vertical_s) * (1.0 - 0.5 * tau / field.time_vertical_s)
    np.testing.assert_allclose(correlation, [along, across, vertical], atol=0.05)
    assert field.time_horizontal_s * 8.0 == pytest.approx(43.7, abs=0.3)
    assert field.time_vertical_s * 8.0 == pytest.approx(6.1, abs=0.05)


def test_turbulence_is_continuous_between_its_samples_and_goes_not_through_the_surface() -> None:
    wind = Wind(WindSettings(mean_m_s=5.0, turbulence="moderate"), rng())
    series = np.array([wind.at(0.0025 * i, 10.0) for i in range(4000)])
    assert np.abs(np.diff(series, axis=0)).max() < 0.15
    assert series.std(axis=0).min() > 0.2
    assert {wind.at(10.0 + 0.02 * i, 0.0)[2] for i in range(200)} == {0.0}
    assert abs(wind.at(14.0, FADE_HEIGHT_M)[2]) > 0.0


def test_gusts_reach_their_amplitude_smoothly_and_leave_calm_between() -> None:
    settings = WindSettings(
        from_deg=180.0, gusts=GustSettings(amplitude_m_s=4.0, duration_s=2.0, interval_s=5.0, spread_deg=0.0)
    )
    wind = Wind(settings, rng())
    north = np.array([wind.at(0.01 * i, 20 * FOOT_M)[0] for i in range(6000)])
    assert north.max() == pytest.approx(4.0, abs=0.01)
    assert north.min() >= 0.0
    assert np.abs(np.diff(north)).max() < 4.0 * math.pi / 2.0 * 0.01 * 1.01
    assert 0.5 < (north == 0.0).mean() < 0.9


def test_gusts_blow_within_their_spread() -> None:
    settings = WindSettings(from_deg=180.0, gusts=GustSettings(amplitude_m_s=4.0, spread_deg=30.0))
    wind = Wind(settings, rng(3))
    blown = [wind.at(0.1 * i, 5.0) for i in range(3000)]
    bearings = [math.degrees(math.atan2(e, n)) for n, e, _ in blown if math.hypot(n, e) > 0.1]
    assert max(map(abs, bearings)) <= 30.0
    assert max(bearings) > 10.0
    assert min(bearings) < -10.0


def test_a_seed_gives_one_wind_and_another_seed_another() -> None:
    settings = WindSettings(mean_m_s=3.0, turbulence="light", gusts=GustSettings(amplitude_m_s=3.0))

    def blown(seed: int) -> list[tuple[float, float, float]]:
        wind = Wind(settings, rng(seed))
        return [wind.at(0.02 * i, 5.0) for i in range(500)]

    assert blown(5) == blown(5)
    assert blown(5) != blown(6)


def test_light_moderate_and_severe_are_the_standards_winds_at_twenty_feet() -> None:
    assert pytest.approx(0.514444, abs=1e-6) == KNOT_M_S
    assert {name: w20 / KNOT_M_S for name, w20 in W20_M_S.items()} == pytest.approx(
        {"none": 0.0, "light": 15.0, "moderate": 30.0, "severe": 45.0}
    )
    spreads = []
    for name in ("light", "moderate", "severe"):
        wind = Wind(WindSettings(turbulence=name, mean_m_s=8.0, from_deg=180.0), rng(3))
        spreads.append(float(np.std([wind.at(0.1 * i, 6.0)[2] for i in range(6000)])))
    # vertical: a tenth of the wind at 20 ft
    assert spreads == pytest.approx([0.772, 1.543, 2.315], rel=0.12)


def gusty(**values: object) -> Wind:
    gust = DiscreteGust.model_validate({"at_s": 10.0, "amplitude_m_s": 6.0, "duration_s": 4.0, **values})
    return Wind(WindSettings(mean_m_s=2.0, from_deg=180.0, gust=gust), rng())


def test_a_gust_comes_at_its_time_and_once_or_again_and_from_elsewhere() -> None:
    once, again = gusty(), gusty(every_s=10.0, from_deg=90.0)
    speeds = [once.at(t, 20 * FOOT_M)[0] for t in (9.9, 11.0, 12.0, 13.0, 14.1, 40.0)]
    assert speeds == pytest.approx([2.0, 5.0, 8.0, 5.0, 2.0, 2.0])
    speeds = [again.at(t, 20 * FOOT_M)[1] for t in (5.0, 12.0, 22.0, 27.0, 32.0)]
    assert speeds == pytest.approx([0.0, -6.0, -6.0, 0.0, -6.0], abs=1e-9)
    with pytest.raises(ValueError, match="at least duration_s"):
        gusty(every_s=2.0)
