"""The battery: full at first, drained by thrust, sagging under load."""

import pytest

from sitl.mavlink.telemetry import battery_status, sys_status
from sitl.vehicle.battery import CAPACITY_MAH, CELLS, Battery
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight

HOVER = (0.5, 0.5, 0.5, 0.5)


def drained(motors: tuple[float, ...], seconds: int) -> Battery:
    battery = Battery(max_thrust_n=7.36)
    for _ in range(seconds):
        battery.step(motors, 1.0)
    return battery


def test_it_is_full_at_first() -> None:
    battery = drained(HOVER, 0)
    assert battery.share == 1.0
    assert battery.voltage_v == pytest.approx(4.2 * CELLS)


def test_a_hover_lasts_about_twenty_minutes() -> None:
    assert drained(HOVER, 600).share == pytest.approx(0.5, abs=0.1)
    assert drained(HOVER, 1500).share < 0.1


def test_what_has_flowed_is_what_is_missing() -> None:
    battery = drained(HOVER, 120)
    assert battery.share == pytest.approx(1.0 - battery.consumed_mah / CAPACITY_MAH)
    assert battery.consumed_mah == pytest.approx(battery.current_a * 120.0 / 3.6, rel=0.03)


def test_more_thrust_takes_more_and_sags_deeper() -> None:
    off, hover, full = (drained(motors, 1) for motors in ((0.0,) * 4, HOVER, (1.0,) * 4))
    assert off.current_a < 1.0 < hover.current_a
    # power goes with thrust to the power of 1.5
    assert full.current_a / hover.current_a == pytest.approx(2.0**1.5, rel=0.1)
    assert off.voltage_v > hover.voltage_v > full.voltage_v


def test_empty_it_stays_at_its_lowest_voltage() -> None:
    battery = drained((1.0,) * 4, 3600)
    assert battery.share == 0.0
    assert 2.8 * CELLS < battery.voltage_v < 3.3 * CELLS


def test_a_flight_drains_what_is_reported_in_both_messages() -> None:
    flight = AutopilotFlight("px4")
    flight.run(4.0)
    resting = sys_status(flight.autopilot, 4.0)
    flight.autopilot.arm()
    flight.autopilot.take_off(405.0)
    flight.run(40.0)
    status, battery = sys_status(flight.autopilot, 44.0), battery_status(flight.autopilot, 44.0)
    assert resting.battery_remaining == 100
    assert status.battery_remaining == battery.battery_remaining < 100
    assert status.voltage_battery < resting.voltage_battery
    assert status.current_battery == battery.current_battery > 10 * resting.current_battery
    assert sum(battery.voltages[:CELLS]) == pytest.approx(status.voltage_battery, abs=CELLS)
    assert battery.current_consumed > 50
    assert battery.energy_consumed > 10
