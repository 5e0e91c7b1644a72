"""Innovation gates, and the timeline that puts late measurements in their place."""

import numpy as np
import pytest
from scipy.stats import chi2

from companion.estimate.gating import CHI_SQUARE_999, Gate, Timeline, fits, normalised_innovation_squared


class InputRecorder:
    """A filter whose state depends on the order of its inputs."""

    def __init__(self) -> None:
        self.state: tuple[tuple[float, str], ...] = ()
        self.applied = 0

    def snapshot(self) -> tuple[tuple[float, str], ...]:
        return self.state

    def restore(self, snapshot: tuple[tuple[float, str], ...]) -> None:
        self.state = snapshot

    def apply(self, time_s: float, item: str) -> None:
        self.applied += 1
        self.state = (*self.state, (time_s, item))


def test_bounds_are_the_999_permille_points_of_chi_square() -> None:
    for dof, bound in CHI_SQUARE_999.items():
        assert bound == pytest.approx(chi2.ppf(0.999, dof), abs=2e-3)


def test_normalised_innovation_weighs_by_the_covariance() -> None:
    assert normalised_innovation_squared(np.array([2.0, 3.0]), np.diag([4.0, 9.0])) == pytest.approx(2.0)


@pytest.mark.parametrize("axes", [2, 3, 4])
def test_an_innovation_fits_up_to_the_bound_of_its_number_of_axes(axes: int) -> None:
    rng = np.random.default_rng(axes)
    for _ in range(20):
        root, direction = rng.standard_normal((axes, axes)), rng.standard_normal(axes)
        covariance = root @ root.T + 0.1 * np.eye(axes)
        size = np.sqrt(CHI_SQUARE_999[axes] / normalised_innovation_squared(direction, covariance))
        assert fits(0.999 * size * direction, covariance)
        assert not fits(1.001 * size * direction, covariance)


def test_gate_counts_and_forgives_after_one_that_fits() -> None:
    gate = Gate().after(False, 1.0).after(False, 1.4)
    assert (gate.accepted, gate.refused, gate.refused_in_a_row, gate.refused_since_s) == (0, 2, 2, 1.0)
    assert gate.after(True, 1.5) == Gate(accepted=1, refused=2)


def test_gate_is_shut_out_only_after_enough_time_and_enough_refusals() -> None:
    gate = Gate().after(False, 1.0).after(False, 1.3).after(False, 1.5)
    assert gate.shut_out(1.5, timeout_s=0.5)
    assert not gate.shut_out(1.49, timeout_s=0.5)
    assert not Gate().after(False, 1.0).after(False, 3.0).shut_out(3.0, timeout_s=0.5)


def test_no_measurement_is_refused_while_none_comes() -> None:
    """As a fix that is off just before an outage, and two just after it."""
    gate = Gate().after(False, 1.0)
    for time_s in (21.0, 21.2, 21.4, 21.6):
        gate = gate.after(False, time_s)
        assert not gate.shut_out(time_s, timeout_s=2.0)
    assert gate.after(False, 21.8).shut_out(21.8, timeout_s=2.0)


@pytest.mark.parametrize("interval_s", [0.25, 1.0, 5.0])
def test_few_refusals_that_come_evenly_are_enough_however_slow(interval_s: float) -> None:
    gate = Gate().after(False, 0.0).after(False, interval_s)
    assert not gate.shut_out(interval_s, timeout_s=0.5)
    assert gate.after(False, 2.0 * interval_s).shut_out(2.0 * interval_s, timeout_s=0.5)


def test_late_input_is_applied_at_its_own_time() -> None:
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=10.0)
    for time_s, item in ((1.0, "a"), (2.0, "b"), (4.0, "d"), (3.0, "c"), (2.0, "b2")):
        assert timeline.add(time_s, item)
    assert recorder.state == ((1.0, "a"), (2.0, "b"), (2.0, "b2"), (3.0, "c"), (4.0, "d"))


def test_only_what_is_newer_than_a_late_input_is_replayed() -> None:
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=10.0)
    for k in range(10):
        timeline.add(float(k), "on time")
    before = recorder.applied
    timeline.add(7.5, "late")
    assert recorder.applied - before == 3


def test_input_older_than_all_that_is_remembered_is_refused() -> None:
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=1.0)
    for k in range(50):
        timeline.add(0.1 * k, "x")
    state = recorder.state
    assert not timeline.add(3.0, "too late")
    assert recorder.state == state
    assert timeline.add(0.1 * 49 - 1.0, "just in time")


def test_state_as_of_a_time_is_the_one_after_the_last_input_before_it() -> None:
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=10.0)
    assert timeline.as_of(5.0) is None
    timeline.add(1.0, "a")
    timeline.add(2.0, "b")
    assert timeline.as_of(0.5) is None
    assert timeline.as_of(1.5) == ((1.0, "a"),)
    assert timeline.as_of(9.0) == ((1.0, "a"), (2.0, "b"))


@pytest.mark.parametrize("since_s", [0.0, 2.0, 2.5, 9.0])
def test_inputs_since_a_time_are_replaced(since_s: float) -> None:
    """Those before stay, be there any; and a late one still finds its place."""
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=10.0)
    for k in range(1, 5):
        timeline.add(float(k), f"old {k}")
    kept = [(float(k), f"old {k}") for k in range(1, 5) if k < since_s]
    new = [(since_s + k, f"new {k}") for k in range(3)]
    timeline.replace(since_s, new)
    assert recorder.state == (*kept, *new)
    assert timeline.as_of(since_s + 1.5) == (*kept, *new[:2])
    timeline.add(since_s + 0.5, "late")
    assert recorder.state == (*kept, new[0], (since_s + 0.5, "late"), *new[1:])


def test_inputs_may_be_replaced_by_none() -> None:
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=10.0)
    timeline.add(1.0, "stays")
    timeline.add(2.0, "goes")
    timeline.replace(1.5, [])
    assert recorder.state == ((1.0, "stays"),)
    assert timeline.as_of(3.0) == recorder.state


def test_when_all_that_is_remembered_is_replaced_what_was_before_it_stays() -> None:
    recorder = InputRecorder()
    timeline = Timeline(recorder, span_s=1.0)
    for k in range(5):
        timeline.add(float(k), f"old {k}")
    timeline.replace(0.0, [(4.0, "new")])
    assert recorder.state == ((0.0, "old 0"), (1.0, "old 1"), (2.0, "old 2"), (4.0, "new"))
