"""A FIFO that filled up between its count and its read stops within a frame: nothing shifted gets through."""

import math

import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.sense.imu.i2c import RegisterBus
from sitl.devices.mpu9250 import Mpu9250Device
from tests.unit.sense.imu.imu_rig import ImuRig

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
