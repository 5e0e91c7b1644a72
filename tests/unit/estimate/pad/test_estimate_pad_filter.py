"""The relative-motion filter: starting, tracking, blindness, outliers, echoes and heading."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, Vector3
from companion.config import PadFilterConfig
from companion.estimate.gating import Timeline
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.pad_filter import PadFilter
from companion.estimate.pad.pad_types import (
    CombinedEstimate,
    HeightMeasurement,
    PadInput,
    PadMeasurement,
    PadSnapshot,
)

SENSOR = (0.0, 0.0, 0.08)


class PadFilterBench:
    """A vehicle with a given acceleration over a pad with a given motion, seen at 30 Hz."""

    def __init__(
        self, acceleration: Vector3 = (0.0, 0.0, 0.0), height_m: float = 3.0, noise_m: float = 0.01
    ) -> None:
        self.motion = MotionHistory(20.0)
        self.filter = PadFilter(PadFilterConfig(), self.motion, board_half_width_m=0.65)
        self.timeline: Timeline[PadSnapshot, PadInput] = Timeline(self.filter, 1.0)
        for k in range(4000):
            self.motion.add(k / 200, IDENTITY, acceleration)
        self.acceleration = np.array(acceleration)
        self.height_m, self.noise_m = height_m, noise_m
        self.rng = np.random.default_rng(2)

    def relative(self, t: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """The pad drives north at 1 m/s."""
        return np.array([t, 0.0, self.height_m]) - 0.5 * self.acceleration * t * t

    def sighting(self, t: float, offset: Vector3 = (0.0, 0.0, 0.0), heading: float = 0.1) -> PadMeasurement:
        noise = self.noise_m * self.rng.normal(size=3)
        position = self.relative(t) + noise + offset
        return PadMeasurement((*position.tolist(),), self.noise_m**2 * np.eye(3), heading, 0.01)

    def see(self, start_s: float, end_s: float, offset: Vector3 = (0.0, 0.0, 0.0)) -> None:
        for k in range(round(start_s * 30), round(end_s * 30)):
            self.timeline.add(k / 30, self.sighting(k / 30, offset))

    def at(self, t: float) -> CombinedEstimate:
        snapshot = self.timeline.as_of(t)
        assert snapshot is not None
        estimate = self.filter.predicted(snapshot, t)
        assert estimate is not None
        return estimate


def test_first_sighting_starts_the_filter() -> None:
    bench = PadFilterBench()
    fix = bench.sighting(0.0)
    bench.timeline.add(
        0.0, PadMeasurement(fix.position_ned_m, fix.covariance_ned_m2, 0.1, 0.01, (0.5, 0.0, 0.2))
    )
    estimate = bench.at(0.0)
    assert estimate.x[0:3] == pytest.approx(fix.position_ned_m)
    assert estimate.x[3:6] == pytest.approx([-0.5, 0.0, -0.2])
    assert math.sqrt(np.trace(estimate.P[3:6, 3:6])) > 2.0


def test_a_pad_is_found_by_a_vehicle_that_hardly_knows_how_fast_it_flies() -> None:
    """As after a minute without GPS: it is 14 m/s off, two standard deviations, and says so."""
    bench = PadFilterBench()
    for k in range(60):
        fix = bench.sighting(k / 30)
        drifted = replace(
            fix, vehicle_velocity_ned_m_s=(13.0, 0.0, 0.0), vehicle_velocity_std_m_s=(7.0, 7.0, 7.0)
        )
        bench.timeline.add(k / 30, drifted)
    assert bench.filter.gates["sighting"].refused == 0
    assert bench.at(2.0).x[3:6] == pytest.approx([1.0, 0.0, 0.0], abs=0.15)


def test_without_a_sighting_there_is_no_pad_and_echoes_are_ignored() -> None:
    bench = PadFilterBench(height_m=1.0)
    bench.timeline.add(0.0, HeightMeasurement(0.92, SENSOR, 0.03))
    snapshot = bench.timeline.as_of(1.0)
    assert snapshot is not None
    assert bench.filter.predicted(snapshot, 1.0) is None


@pytest.mark.parametrize("acceleration", [(0.0, 0.0, 0.0), (1.5, -1.0, 0.3)])
def test_vehicles_own_acceleration_is_not_taken_for_the_pads(acceleration: Vector3) -> None:
    bench = PadFilterBench(acceleration)
    bench.see(0.0, 4.0)
    estimate = bench.at(4.0)
    assert estimate.x[0:3] == pytest.approx(bench.relative(4.0), abs=0.03)
    assert estimate.x[3:6] == pytest.approx(np.array([1.0, 0.0, 0.0]) - 4.0 * bench.acceleration, abs=0.15)
    assert estimate.x[6:9] == pytest.approx([0.0, 0.0, 0.0], abs=0.25)


def test_a_forgotten_pad_is_believed_at_its_first_sighting_whatever_was_flown_meanwhile() -> None:
    bench = PadFilterBench()
    config = PadFilterConfig()
    bench.see(0.0, 4.0)
    bench.motion = bench.filter._motion = MotionHistory(config.forget_s + 1.0)
    for k in range(61 * 200):
        push = math.copysign(1.5, math.sin(0.5 * k / 200))
        bench.motion.add(k / 200, IDENTITY, (push, 0.0, 0.0))
    bench.timeline.add(60.0, PadMeasurement((30.0, -4.0, 6.0), 1e-4 * np.eye(3), 2.0, 0.01, (0.5, 0.0, 0.0)))
    estimate = bench.at(60.0)
    assert estimate.seen_time_s == 60.0
    assert estimate.x[0:6] == pytest.approx([30.0, -4.0, 6.0, -0.5, 0.0, 0.0])
    assert estimate.heading_rad == pytest.approx(2.0)


def test_blind_for_two_seconds_it_predicts_and_says_how_well() -> None:
    bench = PadFilterBench((0.8, 0.0, 0.0))
    bench.see(0.0, 4.0)
    before, after = bench.at(4.0), bench.at(6.0)
    error = float(np.linalg.norm(after.x[0:3] - bench.relative(6.0)))
    assert error < 3.0 * after.position_std_m
    assert error < 0.5
    assert after.position_std_m > 10.0 * before.position_std_m
    assert after.seen_time_s == before.seen_time_s


@pytest.mark.parametrize("gap_s", [0.3, 1.0])
def test_a_gap_of_the_imu_hides_a_motion_that_is_stated(gap_s: float) -> None:
    """2 m/s^2 within it, and without: the first sighting after it is believed, the next one's too."""
    bench, push_m_s2, end_s = PadFilterBench(), 2.0, 4.0 + gap_s
    bench.motion = bench.filter._motion = MotionHistory(20.0)
    for k in range(1200):
        if not 4.0 < k / 200 < end_s:
            bench.motion.add(k / 200, IDENTITY, (0.0, 0.0, 0.0))
    bench.see(0.0, 4.0)
    estimate = bench.at(end_s)
    missed_m, missed_m_s = 0.5 * push_m_s2 * gap_s**2, push_m_s2 * gap_s
    assert missed_m < 3.0 * math.sqrt(estimate.P[0, 0])
    assert missed_m_s < 3.0 * math.sqrt(estimate.P[3, 3])
    later = end_s + np.arange(1, 8) / 30
    for t in later.tolist():
        away = -missed_m - missed_m_s * (t - end_s)
        bench.timeline.add(t, bench.sighting(t, (away, 0.0, 0.0)))
    assert bench.filter.gates["sighting"].refused == 0
    after = bench.at(t)
    assert after.x[0] == pytest.approx(bench.relative(t)[0] + away, abs=0.03)
    assert abs(after.x[3] - (1.0 - missed_m_s)) < 3.0 * math.sqrt(after.P[3, 3])


