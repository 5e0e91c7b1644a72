"""The MPU9250's driver when chip or bus fail: what is told, what is kept, and that it recovers."""

from collections.abc import Callable

import numpy as np
import pytest

from companion.config import ImuConfig
from companion.sense.imu.fifo import SamplesLostError
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from sitl.devices.mpu9250 import Mpu9250Device
from tests.unit.sense.imu.imu_rig import REST, STEP_S, ImuRig, at_rest


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


@pytest.mark.parametrize("register", [0x72, 0x74, 0x49])
def test_one_failure_of_any_read_loses_no_inertial_sample(register: int) -> None:
    rig = ImuRig(clock_error=0.0)
    bus = FailingAt(rig.device, register)
    rig.driver = Mpu9250(bus, rig.config)
    rig.run(1.5)
    first = len(rig.imu)
    bus.armed = True
    rig.run(1.0)
    assert not bus.armed
    assert not rig.faults
    assert len(rig.imu) - first == pytest.approx(200, abs=2)
    assert np.abs(np.diff([s.time_s for s in rig.imu[first:]]) - 0.005).max() < 0.0003


def test_what_came_before_a_failure_within_a_poll_is_kept_and_the_rest_follows() -> None:
    rig = ImuRig(clock_error=0.0)
    bus = FailingAt(rig.device, 0x74)
    rig.driver = Mpu9250(bus, rig.config)
    rig.run(1.5)
    first = len(rig.imu)
    rig.run(0.08, polling=False)
    bus.armed, bus.skip = True, 3
    rig.run(0.5)
    assert not bus.armed
    assert not rig.faults
    assert len(rig.imu) - first == pytest.approx(116, abs=2)
    assert np.abs(np.diff([s.time_s for s in rig.imu[first:]]) - 0.005).max() < 0.0005


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
