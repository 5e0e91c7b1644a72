"""Every sensor lost, stuck, aside and with spikes: the drivers read it during the fault and not after."""

from typing import Any

import numpy as np
import pytest

from companion.base.geometry import ned_from_geodetic
from companion.base.messages import GpsFix
from sitl.faults.faults import (
    AccelBiasStep,
    AccelSpikes,
    Fault,
    GpsJump,
    GpsSpikes,
    GpsStuck,
    GyroSpikes,
    ImuStuck,
    ImuTurned,
    MagLost,
    MagSpikes,
    MagStuck,
    RangeBiasStep,
    RangeLost,
    RangeStuck,
)
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
