"""Faults: each shows in what the drivers read, during its time and not after it."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3, ned_from_geodetic
from companion.base.messages import GpsFix
from companion.config import ConfigError, validate
from sitl.faults.faults import Fault, FrameLate, FrameLost, GpsLost, GyroBiasStep
from sitl.faults.lines import FrameLine, LinkChannel, LinkSettings
from sitl.scenario.scenario import Scenario
from tests.unit.sitl.devices.sensor_desk import DriverSamples, fly

START_S, END_S, SECONDS = 6.0, 8.0, 10.0
TIMES: dict[str, Any] = {"start_s": START_S, "duration_s": END_S - START_S}
SETTLE_S = 0.05  # the filters' delay, and samples that are averages
RATE, FORCE = "rate_body_rad_s", "specific_force_body_m_s2"

# ---------------------------------------------------------------- one by one


def during(samples: list[Any]) -> list[Any]:
    return [sample for sample in samples if START_S + SETTLE_S < sample.time_s < END_S - SETTLE_S]


def elsewhere(samples: list[Any]) -> list[Any]:
    """Before the fault, and after it."""
    return [s for s in samples if s.time_s < START_S - SETTLE_S or s.time_s > END_S + SETTLE_S]


def mean(samples: list[Any], name: str) -> Any:
    return np.mean([getattr(sample, name) for sample in samples], axis=0)


@pytest.fixture(scope="module")
def healthy() -> DriverSamples:
    """Of a flight without a fault, which those with one are compared with."""
    return fly(3, SECONDS)


def scenario_with(*faults: dict[str, Any]) -> Scenario:
    return validate(Scenario, {"name": "mine", "description": "mine", "faults": list(faults)}, "mine.yaml")


def flown(kind: str, **values: Any) -> DriverSamples:
    """Of a flight with one fault."""
    return fly(3, SECONDS, scenario_with({"kind": kind, **TIMES, **values}).faults)


@pytest.mark.parametrize("unplugged", [False, True])
def test_without_gps_there_are_no_fixes_for_as_long(healthy: DriverSamples, unplugged: bool) -> None:
    heard = flown("gps_lost", unplugged=unplugged)
    assert len(during(healthy.fixes)) == pytest.approx(10, abs=1)
    # a message that is on the line when the sky goes still arrives
    assert during(heard.fixes) == [] or during(heard.fixes)[-1].time_s < START_S + 0.2
    assert [fix for fix in heard.fixes if fix.time_s > END_S + 0.5]


@pytest.mark.parametrize(
    ("kind", "step", "name", "unit", "close"),
    [
        # 1 % of soft iron
        ("mag_disturbed", {"field_body_ut": (0.0, 30.0, -10.0)}, "field_body_ut", 1.0, 1.5),
        ("gyro_bias_step", {"rate_body_deg_s": (2.0, 0.0, -1.0)}, RATE, math.radians(1.0), 0.05),
        ("accel_bias_step", {"force_body_m_s2": (0.5, 0.0, -0.3)}, FORCE, 1.0, 0.02),
    ],
)
def test_a_step_adds_to_every_sample_in_body_axes_and_to_no_others(
    healthy: DriverSamples, kind: str, step: dict[str, Any], name: str, unit: float, close: float
) -> None:
    heard, (wanted,) = flown(kind, **step), step.values()
    ours, theirs = (getattr(h, "mag" if kind == "mag_disturbed" else "imu") for h in (heard, healthy))
    added = mean(during(ours), name) - mean(during(theirs), name)
    assert added / unit == pytest.approx(wanted, abs=close)
    for other in {RATE, FORCE} - {name}:
        assert kind == "mag_disturbed" or mean(during(ours), other) == pytest.approx(
            mean(during(theirs), other)
        )
    first = 0 if kind == "mag_disturbed" else -100
    assert elsewhere(ours)[first:] == elsewhere(theirs)[first:]


def test_a_clipping_accelerometer_reads_less_than_gravity_for_it_loses_the_peaks(
    healthy: DriverSamples,
) -> None:
    heard = flown("accel_clips", range_g=1.1, vibration_factor=5.0)
    down, usual = ([sample.specific_force_body_m_s2[2] for sample in during(h.imu)] for h in (heard, healthy))
    # the low-pass filter that follows the element overshoots a little
    assert min(down) > -1.2 * GRAVITY_M_S2
    assert np.mean(down) > np.mean(usual) + 0.3
    assert np.std(down) > 2.0 * np.std(usual)


def test_stronger_vibration_shakes_and_leaves_the_mean(healthy: DriverSamples) -> None:
    before, shaken = (
        np.array([sample.specific_force_body_m_s2 for sample in during(h.imu)])
        for h in (healthy, flown("vibration", factor=4.0))
    )
    assert 3.0 < np.std(shaken[:, 0]) / np.std(before[:, 0]) < 5.0
    assert shaken.mean(axis=0) == pytest.approx(before.mean(axis=0), abs=0.1)


def test_spikes_are_echoes_from_in_between(healthy: DriverSamples) -> None:
    heard = flown("range_spikes", share=0.5)
    wrong = [echo for echo in during(heard.echoes) if echo.distance_m < 1.7]
    assert 0.25 < len(wrong) / len(during(heard.echoes)) < 0.75
    assert len([echo for echo in during(healthy.echoes) if echo.distance_m < 1.7]) <= 2
    after, usual = ([echo.distance_m for echo in elsewhere(h.echoes)] for h in (heard, healthy))
    assert after == usual


def test_a_bus_that_fails_now_and_then_costs_no_sample() -> None:
    assert len(during(flown("imu_bus_error", every=40).imu)) == pytest.approx(380, abs=12)


@pytest.mark.parametrize(("kind", "values"), [("imu_bus_error", {"every": 1}), ("imu_lost", {})])
def test_an_imu_that_is_off_is_reported_and_comes_back(kind: str, values: dict[str, Any]) -> None:
    heard = flown(kind, **values)
    assert len(during(heard.imu)) < 20
    assert any("Remote I/O error" in problem for problem in heard.problems)
    assert [sample for sample in heard.imu if sample.time_s > END_S + 1.0]


def test_every_tenth_frame_comes_a_quarter_of_a_second_late_and_a_share_of_them_is_lost() -> None:
    line = FrameLine(np.random.default_rng(0))
    line.late_s, line.late_every = 0.25, 10
    assert [line.delay_s(k) for k in range(12)] == [0.25, *[0.0] * 9, 0.25, 0.0]
    line.clear_faults()
    assert line.delay_s(20) == 0.0
    line.lost_share = 0.3
    assert 0.2 < np.mean([line.delay_s(k) is None for k in range(500)]) < 0.4
    line.lost_share = 1.0  # a stalled camera
    assert {line.delay_s(k) for k in range(50)} == {None}


# ---------------------------------------------------------------- frames


def test_frames_are_lost_in_bursts_of_the_length_asked_for() -> None:
    line = FrameLine(np.random.default_rng(0), lost_share=0.2, burst_frames=5.0)
    lost = np.array([line.delay_s(k) is None for k in range(20_000)])
    assert lost.mean() == pytest.approx(0.2, abs=0.02)
    bursts = int((lost[1:] & ~lost[:-1]).sum())
    assert lost.sum() / bursts == pytest.approx(5.0, rel=0.1)
    line.lost_share = 1.0
    line.clear_faults()
    assert line.lost_share == 0.2  # its own


def test_a_stuck_camera_shows_the_last_picture_and_a_garbled_one_is_whole_down_to_a_row() -> None:
    line = FrameLine(np.random.default_rng(0))
    first, second = (np.full((48, 64), grey, np.uint8) for grey in (10, 20))
    assert line.carried(first) is first
    line.stuck = True
    assert line.carried(second) is first
    line.clear_faults()
    assert line.carried(second) is second
    line.garbled_share = 1.0
    whole = (line.carried(second) == 20).all(axis=1)
    row = int(np.argmin(whole))
    assert whole[:row].all()
    assert not whole[row:].any()
    assert (second == 20).all()  # the camera's own picture is not touched


# ---------------------------------------------------------------- together


def test_faults_overlap_and_mending_one_leaves_the_other() -> None:
    steps = [
        GyroBiasStep(kind="gyro_bias_step", rate_body_deg_s=(rate, 0.0, 0.0), start_s=start_s, duration_s=2.0)
        for rate, start_s in ((1.0, 5.0), (2.0, 6.0))
    ]
    rates = fly(3, 9.0, steps).imu

    def mean_deg_s(second: float) -> float:
        seen = [s.rate_body_rad_s[0] for s in rates if second + 0.1 < s.time_s < second + 0.9]
        return math.degrees(np.mean(seen))

    added = [mean_deg_s(second) - mean_deg_s(4.0) for second in (5.0, 6.0, 7.0, 8.0)]
    assert added == pytest.approx([1.0, 3.0, 2.0, 0.0], abs=0.05)


# ---------------------------------------------------------------- as scenario data


def test_a_scenario_lists_faults_by_kind() -> None:
    late, lost = scenario_with(
        {"kind": "frame_late", "start_s": 18.0, "every": 5},
        {"kind": "frame_lost", "start_s": 20.0, "duration_s": 1.0},
    ).faults
    assert isinstance(late, FrameLate)
    assert (late.extra_s, late.every, late.lasts_s) == (0.25, 5, 900.0)
    assert isinstance(lost, FrameLost)
    assert (lost.share, lost.start_s, lost.lasts_s) == (1.0, 20.0, 1.0)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "gremlin", "start_s": 1.0}, ["faults", "gremlin", "gps_lost"]),
        ({"kind": "gps_lost"}, ["faults", "start_s"]),
        ({"kind": "range_spikes", "start_s": 1.0, "share": 1.5}, ["faults", "share", "1.5"]),
        ({"kind": "mag_disturbed", "start_s": 1.0, "field_ut": 3.0}, ["faults", "field_ut"]),
    ],
)
def test_a_slip_in_a_fault_is_reported_in_a_line(fault: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        scenario_with(fault)
    assert "\n" not in str(caught.value)
    assert [word for word in words if word not in str(caught.value)] == []


def test_without_faults_nothing_is_touched() -> None:
    never: list[Fault] = [GpsLost(kind="gps_lost", start_s=500.0)]
    assert fly(3, 3.0, never) == fly(3, 3.0)


# ---------------- The faulty line: what it loses, when things arrive and in which order

SENT = [0.02 * k for k in range(5000)]


def arrivals(seed: int = 1, **settings: float) -> list[float | None]:
    way = LinkChannel(LinkSettings.model_validate(settings), np.random.default_rng(seed))
    return [way.arrival_s(sent) for sent in SENT]


def delays(**settings: float) -> list[float]:
    """Of what arrives."""
    pairs = zip(SENT, arrivals(1, **settings), strict=True)
    return [arrival - sent for sent, arrival in pairs if arrival is not None]


def test_a_perfect_line_carries_all_at_once_and_a_lossy_one_a_share() -> None:
    assert arrivals() == SENT
    assert len(delays(loss_share=0.2)) / len(SENT) == pytest.approx(0.8, abs=0.02)
    assert delays(loss_share=1.0) == []


def test_the_delay_is_the_settings_and_varies_by_the_jitter() -> None:
    late = delays(delay_s=0.1, jitter_s=0.015)
    assert min(late) == pytest.approx(0.1, abs=0.001)
    assert max(late) == pytest.approx(0.115, abs=0.001)
    assert np.mean(late) == pytest.approx(0.1075, abs=0.001)


def test_jitter_keeps_the_order_even_when_longer_than_the_pauses_and_reordered_ones_are_overtaken() -> None:
    for settings, share in (({"jitter_s": 0.2}, 0.0), ({"reorder_share": 0.1, "reorder_hold_s": 0.05}, 0.1)):
        when = [arrival for arrival in arrivals(1, **settings) if arrival is not None]
        overtaken = sum(a >= b for a, b in pairwise(when))
        assert overtaken / len(when) == pytest.approx(share, abs=0.2 * share)


def test_a_seed_gives_one_line() -> None:
    bad = {"loss_share": 0.3, "jitter_s": 0.1, "reorder_share": 0.1}
    assert arrivals(4, **bad) == arrivals(4, **bad)
    assert arrivals(4, **bad) != arrivals(5, **bad)


# ----------------
# Every sensor lost, stuck, aside and with spikes: the drivers read it during the fault and not after.

EPOCH_S = 0.21  # between two fixes


def test_a_stuck_imu_repeats_itself(healthy: DriverSamples) -> None:
    heard = flown("imu_stuck")
    assert len({(s.rate_body_rad_s, s.specific_force_body_m_s2) for s in during(heard.imu)}) == 1
    # the driver hands on nothing that repeats for long, notices in the end, and starts the chip anew
    assert len(during(heard.imu)) < 20
    assert len({s.rate_body_rad_s for s in heard.imu if s.time_s > END_S + 1.0}) > 100
    assert len({s.rate_body_rad_s for s in during(healthy.imu)}) > 100


@pytest.mark.parametrize(
    ("kind", "values", "name", "least"),
    [
        ("gyro_spikes", {"share": 0.1, "size_deg_s": 200.0}, RATE, 0.5),
        ("accel_spikes", {"share": 0.1, "size_m_s2": 40.0}, FORCE, 8.0),
    ],
)
def test_imu_spikes_are_now_and_then_on_their_own_part(
    healthy: DriverSamples, kind: str, values: dict[str, float], name: str, least: float
) -> None:
    heard = flown(kind, **values)
    ours, theirs = (np.array([getattr(s, name) for s in during(h.imu)]) for h in (heard, healthy))
    # the chip samples between two steps, so that a spike may be halved and shared by two samples
    off = np.abs(ours - theirs)
    assert 0.08 < (off.max(axis=1) > 1e-6).mean() < 0.4
    assert off.max() > least
    (other,) = {RATE, FORCE} - {name}
    assert [getattr(s, other) for s in heard.imu] == [getattr(s, other) for s in healthy.imu]


@pytest.mark.parametrize("kind", ["mag_lost", "mag_stuck"])
def test_a_lost_or_stuck_magnetometer_measures_nothing_new(healthy: DriverSamples, kind: str) -> None:
    heard = flown(kind)
    assert len({s.field_body_ut for s in during(heard.mag)}) <= 1
    assert len({s.field_body_ut for s in during(healthy.mag)}) > 50
    assert len({s.field_body_ut for s in elsewhere(heard.mag)}) > 100


def test_magnetometer_spikes_are_a_share(healthy: DriverSamples) -> None:
    heard = flown("mag_spikes", share=0.2, size_ut=300.0)
    ours, theirs = (np.array([s.field_body_ut for s in during(h.mag)]) for h in (heard, healthy))
    assert 0.1 < (np.abs(ours - theirs).max(axis=1) > 1.0).mean() < 0.3
    assert elsewhere(heard.mag) == elsewhere(healthy.mag)


def off_m(heard: DriverSamples, healthy: DriverSamples) -> list[tuple[float, FloatArray]]:
    """By how much (north, east) each fix is off what it would have been, and its time."""

    def place(fix: GpsFix) -> Vector3:
        return ned_from_geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m, (47.0, 8.0, 400.0))

    return [
        (mine.time_s, np.subtract(place(mine)[:2], place(theirs)[:2]))
        for mine, theirs in zip(heard.fixes, healthy.fixes, strict=True)
    ]


def test_a_jump_moves_every_fix_and_is_over_with_the_fault(healthy: DriverSamples) -> None:
    for time_s, off in off_m(flown("gps_jump", position_ned_m=(6.0, -3.0, 0.0)), healthy):
        if min(abs(time_s - START_S), abs(time_s - END_S)) >= EPOCH_S:
            expected = (6.0, -3.0) if START_S < time_s < END_S else (0.0, 0.0)
            assert off == pytest.approx(expected, abs=0.05)


def test_a_stuck_gps_repeats_its_place_while_its_time_runs_on(healthy: DriverSamples) -> None:
    heard, after = flown("gps_stuck"), END_S + EPOCH_S
    stuck = [fix for fix in heard.fixes if START_S + EPOCH_S < fix.time_s < END_S - EPOCH_S]
    assert len({(fix.latitude_deg, fix.longitude_deg) for fix in stuck}) == 1
    assert len({fix.time_s for fix in stuck}) == len(stuck) > 5
    assert [f for f in heard.fixes if f.time_s > after] == [f for f in healthy.fixes if f.time_s > after]


def test_gps_spikes_are_some_fixes_far_off(healthy: DriverSamples) -> None:
    off = [np.abs(off).max() for _, off in off_m(flown("gps_spikes", share=0.5, size_m=50.0), healthy)]
    # one axis in three is the height
    assert 1 <= sum(distance > 1.0 for distance in off) <= 9


@pytest.mark.parametrize("unplugged", [False, True])
def test_an_ultrasonic_that_is_lost_gives_no_distance(healthy: DriverSamples, unplugged: bool) -> None:
    heard = flown("range_lost", unplugged=unplugged)
    assert [echo for echo in during(heard.echoes) if 0.0 < echo.distance_m < 4.5] == []
    assert len(during(healthy.echoes)) > 20
    assert [echo for echo in heard.echoes if echo.time_s > END_S + 0.3]


@pytest.mark.parametrize("distance_m", [0.42, None])
def test_an_ultrasonic_that_is_stuck_shows_one_distance(distance_m: float | None) -> None:
    (shown,) = {round(e.distance_m, 3) for e in during(flown("range_stuck", distance_m=distance_m).echoes)}
    assert shown == 0.42 if distance_m is not None else 1.0 < shown < 2.5


def test_a_step_of_the_ultrasonics_zero_adds_to_every_echo(healthy: DriverSamples) -> None:
    after, before = (
        np.median([echo.distance_m for echo in during(h.echoes)])
        for h in (flown("range_bias_step", distance_m=0.25), healthy)
    )
    assert after - before == pytest.approx(0.25, abs=0.01)


def test_a_board_that_slips_feels_gravity_and_field_from_another_side(healthy: DriverSamples) -> None:
    # GIVEN a board that slips by 20 deg about forward within 0.4 s
    heard = flown("imu_turned", rotation_body_deg=(20.0, 0.0, 0.0), slips_for_s=0.4)
    # THEN it has felt that turn, and then feels gravity and the field where they are for it
    slip = [s.rate_body_rad_s[0] for s in heard.imu if START_S <= s.time_s < START_S + 0.5]
    assert 0.5 * np.mean(slip) == pytest.approx(np.radians(20.0), abs=np.radians(1.5))

    def then(samples: list[Any], name: str) -> FloatArray:
        return np.asarray(mean([s for s in during(samples) if s.time_s > START_S + 0.5], name))

    leaning = [np.degrees(np.arctan2(*-then(h.imu, FORCE)[1:])) for h in (heard, healthy)]
    assert leaning[0] == pytest.approx(leaning[1] + 20.0, abs=0.5)
    assert np.linalg.norm(then(heard.mag, "field_body_ut") - then(healthy.mag, "field_body_ut")) > 10.0
