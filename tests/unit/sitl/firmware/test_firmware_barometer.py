"""The barometer that PX4 is told of: the standard atmosphere, noise, wander, and how often."""

import numpy as np
import pytest

from sitl.firmware.px4 import NOISE_M, PERIOD_S, WANDER_M, Barometer
from sitl.mavlink.sensor_telemetry import pressure_hpa


@pytest.mark.parametrize(
    ("altitude_m", "hpa"), [(-500.0, 1074.8), (0.0, 1013.25), (400.0, 966.1), (5000.0, 540.2)]
)
def test_pressure_is_that_of_the_standard_atmosphere(altitude_m: float, hpa: float) -> None:
    assert pressure_hpa(altitude_m) == pytest.approx(hpa, abs=0.1)


def test_a_metre_up_is_an_eighth_of_a_hectopascal_less() -> None:
    assert pressure_hpa(1.0) - pressure_hpa(0.0) == pytest.approx(-0.12, abs=0.005)


@pytest.mark.parametrize("step_s", [1 / 400, 1 / 250, 0.003])
def test_it_reads_at_its_own_rate_whatever_the_steps(step_s: float) -> None:
    barometer = Barometer(np.random.default_rng(0))
    times = [n * step_s for n in range(round(10.0 / step_s)) if barometer.read(n * step_s, 0.0) is not None]
    assert len(times) == pytest.approx(10.0 / PERIOD_S, abs=2)
    assert np.diff(times) == pytest.approx(PERIOD_S, abs=step_s + 1e-9)


def test_after_a_pause_it_makes_up_for_nothing() -> None:
    barometer = Barometer(np.random.default_rng(0))
    read = [barometer.read(at_s, 0.0) is not None for at_s in (0.0, 5.0, 5.0025, 5.01, 5.02)]
    assert read == [True, True, False, False, True]


def test_noise_is_white_and_the_wander_slow() -> None:
    barometer = Barometer(np.random.default_rng(0))
    read = [barometer.read(n * PERIOD_S, 100.0) for n in range(100_000)]
    errors = np.array([height_m for height_m in read if height_m is not None]) - 100.0
    assert np.std(np.diff(errors)) == pytest.approx(np.sqrt(2.0) * NOISE_M, rel=0.05)
    assert np.std(errors) == pytest.approx(np.hypot(NOISE_M, WANDER_M), rel=0.3)
    assert np.mean(errors) == pytest.approx(0.0, abs=WANDER_M)


def test_one_seed_is_one_barometer() -> None:
    one, same, other = (Barometer(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one.read(0.0, 0.0) == same.read(0.0, 0.0) != other.read(0.0, 0.0)