def test_one_false_sighting_is_refused() -> None:
    bench = PadFilterBench()
    bench.see(0.0, 3.0)
    bench.timeline.add(3.0, bench.sighting(3.0, (1.0, 0.0, 0.0)))
    assert bench.at(3.0).x[0:3] == pytest.approx(bench.relative(3.0), abs=0.05)
    assert bench.filter.gates["sighting"].refused == 1
    assert bench.at(3.0).seen_time_s < 3.0


@pytest.mark.parametrize("noise_m", [0.001, 0.005])
def test_a_pad_that_stops_at_once_is_followed_by_a_few_sightings(noise_m: float) -> None:
    bench = PadFilterBench(noise_m=noise_m)
    bench.see(0.0, 3.0)
    stopped_s = 2.98
    for k in range(90, 94):
        bench.timeline.add(k / 30, bench.sighting(k / 30, (stopped_s - k / 30, 0.0, 0.0)))
    estimate = bench.at(93 / 30)
    assert estimate.seen_time_s == 93 / 30
    assert estimate.x[0:3] == pytest.approx([stopped_s, 0.0, 3.0], abs=4.0 * noise_m)
    error = abs(estimate.x[3])
    assert error < 0.2
    assert error < 4.0 * math.sqrt(estimate.P[3, 3])


