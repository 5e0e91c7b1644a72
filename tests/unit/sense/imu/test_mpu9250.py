"""The MPU9250's driver: units, axes, scales, times and settings, on the simulated chip's registers."""

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.config import ConfigError, ImuConfig, validate
from companion.sense.imu.ak8963 import Ak8963
from companion.sense.imu.ak8963_path import BypassPath
from companion.sense.imu.fifo import SamplesLostError
from companion.sense.imu.i2c import RegisterBus, SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.imu.sample_clock import SampleClock
from sitl.devices.mpu9250 import Mpu9250Device
from tests.unit.sense.imu.imu_rig import FIELD, REST, STEP_S, ImuRig, at_rest

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
def test_every_range_is_scaled_alike_and_nothing_beyond_it_is_handed_on(
    gyro_range: int, accel_range: int
) -> None:
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
    # for a moment as the range's end, then as nothing that is known
    assert len(rig.imu) < 0.15 * config.rate_hz
    assert rig.imu[-1].specific_force_body_m_s2[2] == pytest.approx(-accel_range * GRAVITY_M_S2, abs=0.04)
    assert rig.imu[-1].rate_body_rad_s[0] == pytest.approx(math.radians(gyro_range), rel=1e-3)
    assert "saturated" in str(rig.faults[0])


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
    [({"rate_hz": 300}, "a divisor of 1000"), ({"rate_hz": 1000, "poll_hz": 50}, "expected at least 56")],
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


# ----------------
# A FIFO that filled up between its count and its read stops within a frame: nothing shifted gets through.

_INT_STATUS, _FIFO_R_W = 0x3A, 0x74


class Preempted:
    """A bus whose user is held up, once, between the FIFO's count and the burst."""

    def __init__(self, device: Mpu9250Device, *, hides_overflow: bool = False) -> None:
        self._device, self._hides = device, hides_overflow
        self.hold_up = False

    def read(self, address: int, register: int, length: int) -> bytes:
        if register == _FIFO_R_W and self.hold_up:
            self.hold_up = False
            for _ in range(60):  # more than the 36 frames that fit
                self._device.push_sample((0.4, -0.3, -GRAVITY_M_S2), (0.01, 0.02, 0.03))
        data = self._device.read(address, register, length)
        if register == _INT_STATUS and self._hides:
            return bytes((data[0] & ~0x10,)) + data[1:]
        return data

    def write(self, address: int, register: int, value: int) -> None:
        self._device.write(address, register, value)

    def close(self) -> None:
        pass


def most_tilt_deg(rig: ImuRig, after_s: float) -> float:
    """The most by which a sample's force tilts, which at rest is the attitude that it would make believe."""
    tilts = [
        math.degrees(math.atan2(math.hypot(x, y), -z))
        for x, y, z in (s.specific_force_body_m_s2 for s in rig.imu if s.time_s > after_s)
    ]
    return max(tilts)


@pytest.mark.parametrize("hides_overflow", [False, True])
def test_full_between_count_and_burst_it_is_emptied_and_nothing_shifted_is_delivered(
    hides_overflow: bool,
) -> None:
    buses: list[Preempted] = []

    def wrap(device: Mpu9250Device) -> RegisterBus:
        buses.append(Preempted(device, hides_overflow=hides_overflow))
        return buses[0]

    rig = ImuRig(wrap=wrap)
    rig.device.temperature_c = 34.0
    rig.run(1.0)
    rig.run(0.15, polling=False)  # a poll that is late, and then held up: most of it is read, not all
    count, then_s = len(rig.imu), rig.now_s
    buses[0].hold_up = True
    rig.run(0.5)
    assert len(rig.faults) == 1
    assert ("overflow" in str(rig.faults[0])) is not hides_overflow
    assert most_tilt_deg(rig, then_s) < 4.0
    assert len(rig.imu) - count > 60  # and sampling went on


def test_a_temperature_that_drifts_is_none_of_that() -> None:
    rig = ImuRig()
    for step in range(40):
        rig.device.temperature_c = 20.0 + step
        rig.run(0.1)
    assert rig.faults == []


