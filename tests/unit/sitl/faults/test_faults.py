"""Faults: each shows in what the drivers read, during its time and not after it."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.base.geometry import GRAVITY_M_S2
from companion.config import ConfigError
from sitl.camera.frame_line import FrameLine
from sitl.faults.faults import (
    AccelClips,
    Fault,
    FrameLate,
    FrameLost,
    GpsLost,
    GyroBiasStep,
    ImuBusError,
    ImuLost,
    MagDisturbed,
    RangeSpikes,
    Vibration,
)
from sitl.scenario.scenario import load_scenario
from tests.unit.sitl.devices.sensor_desk import DriverSamples, fly
from tests.unit.sitl.faults.fault_readings import (
    END_S,
    SECONDS,
    START_S,
    TIMES,
    during,
    elsewhere,
    mean,
)

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
