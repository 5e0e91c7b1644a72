"""The service's bench: delays from a flight's log, and what is held between two orders."""

from pathlib import Path

import pytest

from benchmarks.service.bench_service import HeldMemory, read_delays
from companion.base.messages import FrameReport, Setpoint
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
