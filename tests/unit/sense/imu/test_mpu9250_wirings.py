"""The MPU9250 in every wiring: I2C or SPI, magnetometer through the chip or past it, FIFO or registers."""

import math
from typing import Any, Literal

import numpy as np
import pytest

from companion.base.geometry import norm
from companion.config import ConfigError, ImuConfig, validate
from companion.sense.imu.ak8963 import Ak8963
from companion.sense.imu.ak8963_path import BypassPath
from tests.unit.sense.imu.imu_rig import FIELD, REST, STILL, ImuRig

WIRINGS: dict[str, dict[str, Any]] = {
    "i2c, master, fifo": {},
    "i2c, master, fifo, 100 Hz": {"poll_hz": 100},
    "i2c, bypass, fifo": {"mag_path": "bypass"},
    "i2c, bypass, fifo, 100 Hz": {"mag_path": "bypass", "poll_hz": 100},
    "i2c, bypass, registers": {"mag_path": "bypass", "read": "registers", "poll_hz": 200},
    "i2c, master, registers": {"read": "registers", "poll_hz": 200},
    "spi, master, fifo": {"bus": "spi:0.0"},
    "spi, master, registers": {"bus": "spi:0.0", "read": "registers", "poll_hz": 200},
}


@pytest.fixture(params=WIRINGS, ids=list(WIRINGS))
def config(request: pytest.FixtureRequest) -> ImuConfig:
    return ImuConfig.model_validate(WIRINGS[request.param])


def test_samples_of_all_three_sensors_flow(config: ImuConfig) -> None:
    truth = ((1.0, -2.0, -9.0), (0.3, -0.2, 0.1), (20.0, -5.0, 40.0))
    rig = ImuRig(config)
    rig.run(2.0, lambda _now_s: truth)
    assert not rig.faults
    assert rig.problem() is None
    assert rig.imu[-1].specific_force_body_m_s2 == pytest.approx(truth[0], abs=0.05)
    assert rig.imu[-1].rate_body_rad_s == pytest.approx(truth[1], abs=0.001)
    assert rig.imu[-1].temperature_c == pytest.approx(38.0, abs=0.01)
    assert np.mean([m.field_body_ut for m in rig.mag], axis=0) == pytest.approx(truth[2], abs=0.3)
    seconds = rig.imu[-1].time_s - 1.0
    assert seconds == pytest.approx(1.0, abs=1.0 / config.poll_hz + 0.01)
    assert len([s for s in rig.imu if s.time_s > 1.0]) == pytest.approx(200 * seconds, rel=0.02)
    mag_hz = min(config.poll_hz, config.mag_rate_hz)
    assert len([m for m in rig.mag if m.time_s > 1.0]) == pytest.approx(mag_hz * seconds, rel=0.05)


@pytest.mark.parametrize("clock_error", [-0.01, 0.01])
def test_stamps_are_the_instants_of_measurement(config: ImuConfig, clock_error: float) -> None:
    """GIVEN rate and field that ramp THEN value and time stamp of each sample agree."""
    rig = ImuRig(config, clock_error=clock_error)
    slope, drift = 0.6, 50.0
    rig.run(10.0, lambda now_s: (REST, (slope * now_s, 0.0, 0.0), (drift * now_s, 0.0, 40.0)))
    errors_s = [s.rate_body_rad_s[0] / slope - s.time_s for s in rig.imu if s.time_s > 6.0]
    assert abs(float(np.mean(errors_s))) < 0.001
    assert max(abs(e) for e in errors_s) < 0.004
    mag_errors_s = [m.field_body_ut[0] / drift - m.time_s for m in rig.mag if m.time_s > 6.0]
    assert abs(float(np.mean(mag_errors_s))) < 0.003
    assert max(abs(e) for e in mag_errors_s) < 0.03


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("nack", "Remote I/O error"),
        ("ones", "all ones"),
        ("stuck", "no sample for"),
        ("saturated", "saturated for 0.2"),
    ],
)
def test_a_fault_is_reported_in_one_line_and_recovered_from(
    config: ImuConfig, fault: Literal["nack", "ones", "stuck", "saturated"], words: str
) -> None:
    rig = ImuRig(config)
    rig.run(1.0)
    rig.device.fault = fault
    rig.run(0.8)
    assert words in str(rig.faults[0])
    assert all("\n" not in str(f) for f in rig.faults)
    rig.device.fault = "none"
    count, mags = len(rig.imu), len(rig.mag)
    rig.run(1.2)
    assert len(rig.imu) > count + 100
    assert len(rig.mag) > mags + 30


