"""The service's bench: delays from a flight's log, and what is held between two orders."""

from pathlib import Path

import pytest

from benchmarks.service.bench_order import read_timing, unit_nice
from benchmarks.service.bench_service import HeldMemory, read_delays
from companion.base.messages import (
    FrameReport,
    ImuSample,
    OrderKind,
    OrderOutcome,
    OrderReply,
    Phase,
    PlanStep,
    Setpoint,
)
from companion.flightlog.record import FlightLog


def test_delays_are_those_of_the_first_setpoint_that_used_a_frame(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, 1.7e9)
    for number in range(100):
        exposed_s = 0.1 * number
        received_s, done_s = exposed_s + 0.045, exposed_s + 0.055
        report = FrameReport(exposed_s, received_s, done_s, number, {}, seen=True, searched_whole_frame=False)
        log.write("frame_report", report, done_s)
        for sent_s in (done_s + 0.020, done_s + 0.053):
            # rolling shutter: the pad's rows are exposed before or after the frame's middle
            seen_s = exposed_s + (0.005 if number % 2 else -0.005)
            log.write("setpoint", Setpoint(sent_s, exposure_time_s=seen_s), sent_s)
    log.write("setpoint", Setpoint(20.0), 20.0)  # before the pad was seen
    log.write("setpoint", Setpoint(21.0, exposure_time_s=20.9), 21.0)  # of a frame that is not in the log
    log.close()
    delays = read_delays(tmp_path / "flight.mcap")
    assert delays.camera_ms == pytest.approx([45.0] * 100)
    assert delays.vision_ms == pytest.approx([10.0] * 100)
    assert delays.waited_ms == pytest.approx([20.0] * 100)
    assert delays.beyond_ms == pytest.approx(30.0)
    assert delays.lines()[-1] == "exposure to setpoint: p50 75.0 ms, p99 75.0 ms"


def test_what_is_held_more_is_counted_and_what_is_less_makes_up_for_nothing() -> None:
    first = HeldMemory(tasks=10, threads=4, files=20, memory_mb=100.0)
    assert HeldMemory(tasks=12, threads=3, files=20, memory_mb=150.0).more_than(first) == 2
    assert first.more_than(first) == 0


def test_a_cycle_is_the_orders_as_far_as_it_is_later_than_those_of_a_window_before(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, 1.7e9)
    ordered_s, time_s = 20.0, 0.0
    while time_s < 25.0:
        log.write("plan", PlanStep(time_s, Phase.STANDBY), time_s)
        report = FrameReport(time_s, time_s, time_s + 0.01, 0, {}, seen=False, searched_whole_frame=True)
        log.write("frame_report", report, time_s)
        # the kernel holds a cycle up before the order, and another one longer after it
        held_up_s = 0.1 if 7.0 < time_s < 7.034 else 0.13 if 22.0 < time_s < 22.034 else 0.0
        time_s += 1.4 / 30.0 + held_up_s if held_up_s else 1.0 / 30.0
    for number in range(5000):
        at_s = 0.005 * number
        log.write("imu", ImuSample(at_s, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 25.0), at_s)
    reply = OrderReply(ordered_s, OrderKind.FLY, "the local socket", OrderOutcome.IN_PROGRESS)
    log.write("order", reply, ordered_s)
    log.close()
    timing = read_timing(tmp_path / "flight.mcap")
    assert len(timing.before) == 5
    assert sorted(timing.floor_ms) == pytest.approx([0.0, 0.0, 0.0, 0.0, 100.0], abs=0.1)
    later, gaps = timing.bars()
    assert (later.measured, later.holds) == ("130.0 (<= 20) ms", False)
    assert gaps.measured == "0.0 (<= 0)"
    assert "window by window before: median 0.0 ms, most 100.0 ms" in timing.lines()[3]
    assert timing.lines()[4].endswith(": 0")


def test_the_bench_gives_the_service_the_units_priority() -> None:
    assert unit_nice() < 0
