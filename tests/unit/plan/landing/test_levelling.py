"""When the vehicle goes level for the contact, for how long, and how firmly it then sets down."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, Vector3, quat_from_euler
from companion.base.messages import ACCELERATION_FILTER_S
from companion.control.attitude import attitude_from_acceleration
from companion.plan.events import MissionEvent
from companion.plan.landing.contact import RESPONDS_S
from companion.plan.landing.drift import AFTER_S
from companion.plan.landing.levelling import CONTACT_STD_M, Levelling, TiltPrediction
from tests.unit.plan.landing.touchdown_attempt import (
    CONFIG,
    CYCLE_S,
    Attempt,
    coming_down,
    fresh,
    held_against_air,
    sight,
    sinking,
    tilting,
    waited,
)
from tests.unit.plan.plan_harness import LEG_M, VEHICLE

# the leg height is told to 3 cm, and measured as well
STD_M = math.hypot(0.03 / math.sqrt(2.0), CONTACT_STD_M)
DROP_M = VEHICLE.foot_reach_m * math.sin(math.radians(CONFIG.contact_tilt_deg))  # of the lower foot
LEVEL_M_S2 = GRAVITY_M_S2 * math.tan(math.radians(CONFIG.contact_tilt_deg))
SINKS: Vector3 = (0.0, 0.0, CONFIG.contact_speed_m_s)


def lead_after(excess_m_s2: float, std_m: float = STD_M) -> float:
    """How long before the contact it levels off a tilt that is so much more than it may have then."""
    sink_m_s = min(CONFIG.firm_contact_m_s, excess_m_s2 * 2.0 * std_m / CONFIG.lateral_speed_m_s)
    return RESPONDS_S + std_m / max(CONFIG.contact_speed_m_s, sink_m_s) + excess_m_s2 / 8.0


LEAD_S = lead_after(0.0)


def levelling(tilt_m_s2: float) -> Attempt:
    """A vehicle in its final descent, 0.3 m over the pad at 1 s, that tilts so."""
    touchdown = fresh()
    waited(touchdown, 0.0, 0.0, 0.5)
    for now_s in (0.5, 10.0):  # so long that the smoothed tilt is there
        touchdown.note_tilt(tilting(tilt_m_s2), now_s)
    touchdown.step(sight(height=LEG_M + 0.3), 1.0)
    return touchdown


def test_it_levels_off_shortly_before_the_contact_and_not_earlier() -> None:
    touchdown = levelling(0.0)
    sink_m_s = CONFIG.contact_speed_m_s
    due_s = 1.0 + (0.3 - DROP_M) / sink_m_s  # low on one side
    while not touchdown.levels_off and touchdown.now_s < 3.0:
        height_m = LEG_M + 0.3 - sink_m_s * (touchdown.now_s + CYCLE_S - 1.0)
        touchdown.cycles([sight(height=height_m, velocity=SINKS)])
        level = touchdown.level_off()
        assert touchdown.levels_off == (touchdown.now_s >= due_s - LEAD_S)
    assert level is not None
    assert level.from_s == pytest.approx(due_s - LEAD_S, abs=CYCLE_S)
    assert level.until_s == pytest.approx(due_s + AFTER_S, abs=CYCLE_S)
    assert level.tilt_rad == pytest.approx(math.radians(CONFIG.contact_tilt_deg))


@pytest.mark.parametrize("unseen_from_m", [0.25, 0.15, 0.11])
def test_a_pad_out_of_view_in_the_last_second_is_met_level_when_it_was_due(unseen_from_m: float) -> None:
    touchdown = levelling(0.0)
    sink_m_s = CONFIG.contact_speed_m_s
    due_s, seen_s = 1.0 + (0.3 - DROP_M) / sink_m_s, 1.0
    for k in range(60):
        now_s = 1.0 + k * CYCLE_S
        over_m = 0.3 - sink_m_s * (now_s - 1.0)
        seen_s = now_s if over_m >= unseen_from_m else seen_s
        down = sight(height=LEG_M + over_m, velocity=(0.0, 0.0, sink_m_s), age=now_s - seen_s)
        assert touchdown.step(down, now_s) is None
        level = touchdown.level_off()
        assert touchdown.levels_off == (now_s >= due_s - LEAD_S)
        if touchdown.levels_off and level is not None:
            assert level.from_s <= now_s
            assert level.until_s >= due_s + 0.1
            return


@pytest.mark.parametrize(
    ("tilt_deg", "excess_m_s2"),
    # the tilt has to fall to 7 deg, at 8 m/s3
    [(0.0, 0.0), (20.0, 9.81 * (math.tan(math.radians(20.0)) - math.tan(math.radians(7.0))))],
)
def test_tilting_far_it_begins_to_level_off_sooner(tilt_deg: float, excess_m_s2: float) -> None:
    above_m = DROP_M + lead_after(excess_m_s2) * 0.2
    for over_m, levels in ((above_m + 0.004, False), (above_m - 0.004, True)):
        touchdown = levelling(0.0)
        touchdown.note_tilt(quat_from_euler(math.radians(tilt_deg), 0.0, 0.0), 1.0)
        touchdown.step(sight(height=LEG_M + over_m, velocity=(0.0, 0.0, 0.2)), 1.0)
        assert touchdown.levels_off == levels


@pytest.mark.parametrize(
    ("excess_m_s2", "sink_m_s"),
    # so deep may the contact lie, with a drift of 0.12 m/s meanwhile
    [(-1.0, 0.19), (0.4, 0.19), (0.6, 0.6 * 2.0 * STD_M / 0.12), (0.85, 0.32)],
)
def test_the_more_tilt_it_levels_off_the_firmer_it_sets_down(excess_m_s2: float, sink_m_s: float) -> None:
    touchdown = levelling(max(0.0, LEVEL_M_S2 + excess_m_s2))
    touchdown.cycles([sight(height=LEG_M + 0.06, velocity=SINKS)] * 12)
    assert touchdown.levels_off
    speed_m_s = touchdown.reference.at(touchdown.now_s).velocity_m_s[2]
    assert speed_m_s == pytest.approx(sink_m_s, abs=1e-3)


def test_a_tilt_that_the_air_does_not_ask_for_is_levelled_off_as_firmly() -> None:
    """It gains the same lift, which would make the contact late."""
    touchdown = levelling(0.0)
    for k in range(12):
        leaning = replace(held_against_air(tilting(0.0)), attitude=tilting(LEVEL_M_S2 + 0.85))
        touchdown._success.tilt.note(leaning, None, 1.0 + k * CYCLE_S)
        touchdown.cycles([sight(height=LEG_M + 0.06, velocity=SINKS)])
    assert touchdown.levels_off
    assert touchdown.reference.at(touchdown.now_s).velocity_m_s[2] == pytest.approx(0.32, abs=1e-3)


@pytest.mark.parametrize("sink_std_m_s", [0.0, 0.1])
def test_what_a_level_vehicle_lacks_makes_it_drift_for_as_long_as_the_contact_is_late(
    sink_std_m_s: float,
) -> None:
    levelling_off, excess_m_s2 = Levelling(CONFIG, VEHICLE, 0.03 / math.sqrt(2.0)), 2.0
    late_m = math.hypot(STD_M, sink_std_m_s * lead_after(excess_m_s2))
    drift_m_s, _ = levelling_off.drift(LEVEL_M_S2 + excess_m_s2, 0.0, sink_std_m_s, 2.0)
    assert drift_m_s == pytest.approx(excess_m_s2 * late_m / CONFIG.firm_contact_m_s)
    assert levelling_off.drift(LEVEL_M_S2, 0.0, sink_std_m_s, 2.0)[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("excess_m_s2", "rel", "abs_m_s"),
    [(-1.0, 0.0, 1e-3), (0.0, 0.2, 0.0), (0.6, 0.03, 0.0), (2.0, 0.03, 0.0)],
)
def test_a_level_vehicle_drifts_by_what_the_air_asks_for_beyond_the_expected(
    excess_m_s2: float, rel: float, abs_m_s: float
) -> None:
    """A random walk, from the force that the reference comes against to a contact that is early or late."""
    levelling_off, scatter_m2_s4, flights, steps = Levelling(CONFIG, VEHICLE, 0.0), 0.04, 20_000, 100
    levels_s = lead_after(max(0.0, excess_m_s2), CONTACT_STD_M)
    late_s = CONTACT_STD_M / levelling_off.sink_m_s(LEVEL_M_S2 + excess_m_s2)
    step_s = (levels_s + late_s) / steps
    rng, rate = np.random.default_rng(3), 2.0 * scatter_m2_s4 / TiltPrediction.SMOOTHING_S
    walks = np.cumsum(math.sqrt(rate * step_s) * rng.standard_normal((flights, steps)), axis=1)
    lacks = np.maximum(0.0, excess_m_s2 + walks)
    speeds = step_s * (lacks - max(0.0, excess_m_s2)).sum(axis=1)
    speeds += late_s * rng.standard_normal(flights) * lacks[:, -1]
    drift_m_s, drift_m = levelling_off.drift(LEVEL_M_S2 + excess_m_s2, scatter_m2_s4, 0.0, 2.0)
    assert drift_m_s == pytest.approx(math.sqrt((speeds**2).mean()), rel=rel, abs=abs_m_s)
    assert drift_m == pytest.approx(0.5 * levels_s * drift_m_s)
    assert levelling_off.drift(LEVEL_M_S2 + excess_m_s2, scatter_m2_s4, 0.0, 0.1)[0] < drift_m_s


@pytest.mark.parametrize(("noise_m2_s3", "rel"), [(0.0, 0.2), (0.005, 0.35)])
def test_of_a_force_that_wanders_the_scatter_tells_how_fast_whatever_the_sensors_noise(
    noise_m2_s3: float, rel: float
) -> None:
    """The noise: 1 m/s2 (rms) of what is sampled at 200 Hz; taken for a walk it would be 1.0 m2/s5."""
    tilt, rng, rate, imu_s, found = TiltPrediction(), np.random.default_rng(2), 0.3, 0.005, list[float]()
    force, felt = np.zeros(2), np.zeros(2)
    share = -math.expm1(-imu_s / ACCELERATION_FILTER_S)
    for k in range(60_000):
        force += math.sqrt(rate * imu_s) * rng.standard_normal(2)
        felt += share * (force + math.sqrt(noise_m2_s3 / imu_s) * rng.standard_normal(2) - felt)
        if k % 7 == 0:
            level = replace(
                held_against_air(tilting(0.0)),
                side_force_ned_m_s2=(felt[0], felt[1], 0.0),
                acceleration_density_m2_s3=noise_m2_s3,
            )
            tilt.note(level, None, k * imu_s)
            found.append(tilt.scatter_m2_s4)
    assert 2.0 * float(np.mean(found)) / TiltPrediction.SMOOTHING_S == pytest.approx(rate, rel=rel)


def descent(needed_m_s2: complex) -> Attempt:
    """A vehicle that follows its reference down, in such air."""
    touchdown = fresh()
    attitude = attitude_from_acceleration((needed_m_s2.real, needed_m_s2.imag, 0.0), 1.0)
    while not touchdown.levels_off and touchdown.now_s < 10.0:
        now_s = touchdown.now_s + CYCLE_S
        touchdown.note_tilt(attitude, now_s)
        there = touchdown.reference.at(now_s)
        x, y, z = there.position_m
        touchdown.cycles([sight(x, -z, east=y, velocity=there.velocity_m_s)])
    return touchdown


@pytest.mark.parametrize("needed_m_s2", [0j, 1.0 + 0j, -2.0 + 1.5j])
def test_what_it_will_lack_while_it_is_level_it_comes_against(needed_m_s2: complex) -> None:
    touchdown = descent(needed_m_s2)
    assert touchdown.levels_off
    level = touchdown.level_off()
    assert level is not None
    due_s = level.until_s - AFTER_S
    lacks = needed_m_s2 * max(0.0, 1.0 - LEVEL_M_S2 / max(abs(needed_m_s2), LEVEL_M_S2))
    for before_s in (0.0, 0.05):
        there = touchdown.reference.at(due_s - before_s)
        assert complex(*there.position_m[:2]) == pytest.approx(-0.5 * lacks * before_s**2, abs=4e-3)
        assert complex(*there.velocity_m_s[:2]) == pytest.approx(lacks * before_s, abs=0.05)
        assert complex(*there.acceleration_m_s2[:2]) == pytest.approx(-lacks, abs=0.02)


def test_the_controller_knows_how_long_before_the_contact_it_levels_off() -> None:
    touchdown = levelling(2.0)
    bound = touchdown.level_off()
    assert not touchdown.levels_off
    assert bound is not None
    assert 1.0 < bound.from_s < bound.until_s
    assert bound.tilt_rad == pytest.approx(math.radians(CONFIG.contact_tilt_deg))


def test_a_tilt_that_makes_up_for_an_error_is_not_one_that_the_air_asks_for() -> None:
    tilt = TiltPrediction()
    for k in range(60):
        tilt.note(replace(held_against_air(tilting(0.0)), attitude=tilting(3.0)), None, k * CYCLE_S)
    assert abs(tilt.predicted_m_s2(0.0)) == pytest.approx(0.0)
    assert tilt.tilt_rad == pytest.approx(math.atan(3.0 / GRAVITY_M_S2))


@pytest.mark.parametrize(
    ("excess_m_s2", "longer_s", "abs_s"), [(0.0, 0.95, 0.15), (0.5, 0.24, 1e-3), (0.8, 0.15, 1e-3)]
)
def test_a_contact_that_comes_late_keeps_it_level_while_that_makes_little_speed(
    excess_m_s2: float, longer_s: float, abs_s: float
) -> None:
    touchdown = levelling(LEVEL_M_S2 + excess_m_s2)
    touchdown.now_s = 1.0 - CYCLE_S
    touchdown.cycles([sight(height=LEG_M + 0.065, velocity=(0.0, 0.0, 0.4))] * 34)  # 6.5 cm up all the time
    level = touchdown.level_off()
    assert level is not None
    assert level.from_s == pytest.approx(1.0)
    leads_s = lead_after(excess_m_s2) + AFTER_S
    assert level.until_s - level.from_s - leads_s == pytest.approx(longer_s, abs=abs_s)


@pytest.mark.parametrize(
    ("over_m", "speed_m_s", "stays"), [(0.04, 0.2, True), (0.07, 0.2, False), (0.04, 0.3, False)]
)
def test_so_low_that_a_tilt_would_touch_it_stays_level_unless_it_drifts_fast(
    over_m: float, speed_m_s: float, stays: bool
) -> None:
    touchdown = levelling(GRAVITY_M_S2 * math.tan(math.radians(11.0)))  # a foot hangs 3.4 cm lower
    touchdown.cycles([sight(height=LEG_M + over_m, velocity=(speed_m_s, 0.0, 0.16))] * 33)  # the sink stalls
    level = touchdown.level_off()
    assert level is not None
    assert (level.until_s > touchdown.now_s + LEAD_S) == stays


def test_a_sink_that_slows_once_it_is_level_is_a_later_contact() -> None:
    touchdown = levelling(0.0)
    for now_s, sink_m_s in ((1.0, CONFIG.contact_speed_m_s), (1.3, 0.1)):
        touchdown.step(sight(height=LEG_M + 0.06, velocity=(0.0, 0.0, sink_m_s)), now_s)
    level = touchdown.level_off()
    assert level is not None
    assert level.from_s == pytest.approx(1.0)
    assert level.until_s == pytest.approx(1.3 + (0.06 - DROP_M) / 0.1 + AFTER_S)


def test_while_contact_is_made_sure_of_it_stays_level() -> None:
    touchdown = levelling(0.0)
    while not touchdown.cycles([sight(height=LEG_M)], echo_m=LEG_M - 0.08):
        level = touchdown.level_off()
        assert level is not None
        assert touchdown.now_s + 0.1 < level.until_s
        assert touchdown.now_s < 2.0
    assert touchdown.on_pad


def test_it_stays_level_while_it_touches_late_and_drifting() -> None:
    levelling_off, tilt, reference = Levelling(CONFIG, VEHICLE, 0.03), TiltPrediction(), fresh().reference
    tilted = held_against_air(tilting(GRAVITY_M_S2 * math.tan(math.radians(15.0))))
    for k in range(40):
        now_s = 1.0 + k * CYCLE_S
        tilt.note(tilted, None, now_s)
        drifting = sight(height=LEG_M + 0.05, velocity=(0.3, 0.0, 0.1))
        levelling_off.expect(drifting, tilt, reference, now_s)
    level = levelling_off.window()
    assert level is not None
    assert level.until_s < now_s  # what it could not follow has become too much speed
    levelling_off.touching(now_s)
    level = levelling_off.window()
    assert level is not None
    assert level.until_s > now_s + 0.1


@pytest.mark.parametrize(
    ("aside_m", "found"), [(0.25, MissionEvent.MISALIGNED), (0.08, MissionEvent.CONTACT)]
)
def test_tilting_back_from_far_aside_a_low_foot_is_no_contact(aside_m: float, found: MissionEvent) -> None:
    touchdown, events = sinking(), list[MissionEvent]()
    for seen in coming_down(LEG_M + 0.04, aside_m=aside_m):
        touchdown.note_tilt(quat_from_euler(math.radians(12.0), 0.0, 0.0), touchdown.now_s + CYCLE_S)
        echo_m = seen.height_m - VEHICLE.range_position_body_m[2]
        events += touchdown.cycles([seen], echo_m=echo_m) if not events else []
    assert events[0] is found
