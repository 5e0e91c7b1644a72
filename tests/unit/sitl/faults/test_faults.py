"""Faults: each shows in what the drivers read, during its time and not after it."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.base.geometry import GRAVITY_M_S2, ned_from_geodetic
from companion.base.messages import GpsFix
from companion.config import ConfigError
from sitl.faults.faults import (
    AccelBiasStep,
    AccelClips,
    AccelSpikes,
    Fault,
    FrameLate,
    FrameLost,
    GpsJump,
    GpsLost,
    GpsSpikes,
    GpsStuck,
    GyroBiasStep,
    GyroSpikes,
    ImuBusError,
    ImuLost,
    ImuStuck,
    ImuTurned,
    MagDisturbed,
    MagLost,
    MagSpikes,
    MagStuck,
    RangeBiasStep,
    RangeLost,
    RangeSpikes,
    RangeStuck,
    Vibration,
)
from sitl.faults.lines import FrameLine, LinkChannel, LinkSettings
from sitl.scenario.scenario import load_scenario
from tests.unit.sitl.devices.sensor_desk import DriverSamples, fly
from tests.unit.sitl.faults.fault_readings import END_S, SECONDS, START_S, TIMES, during, elsewhere, mean

# ---------------------------------------------------------------- one by one


@pytest.mark.parametrize("unplugged", [False, True])
def test_without_gps_there_are_no_fixes_for_as_long(healthy: DriverSamples, unplugged: bool) -> None:
    heard = fly(3, SECONDS, [GpsLost(kind="gps_lost", unplugged=unplugged, **TIMES)])
    assert len(during(healthy.fixes)) == pytest.approx(10, abs=1)
    # a message that is on the line when the sky goes still arrives
    assert during(heard.fixes) == [] or during(heard.fixes)[-1].time_s < START_S + 0.2
    assert [fix for fix in heard.fixes if fix.time_s > END_S + 0.5]


def test_a_stray_field_adds_to_the_earths_in_body_axes(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [MagDisturbed(kind="mag_disturbed", field_body_ut=(0.0, 30.0, -10.0), **TIMES)])
    added = mean(during(heard.mag), "field_body_ut") - mean(during(healthy.mag), "field_body_ut")
    # 1 % of soft iron
    assert added == pytest.approx((0.0, 30.0, -10.0), abs=1.5)
    assert elsewhere(heard.mag) == elsewhere(healthy.mag)


def test_a_bias_step_adds_to_every_rate(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [GyroBiasStep(kind="gyro_bias_step", rate_body_deg_s=(2.0, 0.0, -1.0), **TIMES)])
    added = mean(during(heard.imu), "rate_body_rad_s") - mean(during(healthy.imu), "rate_body_rad_s")
    assert np.degrees(added) == pytest.approx((2.0, 0.0, -1.0), abs=0.05)
    assert mean(during(heard.imu), "specific_force_body_m_s2") == pytest.approx(
        mean(during(healthy.imu), "specific_force_body_m_s2")
    )
    assert elsewhere(heard.imu)[-100:] == elsewhere(healthy.imu)[-100:]


def test_a_clipping_accelerometer_reads_less_than_gravity_for_it_loses_the_peaks(
    healthy: DriverSamples,
) -> None:
    clips = AccelClips(kind="accel_clips", range_g=1.1, vibration_factor=5.0, **TIMES)
    heard = fly(3, SECONDS, [clips])
    down = [sample.specific_force_body_m_s2[2] for sample in during(heard.imu)]
    # the low-pass filter that follows the element overshoots a little
    assert min(down) > -1.2 * GRAVITY_M_S2
    assert np.mean(down) > mean(during(healthy.imu), "specific_force_body_m_s2")[2] + 0.3
    assert np.std(down) > 2.0 * np.std([s.specific_force_body_m_s2[2] for s in during(healthy.imu)])


def test_stronger_vibration_shakes_and_leaves_the_mean(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [Vibration(kind="vibration", factor=4.0, **TIMES)])
    before, shaken = (
        np.array([sample.specific_force_body_m_s2 for sample in during(h.imu)]) for h in (healthy, heard)
    )
    assert 3.0 < np.std(shaken[:, 0]) / np.std(before[:, 0]) < 5.0
    assert shaken.mean(axis=0) == pytest.approx(before.mean(axis=0), abs=0.1)


def test_spikes_are_echoes_from_in_between(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [RangeSpikes(kind="range_spikes", share=0.5, **TIMES)])
    wrong = [echo for echo in during(heard.echoes) if echo.distance_m < 1.7]
    assert 0.25 < len(wrong) / len(during(heard.echoes)) < 0.75
    assert len([echo for echo in during(healthy.echoes) if echo.distance_m < 1.7]) <= 2
    assert [e.distance_m for e in elsewhere(heard.echoes)] == [
        e.distance_m for e in elsewhere(healthy.echoes)
    ]


def test_a_bus_that_fails_now_and_then_costs_no_sample() -> None:
    heard = fly(3, SECONDS, [ImuBusError(kind="imu_bus_error", every=40, **TIMES)])
    assert len(during(heard.imu)) == pytest.approx(380, abs=12)


@pytest.mark.parametrize(
    "fault", [ImuBusError(kind="imu_bus_error", every=1, **TIMES), ImuLost(kind="imu_lost", **TIMES)]
)
def test_an_imu_that_is_off_is_reported_and_comes_back(fault: Fault) -> None:
    heard = fly(3, SECONDS, [fault])
    assert len(during(heard.imu)) < 20
    assert any("Remote I/O error" in problem for problem in heard.problems)
    assert [sample for sample in heard.imu if sample.time_s > END_S + 1.0]


def test_every_tenth_frame_comes_a_quarter_of_a_second_late() -> None:
    line = FrameLine(np.random.default_rng(0))
    line.late_s, line.late_every = 0.25, 10
    assert [line.delay_s(k) for k in range(12)] == [0.25, *[0.0] * 9, 0.25, 0.0]
    line.clear_faults()
    assert line.delay_s(20) == 0.0


def test_a_share_of_the_frames_is_lost_and_a_stalled_camera_gives_none() -> None:
    line = FrameLine(np.random.default_rng(0))
    line.lost_share = 0.3
    assert 0.2 < np.mean([line.delay_s(k) is None for k in range(500)]) < 0.4
    line.lost_share = 1.0
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
    garbled = line.carried(second)
    whole = (garbled == 20).all(axis=1)
    row = int(np.argmin(whole))
    assert whole[:row].all()
    assert not whole[row:].any()
    assert (second == 20).all()  # the camera's own picture is not touched


# ---------------------------------------------------------------- together


def test_faults_overlap_and_mending_one_leaves_the_other() -> None:
    one = GyroBiasStep(kind="gyro_bias_step", rate_body_deg_s=(1.0, 0.0, 0.0), start_s=5.0, duration_s=2.0)
    other = GyroBiasStep(kind="gyro_bias_step", rate_body_deg_s=(2.0, 0.0, 0.0), start_s=6.0, duration_s=2.0)
    rates = fly(3, 9.0, [one, other]).imu
    before = np.mean([s.rate_body_rad_s[0] for s in rates if 4.0 < s.time_s < 4.9])

    def added_deg_s(start_s: float, end_s: float) -> float:
        seen = [s.rate_body_rad_s[0] for s in rates if start_s < s.time_s < end_s]
        return math.degrees(np.mean(seen) - before)

    assert added_deg_s(5.1, 5.9) == pytest.approx(1.0, abs=0.05)
    assert added_deg_s(6.1, 6.9) == pytest.approx(3.0, abs=0.05)
    assert added_deg_s(7.1, 7.9) == pytest.approx(2.0, abs=0.05)
    assert added_deg_s(8.1, 8.9) == pytest.approx(0.0, abs=0.05)


# ---------------------------------------------------------------- as scenario data


def scenario_with(tmp_path: Path, *faults: dict[str, Any]) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"name": "mine", "description": "mine", "faults": list(faults)}))
    return path


def test_a_scenario_lists_faults_by_kind(tmp_path: Path) -> None:
    path = scenario_with(
        tmp_path,
        {"kind": "frame_late", "start_s": 18.0, "every": 5},
        {"kind": "frame_lost", "start_s": 20.0, "duration_s": 1.0},
    )
    late, lost = load_scenario(path).faults
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
def test_a_slip_in_a_fault_is_reported_in_a_line(
    tmp_path: Path, fault: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(scenario_with(tmp_path, fault))
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


def test_a_perfect_line_carries_all_at_once() -> None:
    assert arrivals() == SENT


def test_a_share_is_lost() -> None:
    assert len(delays(loss_share=0.2)) / len(SENT) == pytest.approx(0.8, abs=0.02)
    assert delays(loss_share=1.0) == []


def test_the_delay_is_the_settings_and_varies_by_the_jitter() -> None:
    late = delays(delay_s=0.1, jitter_s=0.015)
    assert min(late) == pytest.approx(0.1, abs=0.001)
    assert max(late) == pytest.approx(0.115, abs=0.001)
    assert np.mean(late) == pytest.approx(0.1075, abs=0.001)


def test_jitter_alone_keeps_the_order_even_when_it_is_longer_than_the_pauses() -> None:
    when = [arrival for arrival in arrivals(jitter_s=0.2) if arrival is not None]
    assert all(a < b for a, b in pairwise(when))


def test_reordered_ones_are_overtaken() -> None:
    when = [arrival for arrival in arrivals(reorder_share=0.1, reorder_hold_s=0.05) if arrival is not None]
    overtaken = sum(a > b for a, b in pairwise(when))
    assert overtaken / len(when) == pytest.approx(0.1, abs=0.02)


def test_a_blackout_lets_nothing_through_and_then_everything() -> None:
    way = LinkChannel(LinkSettings(), np.random.default_rng(0))
    way.cut = True
    assert way.arrival_s(1.0) is None
    way.cut = False
    assert way.arrival_s(2.0) == 2.0


def test_a_seed_gives_one_line() -> None:
    bad = {"loss_share": 0.3, "jitter_s": 0.1, "reorder_share": 0.1}
    assert arrivals(4, **bad) == arrivals(4, **bad)
    assert arrivals(4, **bad) != arrivals(5, **bad)


# ----------------
# Every sensor lost, stuck, aside and with spikes: the drivers read it during the fault and not after.

EPOCH_S = 0.21  # between two fixes


def test_a_stuck_imu_repeats_itself(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [ImuStuck(kind="imu_stuck", **TIMES)])
    stuck = {(s.rate_body_rad_s, s.specific_force_body_m_s2) for s in during(heard.imu)}
    assert len(stuck) == 1
    # the driver hands on nothing that repeats for long, notices in the end, and starts the chip anew
    assert len(during(heard.imu)) < 20
    assert len({s.rate_body_rad_s for s in heard.imu if s.time_s > END_S + 1.0}) > 100
    assert len({s.rate_body_rad_s for s in during(healthy.imu)}) > 100


def test_a_step_of_the_accelerometers_zero_adds_to_every_force(healthy: DriverSamples) -> None:
    fault = AccelBiasStep(kind="accel_bias_step", force_body_m_s2=(0.5, 0.0, -0.3), **TIMES)
    heard = fly(3, SECONDS, [fault])
    name = "specific_force_body_m_s2"
    added = mean(during(heard.imu), name) - mean(during(healthy.imu), name)
    assert added == pytest.approx((0.5, 0.0, -0.3), abs=0.02)
    assert mean(during(heard.imu), "rate_body_rad_s") == pytest.approx(
        mean(during(healthy.imu), "rate_body_rad_s")
    )


@pytest.mark.parametrize(
    ("fault", "name", "least"),
    [
        (GyroSpikes(kind="gyro_spikes", share=0.1, size_deg_s=200.0, **TIMES), "rate_body_rad_s", 0.5),
        (
            AccelSpikes(kind="accel_spikes", share=0.1, size_m_s2=40.0, **TIMES),
            "specific_force_body_m_s2",
            8.0,
        ),
    ],
)
def test_imu_spikes_are_now_and_then_on_their_own_part(
    healthy: DriverSamples, fault: Fault, name: str, least: float
) -> None:
    heard = fly(3, SECONDS, [fault])
    off = np.array([getattr(s, name) for s in during(heard.imu)])
    off -= np.array([getattr(s, name) for s in during(healthy.imu)])
    # the chip samples between two steps, so that a spike may be halved and shared by two samples
    spiked = np.abs(off).max(axis=1) > 1e-6
    assert 0.08 < spiked.mean() < 0.4
    assert np.abs(off).max() > least
    other = ({"rate_body_rad_s", "specific_force_body_m_s2"} - {name}).pop()
    assert [getattr(s, other) for s in heard.imu] == [getattr(s, other) for s in healthy.imu]


@pytest.mark.parametrize("fault", [MagLost(kind="mag_lost", **TIMES), MagStuck(kind="mag_stuck", **TIMES)])
def test_a_lost_or_stuck_magnetometer_measures_nothing_new(healthy: DriverSamples, fault: Fault) -> None:
    heard = fly(3, SECONDS, [fault])
    assert len({s.field_body_ut for s in during(heard.mag)}) <= 1
    assert len({s.field_body_ut for s in during(healthy.mag)}) > 50
    assert len({s.field_body_ut for s in elsewhere(heard.mag)}) > 100


def test_magnetometer_spikes_are_a_share(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [MagSpikes(kind="mag_spikes", share=0.2, size_ut=300.0, **TIMES)])
    pairs = zip(during(heard.mag), during(healthy.mag), strict=True)
    off = np.array([np.subtract(a.field_body_ut, b.field_body_ut) for a, b in pairs])
    assert 0.1 < (np.abs(off).max(axis=1) > 1.0).mean() < 0.3
    assert elsewhere(heard.mag) == elsewhere(healthy.mag)


def place(fix: GpsFix) -> tuple[float, float]:
    """North and east (m) of the home."""
    north, east, _ = ned_from_geodetic(
        fix.latitude_deg, fix.longitude_deg, fix.altitude_m, (47.0, 8.0, 400.0)
    )
    return north, east


def test_a_jump_moves_every_fix_and_is_over_with_the_fault(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [GpsJump(kind="gps_jump", position_ned_m=(6.0, -3.0, 0.0), **TIMES)])
    for mine, theirs in zip(heard.fixes, healthy.fixes, strict=True):
        if min(abs(mine.time_s - START_S), abs(mine.time_s - END_S)) < EPOCH_S:
            continue
        jumped = START_S < mine.time_s < END_S
        off = np.subtract(place(mine), place(theirs))
        assert off == pytest.approx((6.0, -3.0) if jumped else (0.0, 0.0), abs=0.05)


def test_a_stuck_gps_repeats_its_place_while_its_time_runs_on(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [GpsStuck(kind="gps_stuck", **TIMES)])
    stuck = [fix for fix in heard.fixes if START_S + EPOCH_S < fix.time_s < END_S - EPOCH_S]
    assert len({(fix.latitude_deg, fix.longitude_deg) for fix in stuck}) == 1
    assert len({fix.time_s for fix in stuck}) == len(stuck) > 5
    after = END_S + EPOCH_S
    assert [f for f in heard.fixes if f.time_s > after] == [f for f in healthy.fixes if f.time_s > after]


def test_gps_spikes_are_some_fixes_far_off(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [GpsSpikes(kind="gps_spikes", share=0.5, size_m=50.0, **TIMES)])
    off = [
        float(np.abs(np.subtract(place(a), place(b))).max())
        for a, b in zip(heard.fixes, healthy.fixes, strict=True)
    ]
    # one axis in three is the height
    assert 1 <= sum(distance > 1.0 for distance in off) <= 9


@pytest.mark.parametrize("unplugged", [False, True])
def test_an_ultrasonic_that_is_lost_gives_no_distance(healthy: DriverSamples, unplugged: bool) -> None:
    heard = fly(3, SECONDS, [RangeLost(kind="range_lost", unplugged=unplugged, **TIMES)])
    assert [echo for echo in during(heard.echoes) if 0.0 < echo.distance_m < 4.5] == []
    assert len(during(healthy.echoes)) > 20
    assert [echo for echo in heard.echoes if echo.time_s > END_S + 0.3]


@pytest.mark.parametrize("distance_m", [0.42, None])
def test_an_ultrasonic_that_is_stuck_shows_one_distance(distance_m: float | None) -> None:
    heard = fly(3, SECONDS, [RangeStuck(kind="range_stuck", distance_m=distance_m, **TIMES)])
    shown = {round(echo.distance_m, 3) for echo in during(heard.echoes)}
    assert len(shown) == 1
    assert shown == {0.42} if distance_m is not None else 1.0 < shown.pop() < 2.5


def test_a_step_of_the_ultrasonics_zero_adds_to_every_echo(healthy: DriverSamples) -> None:
    heard = fly(3, SECONDS, [RangeBiasStep(kind="range_bias_step", distance_m=0.25, **TIMES)])

    def middle(echoes: list[Any]) -> float:
        return float(np.median([echo.distance_m for echo in echoes]))

    assert middle(during(heard.echoes)) - middle(during(healthy.echoes)) == pytest.approx(0.25, abs=0.01)


def test_a_board_that_slips_feels_gravity_and_field_from_another_side(healthy: DriverSamples) -> None:
    # GIVEN a board that slips by 20 deg about forward within 0.4 s
    fault = ImuTurned(kind="imu_turned", rotation_body_deg=(20.0, 0.0, 0.0), slips_for_s=0.4, **TIMES)
    heard = fly(3, SECONDS, [fault])
    # THEN it has felt that turn, and then feels gravity and the field where they are for it
    slip = [s.rate_body_rad_s[0] for s in heard.imu if START_S <= s.time_s < START_S + 0.5]
    turned_rad = 0.5 * float(np.mean(slip))
    assert turned_rad == pytest.approx(np.radians(20.0), abs=np.radians(1.5))
    after = [s.specific_force_body_m_s2 for s in during(heard.imu) if s.time_s > START_S + 0.5]
    before = [s.specific_force_body_m_s2 for s in during(healthy.imu) if s.time_s > START_S + 0.5]
    assert np.degrees(np.arctan2(*np.mean(after, axis=0)[1:] * -1.0)) == pytest.approx(
        np.degrees(np.arctan2(*np.mean(before, axis=0)[1:] * -1.0)) + 20.0, abs=0.5
    )
    field_after = np.mean([s.field_body_ut for s in during(heard.mag) if s.time_s > START_S + 0.5], axis=0)
    field_before = np.mean([s.field_body_ut for s in during(healthy.mag) if s.time_s > START_S + 0.5], axis=0)
    assert np.linalg.norm(field_after - field_before) > 10.0
