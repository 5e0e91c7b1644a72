"""Fig. 13: the errors of made-up tracks come out as they were put in."""

from pathlib import Path

import numpy as np
import pytest

from companion.base.geometry import Vector3, add
from companion.config import ConfigError
from experiments import fig13
from experiments.flown import EndedFlight
from experiments.tests.experiment_flights import fix, result, state, truth

FAR_ORIGIN = (40.0, -30.0, 2.0)


def _path(time_s: float) -> Vector3:
    return (2.0 * time_s, 0.5 * time_s, -5.0)


def _flown(gps_noise_m: float, ekf_noise_m: float, offset: Vector3 = (1.0, 0.0, 0.0)) -> EndedFlight:
    """20 s in the air; the fixes jump by their noise from one to the next, the EKF is off by an offset."""
    times = np.arange(0.0, 20.0, 0.05).tolist()
    records = [truth(t, _path(t)) for t in times]
    landed = truth(20.0, _path(20.0), touching=True)
    fixes = [
        fix(t, add(_path(t), (gps_noise_m * (-1.0) ** k, 0.3, 0.2)))
        for k, t in enumerate(np.arange(0.0, 20.0, 0.2).tolist())
    ]
    estimates = [
        state(t, add(add(_path(t), offset), (ekf_noise_m * (-1.0) ** (k // 4), 0.0, 0.0)), FAR_ORIGIN)
        for k, t in enumerate(times)
    ]
    return EndedFlight(
        result(),
        [truth(-1.0, _path(0.0), touching=True), *records, landed],
        {"gps": fixes, "vehicle": estimates},
    )


def test_errors_come_out_whatever_the_filters_origin() -> None:
    observed = fig13.observe(_flown(0.4, 0.0))
    assert observed.gps.rmse_m() == pytest.approx((0.4, 0.3, 0.2), abs=0.01)
    assert observed.ekf.rmse_m() == pytest.approx((1.0, 0.0, 0.0), abs=0.01)
    assert observed.ekf.worst_m() == pytest.approx((1.0, 0.0, 0.0), abs=0.01)


def test_an_offset_is_neither_path_nor_noise() -> None:
    observed = fig13.observe(_flown(0.4, 0.0))
    fixes_s = observed.gps.time_s
    assert observed.gps.noise_m(fixes_s)[0] == pytest.approx(0.8, abs=0.02)
    assert observed.ekf.noise_m(fixes_s)[0] == pytest.approx(0.0, abs=0.01)
    assert observed.gps.path_m() == pytest.approx((0.4, 0.0, 0.0), abs=0.01)
    assert observed.ekf.path_m() == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


def test_an_observer_that_shakes_with_the_fixes_fails() -> None:
    assert not fig13.observe(_flown(0.4, 0.39)).holds()


def test_only_the_flight_counts() -> None:
    flown = _flown(0.4, 0.0)
    late = [*flown.kept["gps"], fix(25.0, (900.0, 0.0, 0.0))]
    observed = fig13.observe(EndedFlight(flown.result, flown.truth, {**flown.kept, "gps": late}))
    assert observed.gps.time_s.max() < 20.0
    with pytest.raises(ConfigError, match="never got into the air"):
        fig13.observe(EndedFlight(flown.result, flown.truth[:1], flown.kept))


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    fig13.draw(fig13.observe(_flown(0.4, 0.01)), tmp_path / "fig13.png")
    assert (tmp_path / "fig13.png").read_bytes().startswith(b"\x89PNG")