def test_a_word_that_is_no_temperature_empties_the_fifo() -> None:
    rig = ImuRig()
    rig.run(1.0)
    rig.device.temperature_c = 60.0
    rig.run(0.05)
    assert len(rig.faults) == 1
    assert "out of step, the temperature jumps by 2" in str(rig.faults[0])
    rig.run(0.5)
    assert len(rig.faults) == 1


# ----------------
# The MPU9250's driver when chip or bus fail: what is told, what is kept, and that it recovers.


@pytest.mark.parametrize("identity", [0x71, 0x73])
def test_both_chips_of_the_family_are_accepted(identity: int) -> None:
    rig = ImuRig(identity=identity)
    rig.driver.configure()
    rig.run(0.6)
    assert rig.driver.ready
    assert rig.imu


def test_another_chip_is_refused_in_one_line() -> None:
    with pytest.raises(
        SensorError, match=r"^MPU9250 at 0x68: identity 0x68, expected 0x71 .* or 0x73"
    ) as error:
        ImuRig(identity=0x68).driver.configure()
    assert "\n" not in str(error.value)


def test_an_empty_bus_is_reported_in_one_line() -> None:
    rig = ImuRig(ImuConfig(address=0x69))
    with pytest.raises(SensorError, match=r"^MPU9250 at 0x69: Remote I/O error$"):
        rig.driver.configure()


def test_fifo_overflow_is_reported_once_and_sampling_goes_on() -> None:
    rig = ImuRig()
    rig.run(1.0)
    rig.run(0.25, polling=False)
    before = len(rig.imu)
    rig.run(0.1)
    assert [type(f) for f in rig.faults] == [SamplesLostError]
    assert "overflow" in str(rig.faults[0])
    fresh = rig.imu[before:]
    assert len(fresh) > 12
    assert fresh[0].time_s > 1.24
    assert fresh[-1].specific_force_body_m_s2 == pytest.approx(REST, abs=0.04)


def test_settings_that_do_not_take_are_reported() -> None:
    rig = ImuRig()
    write = rig.device.write

    def forgetful(address: int, register: int, value: int) -> None:
        write(address, register, 0 if register == 0x1C else value)

    rig.device.write = forgetful  # type: ignore[method-assign]
    rig.run(0.3)
    assert "settings not taken: wrote 0442081002, read 0442080002" in str(rig.faults[0])


def test_a_magnetometer_that_loses_its_settings_is_brought_up_anew() -> None:
    rig = ImuRig()
    rig.run(1.5)
    rig.device.magnetometer.reset()
    rig.run(2.5)
    assert not rig.faults
    assert rig.mag[-1].time_s > 3.9


@pytest.mark.parametrize("dead", ["silent", "another chip"])
def test_without_a_magnetometer_at_the_start_the_samples_flow_and_it_is_reported(dead: str) -> None:
    rig = ImuRig()
    if dead == "silent":
        rig.device.magnetometer.silent = True
    else:
        rig.device.magnetometer.read = lambda register, length: bytes(length)  # type: ignore[method-assign]
    rig.run(1.0)
    assert not rig.faults
    assert len(rig.imu) > 150
    assert not rig.mag
    words = "no acknowledge" if dead == "silent" else "identity 0x00, expected 0x48"
    assert words in str(rig.problem())


def test_inertial_samples_do_not_wait_for_the_magnetometers_bring_up() -> None:
    rig = ImuRig()
    rig.run(0.8)
    assert rig.imu[0].time_s < 0.2 < rig.mag[0].time_s < 0.6


@pytest.mark.parametrize("failures", [1, 2, 5])
def test_transactions_that_fail_now_and_then_cost_no_sample(failures: int) -> None:
    """The first transaction of a poll fails, so that many polls in a row: the FIFO keeps what they miss."""
    rig = ImuRig(clock_error=0.0)
    rig.run(1.5)
    first = len(rig.imu)
    for _ in range(10):
        rig.device.nacks_to_come = failures
        rig.run(0.2)
    assert not rig.faults
    assert rig.driver.ready
    assert len(rig.imu) - first == pytest.approx(400, abs=2 * failures + 2)
    assert np.abs(np.diff([s.time_s for s in rig.imu[first:]]) - 0.005).max() < 0.0003


