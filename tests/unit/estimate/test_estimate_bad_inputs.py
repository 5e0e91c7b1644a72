"""Inputs that are wrong, not missing: GPS that is noisy or hangs, gaps of the IMU, a shaken accelerometer."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import (
    ZERO3,
    Vector3,
    add,
    quat_conjugate,
    quat_multiply,
    rotation_vector_from_quat,
    vector3,
)
from companion.base.messages import GpsFix, ImuSample, MagSample, PadSighting
from companion.config import EkfConfig
from companion.estimate.estimator import StateEstimator
from companion.estimate.vehicle.fix_watch import FixWatch
from companion.estimate.vehicle.imu_noise import ImuNoise
from tests.unit.estimate.estimate_flight import EstimateFlight, circle, feed, new_estimator

FLOWN = EstimateFlight(path=circle(8.0, 4.0), duration_s=36.0)
FROM_S = 20.0
Change = Callable[[object], object | None]


def attitude_errors_deg(change: Change) -> dict[float, Vector3]:
    """Errors about NED axes by time, where there is a state."""
    estimator, errors, due_s = new_estimator(), {}, FROM_S
    for arrival_s, sample in FLOWN.samples:
        changed = change(sample)
        if changed is not None:
            feed(estimator, changed)  # type: ignore[arg-type]
        if arrival_s >= due_s:
            due_s += 0.1
            state = estimator.vehicle(arrival_s)
            if state is not None and state.aligned:
                off = quat_multiply(state.attitude, quat_conjugate(FLOWN.attitude(arrival_s)))
                errors[arrival_s] = vector3(np.degrees(rotation_vector_from_quat(off)))
    return errors


def worst_tilt_deg(errors: dict[float, Vector3]) -> float:
    return max(math.hypot(north, east) for north, east, _ in errors.values())


def noisy(std_m_s: float, claimed_m_s: float) -> Change:
    rng = np.random.default_rng(5)

    def change(sample: object) -> object:
        if not isinstance(sample, GpsFix):
            return sample
        noise = vector3(std_m_s * rng.standard_normal(3))
        return replace(
            sample, velocity_ned_m_s=add(sample.velocity_ned_m_s, noise), speed_accuracy_m_s=claimed_m_s
        )

    return change


@pytest.mark.parametrize(("std_m_s", "claimed_m_s"), [(0.29, 0.5), (1.0, 1.0), (0.3, 0.15)])
def test_a_noisy_gps_does_not_turn_the_attitude(std_m_s: float, claimed_m_s: float) -> None:
    assert worst_tilt_deg(attitude_errors_deg(noisy(std_m_s, claimed_m_s))) < 2.5


def test_a_gps_that_hangs_does_not_turn_the_attitude() -> None:
    last: list[GpsFix] = []

    def hung(sample: object) -> object:
        if isinstance(sample, GpsFix):
            if sample.time_s > 22.0 and last:
                return replace(last[0], time_s=sample.time_s, velocity_ned_m_s=(0.0, 0.0, 0.0))
            last[:] = [sample]
        return sample

    assert worst_tilt_deg(attitude_errors_deg(hung)) < 2.0


def gap(seconds: float) -> Change:
    def change(sample: object) -> object | None:
        inertial = isinstance(sample, ImuSample | MagSample)
        return None if inertial and 24.0 <= sample.time_s < 24.0 + seconds else sample  # type: ignore[attr-defined]

    return change


def test_a_gap_of_a_blink_costs_little() -> None:
    assert worst_tilt_deg(attitude_errors_deg(gap(0.15))) < 2.0


def test_as_a_gap_lasts_the_velocity_is_known_less_well_and_not_only_at_its_end() -> None:
    estimator, stated_m_s = new_estimator(), {}
    for arrival_s, sample in FLOWN.samples:
        changed = gap(0.6)(sample)
        if changed is not None:
            feed(estimator, changed)  # type: ignore[arg-type]
        state = estimator.vehicle(arrival_s) if 23.9 < arrival_s < 24.7 else None
        if state is not None and changed is not None:
            stated_m_s[arrival_s] = state.velocity_std_m_s
        if arrival_s > 24.7:
            break
    before, early, late = (
        max(std for time_s, std in stated_m_s.items() if start_s < time_s < end_s)
        for start_s, end_s in ((23.9, 24.0), (24.2, 24.35), (24.45, 24.6))
    )
    ended = next(std for time_s, std in stated_m_s.items() if time_s >= 24.6)
    assert early > 3.0 * before
    assert late > 2.0 * early
    assert ended == pytest.approx(late, rel=0.25), "as the Kalman filter has it at the end"


def test_after_a_long_gap_nothing_is_said_until_it_is_known_again() -> None:
    errors = attitude_errors_deg(gap(3.0))
    again = {time_s: error for time_s, error in errors.items() if time_s > 25.5}
    assert 28.9 < min(again) < 30.0, "in motion it takes the time of a rest"
    assert worst_tilt_deg(again) < 5.0
    assert max(abs(heading) for _, _, heading in again.values()) < 15.0


@pytest.mark.parametrize(
    ("rate", "force"), [((1e8, 0.0, 0.0), (0.0, 0.0, -9.8)), ((0.0, 0.0, 0.0), (0.0, 1e8, -9.8))]
)
def test_a_reading_no_sensor_can_give_is_refused(rate: Vector3, force: Vector3) -> None:
    estimator = new_estimator()
    assert not estimator.add_imu(ImuSample(0.1, rate, force, 25.0))
    assert estimator.add_imu(ImuSample(0.2, (0.0, 0.0, 30.0), (0.0, 0.0, -150.0), 25.0))


def poisoned_beside_clean(
    from_s: float, until_s: float, poison: Callable[[StateEstimator, float], None]
) -> tuple[StateEstimator, StateEstimator]:
    """Two estimators after 12 s; one is poisoned at each IMU sample of a time, and answers all the same."""
    clean, poisoned = new_estimator(), new_estimator()
    for arrival_s, sample in FLOWN.samples:
        if arrival_s >= 12.0:
            break
        feed(clean, sample)
        feed(poisoned, sample)
        if from_s <= arrival_s < until_s and isinstance(sample, ImuSample):
            poison(poisoned, arrival_s)
    assert poisoned.vehicle(12.0) == clean.vehicle(12.0)
    assert poisoned.vehicle(12.0) is not None
    return poisoned, clean


@pytest.mark.parametrize("ahead_s", [3.0, 100.0, 3600.0, 1e9])
def test_one_stamp_from_the_future_is_refused_and_costs_nothing_else(ahead_s: float) -> None:
    def poison(estimator: StateEstimator, arrival_s: float) -> None:
        assert not estimator.add_imu(ImuSample(arrival_s + ahead_s, ZERO3, (0.0, 0.0, -9.8), 25.0))

    poisoned, clean = poisoned_beside_clean(10.0, 12.0, poison)
    assert poisoned.refused["imu_unusable"] > clean.refused.get("imu_unusable", 0)


@pytest.mark.parametrize("ahead_s", [0.2, 3.0, 3600.0])
def test_stamps_that_agree_on_a_time_after_their_receipt_are_not_believed_either(ahead_s: float) -> None:
    def poison(estimator: StateEstimator, arrival_s: float) -> None:
        for k in range(3):
            wrong = ImuSample(arrival_s + ahead_s + 0.001 * k, ZERO3, (0.0, 0.0, -9.8), 25.0)
            assert not estimator.add_imu(wrong, arrival_s)

    poisoned_beside_clean(10.0, 10.1, poison)


def test_the_very_first_stamp_may_be_the_wrong_one() -> None:
    estimator = new_estimator()
    assert estimator.add_imu(ImuSample(3600.0, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 25.0))
    for arrival_s, sample in FLOWN.samples:
        if arrival_s < 10.0:
            feed(estimator, sample)
    assert estimator.vehicle(10.0) is not None


def test_an_imu_that_is_back_after_long_is_believed_from_its_second_sample_on() -> None:
    estimator = new_estimator()
    for arrival_s, sample in FLOWN.samples:
        if arrival_s < 10.0:
            feed(estimator, sample)
    taken = [
        estimator.add_imu(ImuSample(time_s, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 25.0))
        for time_s in (15.0, 15.005, 15.010)
    ]
    assert taken == [False, True, True]


# ------------------------------------------------------------ the watch over fixes


def watched(innovations: list[Vector3], test: float, refused: int = 0) -> bool:
    watch = FixWatch()
    for innovation in innovations:
        watch = watch.after(innovation, test)
    return watch.suspicious(10.0, refused)


def test_only_an_excess_that_lasts_in_one_direction_is_suspicious() -> None:
    one_way = [(0.5, 0.1, 0.0)] * 12
    to_and_fro = [(0.5, 0.1, 0.0), (-0.5, -0.1, 0.0)] * 6
    assert watched(one_way, test=8.0)
    assert not watched(to_and_fro, test=8.0)
    assert not watched(one_way, test=3.0)
    assert not watched(one_way, test=8.0, refused=8)


def test_one_suspicion_has_time_to_take_effect() -> None:
    watch = FixWatch()
    for _ in range(12):
        watch = watch.after((0.5, 0.0, 0.0), 8.0)
    watch = watch.suspected(10.0)
    for _ in range(12):
        watch = watch.after((0.5, 0.0, 0.0), 8.0)
    assert not watch.suspicious(12.0, 0)
    assert watch.suspicious(13.0, 0)


# ------------------------------------------------------------ shaking


def shaken(std_m_s2: float, motion_m_s2: Callable[[float], float]) -> float:
    rng, shaking = np.random.default_rng(1), ImuNoise(EkfConfig(shaking_bound_m_s2=2.0))
    for k in range(400):
        noise = std_m_s2 * rng.standard_normal(3)
        shaking.add(ZERO3, vector3(noise + np.array([motion_m_s2(0.005 * k), 0.0, -9.8])), 0.005)
    return shaking.now.force_error_m_s2


def test_shaking_beyond_the_bound_is_doubted_by_its_excess() -> None:
    assert shaken(0.6, lambda t: 0.0) == 0.0
    # three axes together, less the bound, times the share
    assert shaken(2.5, lambda t: 0.0) == pytest.approx(0.5 * (2.5 * math.sqrt(3.0) - 2.0), rel=0.3)


def test_a_motion_of_the_vehicle_is_no_shaking() -> None:
    assert shaken(0.1, lambda t: 8.0 * math.sin(2.0 * math.pi * 2.0 * t)) == 0.0


def test_fixes_that_scatter_more_than_claimed_count_for_less() -> None:
    calm, wild = FixWatch(), FixWatch()
    for k in range(40):
        side = 1.0 if k % 2 else -1.0
        calm, wild = calm.after((side * 0.1, 0.0, 0.0), 0.8), wild.after((side * 0.5, 0.0, 0.0), 6.0)
    assert calm.noise_factor == 1.0
    assert wild.noise_factor == pytest.approx(6.0, rel=0.1)


def test_a_field_of_the_wrong_size_is_counted_as_refused() -> None:
    estimator = new_estimator()
    for arrival_s, sample in FLOWN.samples:
        if arrival_s > 12.0:
            break
        beside_iron = isinstance(sample, MagSample) and arrival_s > 10.0
        feed(estimator, MagSample(sample.time_s, (60.0, 0.0, 60.0)) if beside_iron else sample)
    assert estimator.refused["field_gate"] > 50


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["position_ned_m", "velocity_ned_m_s", "attitude", "rate_body_rad_s"])
def test_a_state_that_is_no_number_is_no_state(
    name: str, wrong: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimator = new_estimator()
    for arrival_s, sample in FLOWN.samples:
        if arrival_s < FROM_S:
            feed(estimator, sample)
    state = estimator.vehicle(FROM_S)
    assert state is not None
    spoilt = replace(state, **{name: (wrong, *getattr(state, name)[1:])})  # type: ignore[arg-type]
    monkeypatch.setattr(estimator._vehicle, "state", lambda *_times: spoilt)
    assert estimator.vehicle(FROM_S) is None


@pytest.mark.parametrize(
    ("place", "variance_m2"), [(0, 9.0), (3, 9.0), (8, 9.0), (None, -9.0), (None, math.nan)]
)
def test_a_pad_that_is_nowhere_is_none_to_fly_to_or_to_look_for(
    place: int | None, variance_m2: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimator = new_estimator()
    for arrival_s, sample in FLOWN.samples:
        if arrival_s < 12.0:
            feed(estimator, sample)
    snapshot = estimator._pad.snapshot()._replace(seen_time_s=12.0)
    monkeypatch.setattr(estimator._timeline, "as_of", lambda _time_s: snapshot)
    x, sure = np.zeros(9), np.eye(9)
    predicted = estimator._pad.predicted(snapshot, 12.0)
    assert predicted is not None
    estimate = replace(predicted, x=x, P=sure)
    monkeypatch.setattr(estimator._pad, "predicted", lambda *_given: estimate)
    prior = estimator.pad_prior(12.0)
    assert prior is not None
    assert prior.pad_position_body_m is not None
    assert estimator.pad(12.0) is not None
    sure[0, 0] = variance_m2
    if place is not None:
        x[place] = math.nan
    prior = estimator.pad_prior(12.0)
    assert prior is not None
    assert prior.pad_position_body_m is None
    assert estimator.pad(12.0) is None


def test_a_pad_filter_that_is_no_number_starts_again_from_the_next_sightings() -> None:
    """A frame is looked at with the prior, and a prior that is no number would end in no sighting."""
    estimator, spoilt, blind_s = new_estimator(), False, 0.0
    for arrival_s, sample in FLOWN.samples:
        if arrival_s > FROM_S + 3.0:
            break
        if isinstance(sample, PadSighting):
            prior = estimator.pad_prior(sample.time_s)
            assert prior is not None
            if prior.pad_position_body_m is not None and not math.isfinite(prior.position_std_m):
                continue  # as `Vision.step` would have it
        feed(estimator, sample)
        if arrival_s > FROM_S and not spoilt:
            spoilt = True
            estimator._pad._bank.state.covariances[:] = math.nan
        if spoilt and estimator.pad(arrival_s) is None:
            blind_s = arrival_s - FROM_S
    assert spoilt
    assert 0.0 < blind_s < 1.5
