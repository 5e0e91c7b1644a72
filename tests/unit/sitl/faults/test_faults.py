"""Faults: each shows in what the drivers read, during its time and not after it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.base.geometry import GRAVITY_M_S2, ned_from_geodetic
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import ConfigError
from sitl.camera.frame_line import FrameLine
from sitl.faults.faults import (
    AccelBiasStep,
    AccelClips,
    AccelSpikes,
    Fault,
    FrameLate,
    FrameLost,
    GpsFrozen,
    GpsJump,
    GpsLost,
    GpsSpikes,
    GyroBiasStep,
    GyroSpikes,
    ImuBusError,
    ImuFrozen,
    ImuLost,
    MagDisturbed,
    MagFrozen,
    MagLost,
    MagSpikes,
    RangeBiasStep,
    RangeLost,
    RangeSpikes,
    RangeStuck,
)
from sitl.scenario.scenario import load_scenario
from tests.unit.sitl.devices.sensor_desk import Heard, fly

START_S, END_S, SECONDS = 6.0, 8.0, 10.0
TIMES: dict[str, Any] = {"start_s": START_S, "duration_s": END_S - START_S}
FORCE = "specific_force_body_m_s2"
EPOCH_S = 0.21  # between two fixes
SETTLE_S = 0.05  # the filters' delay, and samples that are averages


@pytest.fixture(scope="module")
def healthy() -> Heard:
    return fly(3, SECONDS)


Sample = ImuSample | MagSample | GpsFix | RangeSample


def during(samples: list[Any]) -> list[Any]:
    return [sample for sample in samples if START_S + SETTLE_S < sample.time_s < END_S - SETTLE_S]


def elsewhere(samples: list[Any]) -> list[Any]:
    """Before the fault, and after it."""
    return [s for s in samples if s.time_s < START_S - SETTLE_S or s.time_s > END_S + SETTLE_S]


def mean(samples: list[Any], name: str) -> Any:
    return np.mean([getattr(sample, name) for sample in samples], axis=0)


# ---------------------------------------------------------------- one by one


@pytest.mark.parametrize("unplugged", [False, True])
def test_without_gps_there_are_no_fixes_for_as_long(healthy: Heard, unplugged: bool) -> None:
    heard = fly(3, SECONDS, [GpsLost(kind="gps_lost", unplugged=unplugged, **TIMES)])
    assert len(during(healthy.fixes)) == pytest.approx(10, abs=1)
    # a message that is on the line when the sky goes still arrives
    assert during(heard.fixes) == [] or during(heard.fixes)[-1].time_s < START_S + 0.2
    assert [fix for fix in heard.fixes if fix.time_s > END_S + 0.5]


def test_a_stray_field_adds_to_the_earths_in_body_axes(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [MagDisturbed(kind="mag_disturbed", field_body_ut=(0.0, 30.0, -10.0), **TIMES)])
    added = mean(during(heard.mag), "field_body_ut") - mean(during(healthy.mag), "field_body_ut")
    # 1 % of soft iron
    assert added == pytest.approx((0.0, 30.0, -10.0), abs=1.5)
    assert elsewhere(heard.mag) == elsewhere(healthy.mag)


def test_a_bias_step_adds_to_every_rate(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [GyroBiasStep(kind="gyro_bias_step", rate_body_deg_s=(2.0, 0.0, -1.0), **TIMES)])
    added = mean(during(heard.imu), "rate_body_rad_s") - mean(during(healthy.imu), "rate_body_rad_s")
    assert np.degrees(added) == pytest.approx((2.0, 0.0, -1.0), abs=0.05)
    assert mean(during(heard.imu), "specific_force_body_m_s2") == pytest.approx(
        mean(during(healthy.imu), "specific_force_body_m_s2")
    )
    assert elsewhere(heard.imu)[-100:] == elsewhere(healthy.imu)[-100:]


def test_a_clipping_accelerometer_reads_less_than_gravity_for_it_loses_the_peaks(healthy: Heard) -> None:
    clips = AccelClips(kind="accel_clips", range_g=1.1, vibration_factor=5.0, **TIMES)
    heard = fly(3, SECONDS, [clips])
    down = [sample.specific_force_body_m_s2[2] for sample in during(heard.imu)]
    # the low-pass filter that follows the element overshoots a little
    assert min(down) > -1.2 * GRAVITY_M_S2
    assert np.mean(down) > mean(during(healthy.imu), "specific_force_body_m_s2")[2] + 0.3
    assert np.std(down) > 2.0 * np.std([s.specific_force_body_m_s2[2] for s in during(healthy.imu)])


def test_spikes_are_echoes_from_in_between(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [RangeSpikes(kind="range_spikes", share=0.5, **TIMES)])
    wrong = [echo for echo in during(heard.echoes) if echo.distance_m < 1.7]
    assert 0.25 < len(wrong) / len(during(heard.echoes)) < 0.75
    assert len([echo for echo in during(healthy.echoes) if echo.distance_m < 1.7]) <= 2
    assert [e.distance_m for e in elsewhere(heard.echoes)] == [
        e.distance_m for e in elsewhere(healthy.echoes)
    ]


def test_a_bus_that_fails_now_and_then_costs_no_sample_and_one_that_is_off_is_told() -> None:
    now_and_then = fly(3, SECONDS, [ImuBusError(kind="imu_bus_error", every=40, **TIMES)])
    assert len(during(now_and_then.imu)) == pytest.approx(380, abs=12)
    off = fly(3, SECONDS, [ImuBusError(kind="imu_bus_error", every=1, **TIMES)])
    assert len(during(off.imu)) < 20
    assert any("Remote I/O error" in problem for problem in off.problems)
    assert [sample for sample in off.imu if sample.time_s > END_S + 1.0]


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


# ---------------------------------------------------------------- lost, frozen, aside, spikes: every sensor


def test_an_imu_that_is_lost_is_told_of_and_comes_back() -> None:
    heard = fly(3, SECONDS, [ImuLost(kind="imu_lost", **TIMES)])
    assert len(during(heard.imu)) < 20
    assert any("Remote I/O error" in problem for problem in heard.problems)
    assert [sample for sample in heard.imu if sample.time_s > END_S + 1.0]


def test_a_frozen_imu_repeats_itself(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [ImuFrozen(kind="imu_frozen", **TIMES)])
    frozen = {(s.rate_body_rad_s, s.specific_force_body_m_s2) for s in during(heard.imu)}
    assert len(frozen) == 1
    # the driver notices in the end, and starts the chip anew
    assert len(during(heard.imu)) > 100
    assert len({s.rate_body_rad_s for s in heard.imu if s.time_s > END_S + 1.0}) > 100
    assert len({s.rate_body_rad_s for s in during(healthy.imu)}) > 100


def test_a_step_of_the_accelerometers_zero_adds_to_every_force(healthy: Heard) -> None:
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
    healthy: Heard, fault: Fault, name: str, least: float
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


def test_a_lost_magnetometer_measures_nothing_new(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [MagLost(kind="mag_lost", **TIMES)])
    assert len({s.field_body_ut for s in during(heard.mag)}) <= 1
    assert len({s.field_body_ut for s in during(healthy.mag)}) > 50


def test_a_frozen_magnetometer_repeats_itself(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [MagFrozen(kind="mag_frozen", **TIMES)])
    assert len({s.field_body_ut for s in during(heard.mag)}) == 1
    assert len({s.field_body_ut for s in during(healthy.mag)}) > 50
    assert len({s.field_body_ut for s in elsewhere(heard.mag)}) > 100


def test_magnetometer_spikes_are_a_share(healthy: Heard) -> None:
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


def test_a_jump_moves_every_fix_and_is_over_with_the_fault(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [GpsJump(kind="gps_jump", position_ned_m=(6.0, -3.0, 0.0), **TIMES)])
    for mine, theirs in zip(heard.fixes, healthy.fixes, strict=True):
        if min(abs(mine.time_s - START_S), abs(mine.time_s - END_S)) < EPOCH_S:
            continue
        jumped = START_S < mine.time_s < END_S
        off = np.subtract(place(mine), place(theirs))
        assert off == pytest.approx((6.0, -3.0) if jumped else (0.0, 0.0), abs=0.05)


def test_a_frozen_gps_repeats_its_place_while_its_time_runs_on(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [GpsFrozen(kind="gps_frozen", **TIMES)])
    frozen = [fix for fix in heard.fixes if START_S + EPOCH_S < fix.time_s < END_S - EPOCH_S]
    assert len({(fix.latitude_deg, fix.longitude_deg) for fix in frozen}) == 1
    assert len({fix.time_s for fix in frozen}) == len(frozen) > 5
    after = END_S + EPOCH_S
    assert [f for f in heard.fixes if f.time_s > after] == [f for f in healthy.fixes if f.time_s > after]


def test_gps_spikes_are_some_fixes_far_off(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [GpsSpikes(kind="gps_spikes", share=0.5, size_m=50.0, **TIMES)])
    off = [
        float(np.abs(np.subtract(place(a), place(b))).max())
        for a, b in zip(heard.fixes, healthy.fixes, strict=True)
    ]
    # one axis in three is the height
    assert 1 <= sum(distance > 1.0 for distance in off) <= 9


@pytest.mark.parametrize("unplugged", [False, True])
def test_an_ultrasonic_that_is_lost_gives_no_distance(healthy: Heard, unplugged: bool) -> None:
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


def test_a_step_of_the_ultrasonics_zero_adds_to_every_echo(healthy: Heard) -> None:
    heard = fly(3, SECONDS, [RangeBiasStep(kind="range_bias_step", distance_m=0.25, **TIMES)])

    def middle(echoes: list[Any]) -> float:
        return float(np.median([echo.distance_m for echo in echoes]))

    assert middle(during(heard.echoes)) - middle(during(healthy.echoes)) == pytest.approx(0.25, abs=0.01)


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
def test_a_slip_in_a_fault_is_told_in_a_line(tmp_path: Path, fault: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(scenario_with(tmp_path, fault))
    assert "\n" not in str(caught.value)
    assert [word for word in words if word not in str(caught.value)] == []


def test_without_faults_nothing_is_touched() -> None:
    never: list[Fault] = [GpsLost(kind="gps_lost", start_s=500.0)]
    assert fly(3, 3.0, never) == fly(3, 3.0)