class FailingAt:
    """A bus before the chip that fails one read of a register, taking `eats` of the FIFO's bytes with it."""

    def __init__(self, device: Mpu9250Device, register: int, eats: int = 0) -> None:
        self._device, self._register, self._eats = device, register, eats
        self.armed = False
        self.skip = 0

    def read(self, address: int, register: int, length: int) -> bytes:
        if self.armed and register == self._register:
            self.skip -= 1
            if self.skip < 0:
                self.armed = False
                if self._eats:
                    self._device.read(address, register, self._eats)
                raise OSError(121, "Remote I/O error")
        return self._device.read(address, register, length)

    def write(self, address: int, register: int, value: int) -> None:
        self._device.write(address, register, value)


@pytest.mark.parametrize(
    ("register", "unpolled_s", "skip", "jitter_s"),
    [(0x72, 0.0, 0, 0.0003), (0x74, 0.0, 0, 0.0003), (0x49, 0.0, 0, 0.0003), (0x74, 0.08, 3, 0.0005)],
)
def test_one_failure_of_any_read_loses_no_inertial_sample(
    register: int, unpolled_s: float, skip: int, jitter_s: float
) -> None:
    """The last is within a poll: what came before it is kept and the rest follows."""
    rig = ImuRig(clock_error=0.0)
    bus = FailingAt(rig.device, register)
    rig.driver = Mpu9250(bus, rig.config)
    rig.run(1.5)
    first = len(rig.imu)
    rig.run(unpolled_s, polling=False)
    bus.armed, bus.skip = True, skip
    rig.run(1.0)
    assert not bus.armed
    assert not rig.faults
    assert len(rig.imu) - first == pytest.approx(200 * (1.0 + unpolled_s), abs=2)
    assert np.abs(np.diff([s.time_s for s in rig.imu[first:]]) - 0.005).max() < jitter_s


def test_a_read_that_broke_off_within_a_frame_does_not_shift_the_ones_after_it() -> None:
    rig = ImuRig()
    bus = FailingAt(rig.device, 0x74, eats=5)
    rig.driver = Mpu9250(bus, rig.config)
    rig.run(1.5)
    bus.armed = True
    rig.run(0.5)
    assert [str(f) for f in rig.faults] == [
        "MPU9250 at 0x68: FIFO out of step after a bus fault, samples lost"
    ]
    assert rig.imu[-1].time_s > 1.98
    for sample in rig.imu:
        assert sample.specific_force_body_m_s2 == pytest.approx(REST, abs=0.05)


def test_a_bus_that_stays_dead_is_reported_after_a_few_polls() -> None:
    rig = ImuRig()
    rig.run(1.0)
    rig.device.fault = "nack"
    rig.run(0.04)
    assert not rig.faults
    rig.run(0.04)
    assert "Remote I/O error" in str(rig.faults[0])
    assert not rig.driver.ready


def test_samples_are_stamped_by_the_time_at_which_the_fifo_is_counted() -> None:
    """GIVEN a poll that begins late on its thread THEN the lateness is in no time stamp."""
    early, late = ImuRig(), ImuRig()
    for rig, waits_s in ((early, 0.0), (late, 0.004)):
        asked: list[float] = []
        read = rig.device.read

        def watched(
            address: int,
            register: int,
            length: int,
            read: Callable[[int, int, int], bytes] = read,
            asked: list[float] = asked,
        ) -> bytes:
            if register == 0x72:
                assert asked, "the count was read before the time"
            return read(address, register, length)

        rig.device.read = watched  # type: ignore[method-assign]
        for k in range(400):
            rig.device.step(k * STEP_S, *at_rest(0.0), 0.0)
            if k % 4 == 0:
                asked.clear()

                def now(
                    now_s: float = k * STEP_S + waits_s * (k % 8 == 0), asked: list[float] = asked
                ) -> float:
                    asked.append(now_s)
                    return now_s

                rig.imu += rig.driver.poll(now)[0]
                assert len(asked) == 1
    assert late.imu[-1].time_s - early.imu[-1].time_s == pytest.approx(0.002, abs=0.001)