def test_an_outlier_just_before_a_stop_hides_it_for_no_more_than_a_sighting() -> None:
    bench = PadFilterBench(noise_m=0.001)
    bench.see(0.0, 3.0)
    bench.timeline.add(3.0, bench.sighting(3.0, (0.0, 0.2, 0.0)))
    for k in (91, 92, 93):
        bench.timeline.add(k / 30, bench.sighting(k / 30, (3.02 - k / 30, 0.0, 0.0)))
    estimate = bench.at(93 / 30)
    assert estimate.seen_time_s == 93 / 30
    assert abs(estimate.x[3]) < 0.2


@pytest.mark.parametrize("first_m", [0.006, 0.02])
def test_a_pose_that_slid_off_is_forgotten_with_the_first_good_sighting(first_m: float) -> None:
    bench = PadFilterBench(noise_m=0.001)
    bench.see(0.0, 3.0)
    for k, aside_m in ((90, first_m), (91, 3.3 * first_m)):
        bench.timeline.add(k / 30, bench.sighting(k / 30, (0.0, -aside_m, 0.0)))
    bench.timeline.add(92 / 30, bench.sighting(92 / 30))
    estimate = bench.at(92 / 30)
    assert estimate.seen_time_s == 92 / 30
    assert estimate.x[0:3] == pytest.approx(bench.relative(92 / 30), abs=0.004)
    assert estimate.x[3:6] == pytest.approx([1.0, 0.0, 0.0], abs=0.15)


def test_a_pad_is_not_believed_to_be_much_faster_at_once() -> None:
    bench = PadFilterBench(noise_m=0.001)
    bench.see(0.0, 3.0)
    for k, ahead_m in ((90, 0.3), (91, 1.0)):
        bench.timeline.add(k / 30, bench.sighting(k / 30, (ahead_m, 0.0, 0.0)))
    assert bench.at(91 / 30).seen_time_s < 3.0


def test_another_pad_is_no_change_of_velocity_and_neither_is_noise() -> None:
    bench = PadFilterBench(noise_m=0.001)
    bench.see(0.0, 3.0)
    bench.see(3.0, 3.2, (0.1, 0.0, 0.0))  # beside it, and moving as it does
    assert bench.at(3.2).seen_time_s < 3.0
    assert bench.at(3.2).x[0] == pytest.approx(3.2, abs=0.01)
    for k, aside in enumerate((0.1, -0.1, 0.1, -0.1)):
        bench.timeline.add(3.2 + k / 30, bench.sighting(3.2 + k / 30, (0.0, aside, 0.0)))
    assert bench.at(3.3).seen_time_s < 3.0


def test_sightings_that_insist_start_the_filter_again() -> None:
    bench = PadFilterBench()
    bench.see(0.0, 3.0)
    bench.see(3.0, 3.4, (1.0, 0.0, 0.0))
    assert bench.at(3.4).x[0] == pytest.approx(3.4, abs=0.1)
    bench.see(3.4, 4.0, (1.0, 0.0, 0.0))
    assert bench.at(4.0).x[0] == pytest.approx(5.0, abs=0.1)


def test_echo_over_the_board_corrects_the_height_only() -> None:
    bench = PadFilterBench(height_m=1.0)
    bench.motion = MotionHistory(1.0)
    fix = PadMeasurement((0.1, 0.0, 1.05), np.diag([1e-4, 1e-4, 1e-2]), 0.0, 0.01)
    bench.timeline.add(0.0, fix)
    bench.timeline.add(0.001, HeightMeasurement(0.92, SENSOR, 0.01))
    assert bench.at(0.001).x[2] == pytest.approx(1.0, abs=0.01)
    assert bench.at(0.001).x[0] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(("north", "height"), [(0.9, 1.0), (0.0, 3.0)])
