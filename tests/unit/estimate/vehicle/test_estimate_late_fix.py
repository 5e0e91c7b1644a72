"""A late fix of the 31-state EKF: what it changes is carried over what is newer, or that is taken again."""

import math
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, ZERO3
from companion.config import EkfConfig
from companion.estimate.gating import Timeline
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import EkfInput, GpsStep, ImuStep
from companion.estimate.vehicle.ekf_start import InitialState
from tests.unit.estimate.at_rest import DOWN_FORCE

STD_M, STD_M_S = (3.0, 3.0, 4.5), (0.15, 0.15, 0.2)
FIX = GpsStep((0.3, 0.2, 0.1), (0.1, 0.0, -0.05), STD_M, STD_M_S)
FAR = GpsStep((80.0, 0.2, 0.1), (9.0, 0.0, 0.0), STD_M, STD_M_S)


class Counting(VehicleEkf):
    """Counts what it takes in."""

    taken = 0

    def apply(self, time_s: float, item: EkfInput) -> None:
        """See `VehicleEkf`."""
        self.taken += 1
        super().apply(time_s, item)


def new_ekf() -> Counting:
    tilt, heading = math.radians(2.0), math.radians(4.0)
    start = InitialState(0.0, IDENTITY, ZERO3, (20.9, 0.6, 42.9), tilt, heading, 5e-4)
    return Counting(EkfConfig(), ZERO3, start)


def hovered(*late: tuple[float, GpsStep], fixes: bool = True, until_s: float = 2.0) -> Counting:
    """Two seconds of hover with a fix every 0.2 s until 1.8 s; the late ones come after all that."""
    ekf = new_ekf()
    timeline: Timeline[Any, Any] = Timeline(ekf, 0.6, ekf.carried)
    for k in range(1, round(until_s / 0.02) + 1):
        t = 0.02 * k
        timeline.add(t, ImuStep(ZERO3, DOWN_FORCE, 4))
        if fixes and k % 10 == 0 and k <= 90:
            timeline.add(t, FIX)
    ekf.taken = 0
    for time_s, fix in late:
        timeline.add(time_s, fix)
    return ekf


def on_time(time_s: float) -> Counting:
    """The same with one fix more, in its turn."""
    ekf = new_ekf()
    for k in range(1, 101):
        ekf.apply(0.02 * k, ImuStep(ZERO3, DOWN_FORCE, 4))
        if k % 10 == 0 and k <= 90:
            ekf.apply(0.02 * k, FIX)
        if 0.02 * k <= time_s < 0.02 * (k + 1):
            ekf.apply(time_s, FIX)
    return ekf


def test_a_late_fix_is_taken_once_and_changes_what_it_would_have_changed_on_time() -> None:
    late, prompt = hovered((1.85, FIX)), on_time(1.85)
    assert late.taken == 1
    std = np.sqrt(prompt.P.diagonal())
    assert np.abs((late.x - prompt.x) / std).max() < 0.02
    assert np.sqrt(late.P.diagonal()) / std == pytest.approx(1.0, abs=1e-3)
    assert late.gates == prompt.gates
    assert late.fix_watch.excess == pytest.approx(prompt.fix_watch.excess)
    assert (late.gps_time_s, late.time_s) == (prompt.gps_time_s, prompt.time_s)


def test_the_states_between_are_put_right_too() -> None:
    """A second late fix, older than the newest step, starts from what the first has left there."""
    late = hovered((1.83, FIX), (1.91, FIX))
    assert late.taken == 2
    assert late.gates["gps_velocity"].accepted == on_time(1.83).gates["gps_velocity"].accepted + 1
    assert np.linalg.eigvalsh(late.P).min() > 0.0


def test_a_late_fix_that_is_refused_changes_nothing_but_the_record() -> None:
    late, before = hovered((1.85, FAR)), hovered()
    assert late.gates["gps_velocity"].refused_in_a_row == 1
    assert np.array_equal(late.x, before.x)
    assert np.array_equal(late.P, before.P)


def test_all_that_is_newer_is_taken_again_after_a_late_first_fix() -> None:
    late = hovered((1.85, FIX), fixes=False)
    assert late.has_position
    assert late.taken == 1 + 8


def test_all_that_is_newer_is_taken_again_when_there_is_a_newer_fix() -> None:
    late = hovered((1.70, FIX))
    assert late.taken > 10
    assert late.gates["gps_velocity"].accepted == 9
