"""A beacon in the pad filter: it starts and carries it, it may die, jump or lie, and sightings dominate."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, ZERO3, Vector3, add, geodetic_from_ned
from companion.base.messages import PadBeacon
from companion.config import PadFilterConfig
from companion.estimate.gating import Timeline
from companion.estimate.motion import MotionHistory, VehiclePlace
from companion.estimate.pad.beacon_in_ned import NOISE_SHARE, in_ned
from companion.estimate.pad.observation import VehicleAtExposure
from companion.estimate.pad.pad_filter import FIX_TIMEOUT_S, PadFilter
from companion.estimate.pad.pad_types import CombinedEstimate, PadInput, PadMeasurement, PadSnapshot

ORIGIN = (47.0, 8.0, 400.0)
BIAS: Vector3 = (2.0, -1.5, 3.0)  # of a beacon's GPS that claims 1.5 m, minus ours
HEIGHT_M, SPEED_M_S = 7.0, 1.0
FORGET_S = PadFilterConfig().forget_s


def exposure(time_s: float, position: Vector3 = ZERO3, own_std_m: float = 1.0) -> VehicleAtExposure:
    stds = (own_std_m, own_std_m, 1.5 * own_std_m)
    place = VehiclePlace(position, stds, (0.1, 0.1, 0.15), ORIGIN)
    return VehicleAtExposure(time_s, IDENTITY, 0.0, ZERO3, ZERO3, lambda: place)


def told(time_s: float, position_ned_m: Vector3, velocity: Vector3, std_m: float = 1.5) -> PadBeacon:
    place = geodetic_from_ned(position_ned_m, ORIGIN)
    return PadBeacon(time_s, *place, velocity, std_m, velocity_std_m_s=0.3)


@dataclass
class BeaconBench:
    """A vehicle at rest over a pad that drives north at 1 m/s until it turns east; a fix a second."""

    turns_s: float = math.inf
    bias: Vector3 = BIAS
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(4))

    def __post_init__(self) -> None:
        self.motion = MotionHistory(120.0)
        for k in range(24000):
            self.motion.add(k / 200, IDENTITY, ZERO3)
        self.filter = PadFilter(PadFilterConfig(), self.motion, board_half_width_m=0.65)
        self.timeline: Timeline[PadSnapshot, PadInput] = Timeline(self.filter, 1.0)

    def pad(self, t: float) -> Vector3:
        north, east = SPEED_M_S * min(t, self.turns_s), SPEED_M_S * max(0.0, t - self.turns_s)
        return (north, east, HEIGHT_M)

    def hear(self, t: float, off: Vector3 | None = None) -> None:
        """A fix, off by the bias and a little noise."""
        noise = 0.2 * self.rng.normal(size=3)
        position = np.array(self.pad(t)) + (self.bias if off is None else off) + noise
        velocity = (SPEED_M_S, 0.0, 0.0) if t < self.turns_s else (0.0, SPEED_M_S, 0.0)
        fix = in_ned(told(t, (*position.tolist(),), velocity), exposure(t))
        assert fix is not None
        self.timeline.add(t, fix)

    def see(self, t: float, off: Vector3 = ZERO3) -> None:
        position = np.array(self.pad(t)) + off + 0.01 * self.rng.normal(size=3)
        self.timeline.add(t, PadMeasurement((*position.tolist(),), 1e-4 * np.eye(3), 0.3, 0.01))

    def run(self, start_s: float, end_s: float, *, seen: bool = False, heard: bool = True) -> None:
        for k in range(round(start_s * 30), round(end_s * 30)):
            if heard and k % 30 == 0:
                self.hear(k / 30)
            if seen:
                self.see(k / 30)

    def at(self, t: float) -> CombinedEstimate:
        snapshot = self.timeline.as_of(t)
        assert snapshot is not None
        estimate = self.filter.predicted(snapshot, t)
        assert estimate is not None
        return estimate

    def error(self, t: float) -> Vector3:
        north, east, down = (self.at(t).x[:3] - self.pad(t)).tolist()
        return (north, east, down)

    def lateral(self, t: float) -> float:
        return math.hypot(*self.error(t)[:2])


def lateral_std(estimate: CombinedEstimate) -> float:
    return math.sqrt(0.5 * (estimate.P[0, 0] + estimate.P[1, 1]))


def test_a_beacon_starts_the_filter_with_its_velocity_and_its_own_doubt() -> None:
    bench = BeaconBench()
    bench.hear(0.0)
    estimate = bench.at(0.5)
    assert estimate.x[3:6] == pytest.approx([SPEED_M_S, 0.0, 0.0], abs=0.05)
    assert bench.error(0.5) == pytest.approx(BIAS, abs=0.8)
    both_m = math.hypot(1.5, 1.0)
    assert lateral_std(estimate) == pytest.approx(both_m, rel=0.15)
    assert estimate.seen_time_s == -math.inf
    assert estimate.observed_time_s == 0.0


def test_what_all_fixes_are_off_by_is_not_averaged_away() -> None:
    """Sixty fixes whose errors were independent would be sure to 0.2 m, and wrong by 2.5."""
    bench = BeaconBench()
    bench.run(0.0, 60.0)
    estimate = bench.at(60.0)
    assert lateral_std(estimate) > 0.5 * math.hypot(1.5, 1.0)
    assert bench.lateral(60.0) < 3.0 * lateral_std(estimate)


def test_one_sighting_outweighs_all_fixes_before_it() -> None:
    bench = BeaconBench()
    bench.run(0.0, 20.0)
    assert bench.lateral(20.0) > 1.5
    bench.see(20.0)
    assert bench.lateral(20.0) < 0.04
    estimate = bench.at(20.0)
    assert estimate.seen_time_s == 20.0
    assert estimate.heading_rad == pytest.approx(0.3)
    # its velocity was known before, as by a fix: no first speed of 2 m/s
    assert estimate.P[3, 3] < math.hypot(0.3, 0.1) ** 2


def test_beside_sightings_a_beacon_that_is_off_says_nothing() -> None:
    alone, both = BeaconBench(), BeaconBench()
    alone.rng, both.rng = np.random.default_rng(1), np.random.default_rng(1)
    errors: list[float] = []
    for k in range(30 * 20):
        t = k / 30
        alone.see(t)
        both.see(t)
        if k % 6 == 0:
            noise = both.rng.bit_generator.state
            both.hear(t)
            both.rng.bit_generator.state = noise  # the sightings stay the same
        errors.append(math.dist(alone.error(t), both.error(t)))
    assert max(errors[60:]) < 0.004


def test_in_a_gap_it_carries_a_pad_that_turns_less_what_it_was_off_by() -> None:
    heard, unheard = BeaconBench(turns_s=20.5), BeaconBench(turns_s=20.5)
    for bench in (heard, unheard):
        bench.run(0.0, 20.0, seen=True)
    heard.run(20.0, 28.0)
    assert heard.lateral(28.0) < 0.8  # the beacon itself is off by 2.5 m
    assert unheard.lateral(28.0) > 5.0
    heard.see(28.0)
    assert heard.lateral(28.0) < 0.04


def test_a_beacon_that_dies_is_believed_less_and_less() -> None:
    bench = BeaconBench()
    bench.run(0.0, 10.0)
    stds = [lateral_std(bench.at(10.0 + later)) for later in (0.0, 3.0, 9.0)]
    assert stds == sorted(stds)
    assert stds[-1] > 2.0 * stds[0]
    assert bench.at(19.0).observed_time_s == 9.0


def test_a_jump_of_20_m_moves_no_pad_that_is_seen() -> None:
    bench = BeaconBench()
    bench.run(0.0, 10.0, seen=True)
    for k in range(300, 600):
        if k % 30 == 0:
            bench.hear(k / 30, off=(22.0, 0.0, 0.0))
        bench.see(k / 30)
    assert bench.lateral(20.0 - 1e-9) < 0.03
    assert bench.filter.gates["beacon"].refused == 10
    assert bench.filter.gates["sighting"].refused == 0


@pytest.mark.parametrize(
    ("off", "claimed_m"), [((0.5, 0.0, 0.0), 0.02), ((0.0, 0.0, -0.5), 0.02), ((8.0, 0.0, 0.0), 1.5)]
)
def test_what_sightings_contradict_moves_no_pad_that_they_end_at(off: Vector3, claimed_m: float) -> None:
    own_m, bench = (0.03 if claimed_m < 1.0 else 1.0), BeaconBench(bias=ZERO3)

    def hear(t: float) -> None:
        # an antenna beside the pad's middle, or a receiver that has jumped
        fix = told(t, add(bench.pad(t), off), (SPEED_M_S, 0.0, 0.0), claimed_m)
        relative = in_ned(fix, exposure(t, own_std_m=own_m))
        assert relative is not None
        bench.timeline.add(t, relative)

    for k in range(600):
        bench.see(k / 30)
        if k % 30 == 29:
            hear(k / 30 + 0.01)
    for k in range(4):
        hear(20.5 + k)
        assert math.dist(bench.at(20.9 + k).x[:3], bench.pad(20.9 + k)) < 0.3


def test_after_a_jump_an_unseen_pad_is_where_its_beacon_lasts() -> None:
    bench, away = BeaconBench(), (22.0, -1.5, 3.0)
    bench.run(0.0, 10.0)
    bench.hear(10.0, off=away)
    assert bench.lateral(10.0) < 4.0  # one alone may be a reflection
    for k in range(11, 11 + math.ceil(FIX_TIMEOUT_S) + 1):
        bench.hear(float(k), off=away)
    assert bench.error(16.0)[0] == pytest.approx(22.0, abs=1.0)
    assert bench.at(16.0).seen_time_s == -math.inf


def test_a_pad_that_is_seen_elsewhere_than_its_beacon_says_is_believed_at_once() -> None:
    bench = BeaconBench(bias=(25.0, 0.0, 0.0))
    bench.run(0.0, 5.0)
    bench.see(5.0)
    assert bench.lateral(5.0) < 0.04
    bench.run(5.0, 8.0, seen=True)
    assert bench.lateral(8.0 - 1e-9) < 0.03
    assert bench.filter.gates["sighting"].refused == 0


def test_a_pad_seen_long_ago_is_not_forgotten_while_its_beacon_carries_it() -> None:
    bench = BeaconBench()
    bench.run(0.0, 5.0, seen=True)
    bench.run(5.0, 5.0 + 2.0 * FORGET_S)
    end_s = 5.0 + 2.0 * FORGET_S
    assert bench.lateral(end_s - 1e-9) < 1.5
    bench.see(end_s, off=(0.0, 0.0, 0.0))
    assert bench.at(end_s).seen_time_s == end_s
    assert bench.filter.gates["sighting"].refused == 0


def test_two_beacons_in_order_and_out_of_order_give_the_same() -> None:
    right, late = BeaconBench(), BeaconBench()
    for bench, times in ((right, (0.0, 0.4, 0.8)), (late, (0.0, 0.8, 0.4))):
        for t in times:
            fix = in_ned(told(t, bench.pad(t), (SPEED_M_S, 0.0, 0.0)), exposure(t))
            assert fix is not None
            bench.timeline.add(t, fix)
    assert late.at(1.0).x.tolist() == right.at(1.0).x.tolist()


def test_a_fix_is_their_place_minus_ours_with_what_both_are_off_by() -> None:
    fix = in_ned(told(3.0, (12.0, 4.0, -1.0), (2.0, 0.0, 0.0)), exposure(3.0, (10.0, 5.0, -8.0)))
    assert fix is not None
    assert fix.position_ned_m == pytest.approx((2.0, -1.0, 7.0), abs=1e-3)
    both_m = math.hypot(1.5, 1.0)
    assert np.sqrt(fix.covariance_ned_m2.diagonal()[:2]) == pytest.approx([NOISE_SHARE * both_m] * 2)
    assert fix.common is not None
    # half a second's way of the pad is added along it
    assert fix.common.std_ned_m[:2] == pytest.approx((math.hypot(both_m, 1.0), both_m))


def test_without_our_own_place_or_its_velocity_it_says_less() -> None:
    beacon = PadBeacon(1.0, *geodetic_from_ned((3.0, 0.0, 0.0), ORIGIN), ZERO3, 0.02, 0.03)
    nowhere = exposure(1.0)._replace(place=lambda: None)
    assert in_ned(beacon, nowhere) is None
    fix = in_ned(beacon, exposure(1.0, own_std_m=0.02))
    assert fix is not None
    assert fix.relative_velocity is None
    assert max(fix.common.std_ned_m if fix.common else ()) < 0.06  # RTK on both