def test_echo_beside_the_board_or_from_high_up_is_ignored(north: float, height: float) -> None:
    bench = PadFilterBench()
    bench.timeline.add(0.0, PadMeasurement((north, 0.0, height), np.diag([1e-4, 1e-4, 1e-2]), 0.0, 0.01))
    before = bench.at(0.0).x
    bench.timeline.add(0.0, HeightMeasurement(height - 0.2, SENSOR, 0.01))
    assert np.array_equal(bench.at(0.0).x, before)


def test_heading_follows_through_the_wrap() -> None:
    bench = PadFilterBench()
    for k in range(120):
        bench.timeline.add(
            k / 30, bench.sighting(k / 30, heading=math.remainder(2.8 + 0.3 * k / 30, math.tau))
        )
    estimate = bench.at(119 / 30)
    assert math.remainder(estimate.heading_rad - 2.8 - 0.3 * 119 / 30, math.tau) == pytest.approx(
        0.0, abs=0.03
    )
    assert estimate.heading_rate_rad_s == pytest.approx(0.3, abs=0.05)


def test_one_wrong_heading_is_refused_and_the_position_taken() -> None:
    bench = PadFilterBench()
    bench.see(0.0, 2.0)
    bench.timeline.add(2.0, bench.sighting(2.0, heading=3.0))
    assert bench.at(2.0).heading_rad == pytest.approx(0.1, abs=0.02)
    assert bench.at(2.0).seen_time_s == 2.0


def test_any_order_of_arrival_gives_the_same_state() -> None:
    fixes = [(k / 30, PadFilterBench().sighting(k / 30)) for k in range(30)]
    one, two = PadFilterBench(), PadFilterBench()
    for time_s, fix in fixes:
        one.timeline.add(time_s, fix)
    order = [0, *np.random.default_rng(4).permutation(range(1, 30)).tolist()]
    for k in order:
        two.timeline.add(*fixes[k])
    assert np.array_equal(one.at(1.0).x, two.at(1.0).x)
    assert np.array_equal(one.at(1.0).P, two.at(1.0).P)


def test_models_follow_the_motion() -> None:
    bench = PadFilterBench()
    bench.see(0.0, 5.0)
    models = bench.at(5.0).models
    assert set(models) == {
        "steady",
        "manoeuvre",
        "turn",
        "sway",
        "still",
        "waves_7s",
        "waves_4.5s",
        "waves_2.8s",
    }
    assert models["steady"] > models["manoeuvre"]
    assert models["still"] > 0.5
    assert sum(models[name] for name in ("steady", "manoeuvre", "turn", "sway")) == pytest.approx(1.0)


def test_the_horizons_error_is_part_of_the_whole_covariance() -> None:
    bench = PadFilterBench()
    bench.see(0.0, 2.0)
    estimate = bench.at(2.0)
    none, tilt = np.zeros((3, 3)), math.radians(1.0) ** 2 * np.eye(3)
    assert estimate.covariance(none, 0.3) == pytest.approx(estimate.P[:6, :6])
    whole = estimate.covariance(tilt, 0.0)
    assert math.sqrt(whole[1, 1]) > math.radians(1.0) * bench.height_m
    assert whole[2, 2] == pytest.approx(
        estimate.P[2, 2] + tilt[0, 0] * (estimate.x[0] ** 2 + estimate.x[1] ** 2)
    )


def test_the_calibrations_error_is_not_averaged_away() -> None:
    bench = PadFilterBench()
    for k in range(120):
        fix = replace(bench.sighting(k / 30), slow_variance_m2=0.03**2)
        bench.timeline.add(k / 30, fix)
    estimate = bench.at(119 / 30)
    assert math.sqrt(estimate.P[2, 2]) < 0.01
    assert math.sqrt(estimate.covariance(np.zeros((3, 3)), 0.0)[2, 2]) == pytest.approx(0.03, rel=0.1)


def test_covariance_stays_positive_definite() -> None:
    bench = PadFilterBench()
    bench.see(0.0, 15.0)
    P = bench.at(15.0).P
    assert np.abs(P - P.T).max() < 1e-12
    assert np.linalg.eigvalsh(P).min() > 0.0