def test_a_shock_beyond_the_range_counts_as_the_range_and_no_vehicle_reaches_it_on_all_axes(
    config: ImuConfig,
) -> None:
    rig = ImuRig(config)
    rig.run(0.5)
    force, rate = 1.5 * config.accel_range_g * 9.80665, 1.5 * math.radians(config.gyro_range_deg_s)
    known = len(rig.imu)
    rig.device.push_sample((0.0, 0.0, force), (0.0, rate, 0.0))
    rig.run(0.1)
    assert max(norm(sample.specific_force_body_m_s2) for sample in rig.imu[known:]) > 0.6 * force
    assert max(norm(sample.rate_body_rad_s) for sample in rig.imu[known:]) > 0.6 * rate
    known = len(rig.imu)
    rig.device.push_sample((force, -force, force), (rate, -rate, rate))
    rig.run(0.1)
    heard = rig.imu[known:]
    assert len(heard) > 0.07 * config.rate_hz  # those beside it count
    for sample in heard:
        assert sample.rate_body_rad_s == pytest.approx(STILL, abs=0.1)
        assert sample.specific_force_body_m_s2 == pytest.approx(REST, abs=0.1)
    assert not rig.faults


def test_a_power_cut_is_mended(config: ImuConfig) -> None:
    rig = ImuRig(config)
    rig.run(1.0)
    rig.device.power_cycle()
    rig.run(2.0)
    assert rig.faults
    assert rig.imu[-1].time_s > 2.9
    assert rig.mag[-1].time_s > 2.9
    assert rig.problem() is None
    # and never a sample at the scale of a chip that has forgotten its ranges
    for sample in rig.imu:
        assert sample.specific_force_body_m_s2 == pytest.approx(REST, abs=0.05)


def test_the_same_sample_for_ever_is_a_dead_sensor(config: ImuConfig) -> None:
    rig = ImuRig(config)
    rig.run(0.5)
    alive = len(rig.imu)
    for _ in range(300):
        rig.now_s += 1.0 / config.poll_hz
        for _ in range(max(1, config.rate_hz // config.poll_hz)):
            rig.device.push_sample((0.0, 0.0, 9.8), STILL)
        rig.poll(rig.now_s)
    assert "stuck" in str(rig.faults[0])
    # what repeats is not handed on as if it were measured, neither before it is called stuck nor set up anew
    assert len(rig.imu) - alive <= 0.1 * config.rate_hz


def test_a_dead_magnetometer_costs_its_own_samples_alone_and_comes_back(config: ImuConfig) -> None:
    rig = ImuRig(config)
    rig.run(1.5)
    rig.device.magnetometer.silent = True
    rig.run(3.0)
    assert not rig.faults
    assert "AK8963" in str(rig.problem())
    # the last block stands in the registers: it does not go on for long as if it were new
    assert rig.mag[-1].time_s < 1.7
    rig.device.magnetometer.silent = False
    rig.run(2.0)
    assert rig.problem() is None
    assert np.mean([m.field_body_ut for m in rig.mag[-50:]], axis=0) == pytest.approx(FIELD, abs=0.3)
    # registers that are read a moment too soon show one sample late
    gap_s = 0.0003 if config.read == "fifo" else 0.0051
    assert np.abs(np.diff([s.time_s for s in rig.imu if s.time_s > 1.0]) - 0.005).max() < gap_s


def test_magnetic_overflow_is_no_sample_and_leaves_the_rest_alone(config: ImuConfig) -> None:
    rig = ImuRig(config)
    rig.run(1.5, lambda now_s: (REST, STILL, FIELD if now_s < 0.8 else (4000.0, 2000.0, 0.0)))
    assert rig.mag
    assert all(abs(m.field_body_ut[0]) < 100.0 for m in rig.mag)
    assert rig.imu[-1].time_s > 1.45


@pytest.mark.parametrize("fuses", [bytes(3), b"\xff\xff\xff"])
def test_a_sensitivity_adjustment_that_reads_as_nothing_is_reported(fuses: bytes) -> None:
    class Chip:
        """An AK8963 whose fuse ROM cannot be read."""

        def read(self, address: int, register: int, length: int) -> bytes:
            return {0x00: b"\x48"}.get(register) or fuses[:length]

        def write(self, address: int, register: int, value: int) -> None:
            assert address == 0x0C

    mag = Ak8963(BypassPath(Chip()), 100)
    for k in range(20):
        mag.poll(0.02 * k, copied=True)
    assert mag.problem == f"AK8963: sensitivity adjustment 0x{fuses.hex()} is none"


def test_on_spi_the_chips_i2c_is_switched_off() -> None:
    rig = ImuRig(ImuConfig(bus="spi:0.0"))
    rig.run(0.5)
    assert rig.device.read(0x68, 0x6A, 1)[0] & 0x10
    assert rig.driver.ready


def test_a_chip_on_i2c_whose_i2c_is_switched_off_answers_no_more() -> None:
    """What the simulated chip does when SPI is set for a chip that is wired to I2C."""
    rig = ImuRig(ImuConfig())
    rig.device.write(0x68, 0x6A, 0x10)
    with pytest.raises(OSError, match="Remote I/O"):
        rig.device.read(0x68, 0x75, 1)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"bus": "spi:0.0", "mag_path": "bypass"}, "expected master on SPI"),
        ({"bus": "spi-socket:/run/x", "mag_path": "bypass"}, "expected master on SPI"),
        ({"read": "registers"}, r"poll_hz 50: expected at least 200"),
    ],
)
def test_wirings_that_cannot_work_are_refused(settings: dict[str, str], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        validate(ImuConfig, settings, "test.yaml")
