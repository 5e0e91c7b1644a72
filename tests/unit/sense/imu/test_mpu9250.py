"""The MPU9250's driver: units, axes, scales, times and settings, on the simulated chip's registers."""

import math
import struct

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.config import ConfigError, ImuConfig, validate
from companion.sense.imu.ak8963 import Ak8963
from companion.sense.imu.ak8963_path import BypassPath
from companion.sense.imu.sample_clock import SampleClock
from tests.unit.sense.imu.imu_rig import FIELD, ImuRig

# ---------------------------------------------------------------- units, axes, scales


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, -90.0])
@pytest.mark.parametrize("roll_deg", [0.0, 180.0])
def test_any_mounting_gives_the_same_body_values(roll_deg: float, yaw_deg: float) -> None:
    rig = ImuRig(ImuConfig(body_from_sensor_deg=(roll_deg, 0.0, yaw_deg)))
    truth = ((1.0, -2.0, -9.0), (0.3, -0.2, 0.1), (20.0, -5.0, 40.0))
    rig.run(0.7, lambda _now_s: truth)
    newest, field = rig.imu[-1], np.mean([m.field_body_ut for m in rig.mag], axis=0)
    assert newest.specific_force_body_m_s2 == pytest.approx(truth[0], abs=0.04)
    assert newest.rate_body_rad_s == pytest.approx(truth[1], abs=0.001)
    assert field == pytest.approx(truth[2], abs=0.3)


@pytest.mark.parametrize("gyro_range", [250, 500, 1000, 2000])
@pytest.mark.parametrize("accel_range", [2, 4, 8, 16])
def test_every_range_is_scaled_alike_and_clips_at_its_end(gyro_range: int, accel_range: int) -> None:
    config = ImuConfig.model_validate({"gyro_range_deg_s": gyro_range, "accel_range_g": accel_range})
    inside = (
        (0.0, 0.0, -0.9 * accel_range * GRAVITY_M_S2),
        (math.radians(0.9 * gyro_range), 0.0, 0.0),
        FIELD,
    )
    rig = ImuRig(config)
    rig.run(0.5, lambda _now_s: inside)
    assert rig.imu[-1].specific_force_body_m_s2[2] == pytest.approx(inside[0][2], abs=0.04)
    assert rig.imu[-1].rate_body_rad_s[0] == pytest.approx(inside[1][0], rel=1e-3)
    beyond = (
        (0.0, 0.0, -1.5 * accel_range * GRAVITY_M_S2),
        (math.radians(1.5 * gyro_range), 0.0, 0.0),
        FIELD,
    )
    rig = ImuRig(config)
    rig.run(0.5, lambda _now_s: beyond)
    assert rig.imu[-1].specific_force_body_m_s2[2] == pytest.approx(-accel_range * GRAVITY_M_S2, abs=0.04)
    assert rig.imu[-1].rate_body_rad_s[0] == pytest.approx(math.radians(gyro_range), rel=1e-3)


def test_magnetometer_block_is_decoded_with_swapped_axes_and_little_endian() -> None:
    block = struct.pack("<BhhhB", 0x01, 100, -200, 300, 0x10)
    # without the fuse ROM's values: 0.15 µT a step
    decoded = Ak8963(BypassPath(_NoBus()), 100).decode(block)
    assert decoded is not None
    field, newest = decoded
    assert field == pytest.approx((-30.0, 15.0, -45.0))
    assert newest


@pytest.mark.parametrize("status_2", [0x18, 0x08, 0x00])
def test_magnetometer_overflow_or_wrong_width_is_no_measurement(status_2: int) -> None:
    block = struct.pack("<BhhhB", 0x01, 100, -200, 300, status_2)
    assert Ak8963(BypassPath(_NoBus()), 100).decode(block) is None


class _NoBus:
    def read(self, address: int, register: int, length: int) -> bytes:
        raise OSError(address, register, length)

    def write(self, address: int, register: int, value: int) -> None:
        raise OSError(address, register, value)


# ---------------------------------------------------------------- time


def test_no_sample_is_lost_or_doubled() -> None:
    rig = ImuRig(clock_error=0.0)
    rig.run(3.0)
    times = [s.time_s for s in rig.imu]
    assert np.abs(np.diff(times) - 0.005).max() < 0.0003
    assert len(rig.imu) == pytest.approx((times[-1] - times[0]) * 200.0 + 1.0, abs=1.0)
    since_mag = [t for t in times if t > rig.mag[0].time_s]
    assert len(rig.mag) == pytest.approx(len(since_mag) / 2.0, rel=0.03)


def test_samples_after_a_late_poll_keep_their_spacing() -> None:
    rig = ImuRig()
    rig.run(3.0)
    count = len(rig.imu)
    rig.run(0.12, polling=False)
    rig.run(0.3)
    assert not rig.faults
    assert len(rig.imu) - count > 80
    assert np.abs(np.diff([s.time_s for s in rig.imu[-100:]]) - 0.005).max() < 0.0001


def test_sample_clock_is_not_bent_by_late_or_early_stamped_reads() -> None:
    clock = SampleClock(0.005)
    rng = np.random.default_rng(3)
    true_period, taken, newest_error = 0.00502, 0, 0.0
    for k in range(1, 3000):
        read_s = 0.01 * k + (0.03 if rng.random() < 0.02 else 0.0)
        # the reader took its time stamp before a stall in one read of fifty
        stamp_s = read_s - (0.02 if rng.random() < 0.02 else 0.0)
        count = int(read_s / true_period) - taken
        if count <= 0:
            continue
        taken += count
        newest_error = clock.stamp(stamp_s, count)[-1] - taken * true_period
        if k > 1500:
            assert abs(newest_error) < 0.0015
    assert clock.period_s == pytest.approx(true_period, rel=5e-4)


def test_sample_clock_starts_again_when_samples_vanished_unnoticed() -> None:
    clock = SampleClock(0.005)
    for k in range(200):
        clock.stamp(0.01 * k, 2)
    # half a second without samples and without a word
    for k in range(250, 300):
        stamps = clock.stamp(0.01 * k, 2)
    assert stamps[-1] == pytest.approx(2.99 - 0.0025, abs=0.005)


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"rate_hz": 300}, "a divisor of 1000"),
        ({"rate_hz": 1000, "poll_hz": 50}, "expected at least 56"),
    ],
)
def test_rates_that_do_not_fit_the_chip_are_refused(settings: dict[str, int], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        validate(ImuConfig, settings, "test.yaml")


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
@pytest.mark.parametrize("filter_hz", [184, 92, 41, 20])
def test_every_rate_and_filter_flows(rate_hz: int, filter_hz: int) -> None:
    rig = ImuRig(ImuConfig.model_validate({"rate_hz": rate_hz, "filter_hz": filter_hz}))
    rig.run(1.0)
    assert not rig.faults
    assert len(rig.imu) > 0.5 * rate_hz


def test_a_count_that_was_too_large_once_does_not_keep_the_clock_ahead() -> None:
    clock, newest_s = SampleClock(0.005), 0.0
    for k in range(1, 400):
        newest_s = clock.stamp(0.01 * k, 30 if k == 200 else 2)[-1]
    assert abs(newest_s - 3.99) < 0.006
