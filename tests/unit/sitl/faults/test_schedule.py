"""When a fault begins and ends: by the clock, by what the app says, by the height over the pad."""

from __future__ import annotations

import asyncio
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from pydantic import ValidationError

from companion.config import ConfigError
from companion.link import codec
from sitl.camera.frame_line import FrameLine
from sitl.devices.ports import MemoryPort
from sitl.devices.rack import SensorRack
from sitl.faults.faults import AutopilotReboots, DiskFull, FrameBlack
from sitl.faults.faulty_link import LinkChannel, LinkSettings
from sitl.faults.schedule import FaultSchedule, Moments, StatusTextMonitor
from sitl.faults.targets import FaultTargets
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import Motors
from tests.unit.sitl.devices.sensor_desk import FIELD_NED_UT, HOME, STEP_S

ENCODER = codec.mavlink.MAVLink(None, srcSystem=1, srcComponent=191)


def said(text: str, text_id: int = 1) -> bytes:
    return b"".join(bytes(m.pack(ENCODER)) for m in codec.status_texts(text, "info", text_id))


def targets(**parts: Any) -> FaultTargets:
    return asyncio.run(_targets(parts))


async def _targets(parts: dict[str, Any]) -> FaultTargets:
    """In a loop, for the ports want one."""
    rng = np.random.default_rng(0)
    gps, echo = MemoryPort(9600), MemoryPort(9600)
    rack = SensorRack(0, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, gps_port=gps, range_port=echo)
    onboard = SimulatedAutopilotSensors(rng, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, imu_filter=2)
    ways = (LinkChannel(LinkSettings(), rng), LinkChannel(LinkSettings(), rng))
    unused = {name: Mock() for name in ("camera", "motion", "station")}
    return FaultTargets(rack, onboard, FrameLine(rng), Motors(), *ways, **(unused | parts))


def black(**when: Any) -> FrameBlack:
    return FrameBlack(kind="frame_black", **when)


def black_from_to(
    fault: FrameBlack, words: StatusTextMonitor, heights_m: dict[float, float]
) -> tuple[float, float]:
    """Between which whole seconds the frames are black; the height is the last one given."""
    now = {"s": 0.0}
    moments = Moments(words, lambda: next((heights_m[t] for t in reversed(heights_m) if t <= now["s"]), None))
    at = targets()
    schedule = FaultSchedule([fault], at, moments)
    seen = []
    for second in range(40):
        now["s"] = float(second)
        if second == 10:
            words.hear(said("search: arrived: 0.6 m from the waypoint"), 10.0)
        if second == 20:
            words.hear(
                said("approach: pad seen: lateral offset 3.3 m, 7.0 m below, and a long tail of words"), 20.0
            )
        if second == 25:
            words.hear(said("search: pad lost: unseen for 5 s"), 25.0)
        schedule.step(float(second))
        if at.frames.black:
            seen.append(float(second))
    assert schedule.all_begun == bool(seen)
    assert seen == [float(s) for s in range(int(seen[0]), int(seen[-1]) + 1)] if seen else True
    return (seen[0], seen[-1]) if seen else (-1.0, -1.0)


@pytest.mark.parametrize(
    ("when", "expected"),
    [
        ({"start_s": 7.0, "duration_s": 3.0}, (7.0, 9.0)),
        ({"phase": "search", "duration_s": 2.0}, (10.0, 11.0)),
        ({"phase": "search", "delay_s": 4.0, "duration_s": 2.0}, (14.0, 15.0)),
        ({"phase": "approach"}, (20.0, 39.0)),
        ({"after_sighting_s": 5.0, "duration_s": 1.0}, (25.0, 25.0)),
        ({"below_m": 1.0, "duration_s": 2.0}, (31.0, 32.0)),
        ({"below_m": 0.0, "delay_s": 1.0}, (34.0, 39.0)),
        ({"phase": "touchdown"}, (-1.0, -1.0)),
    ],
)
def test_a_fault_begins_when_its_moment_has_come_and_once(
    when: dict[str, Any], expected: tuple[float, float]
) -> None:
    heights_m = {15.0: 6.0, 30.0: 1.2, 31.0: 0.9, 33.0: 0.0, 35.0: 1.5, 36.0: 0.2}
    assert black_from_to(black(**when), StatusTextMonitor(), heights_m) == expected


def test_beside_the_pad_there_is_no_height_over_it() -> None:
    assert black_from_to(black(below_m=3.0), StatusTextMonitor(), {}) == (-1.0, -1.0)


@pytest.mark.parametrize(
    "when", [{}, {"start_s": 1.0, "phase": "search"}, {"delay_s": 1.0}, {"phase": "lunch"}]
)
def test_a_fault_has_one_beginning(when: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"expected one of|lunch"):
        black(**when)


def test_overlapping_faults_end_each_for_itself() -> None:
    at = targets()
    short, long = black(start_s=1.0, duration_s=1.0), black(start_s=1.5, duration_s=2.0)
    schedule = FaultSchedule([short, long], at)
    shown = []
    for k in range(9):
        schedule.step(0.5 * k)
        shown.append(at.frames.black)
    assert shown == [False, False, True, True, True, True, True, False, False]


# ---------------------------------------------------------------- what the app says


def test_words_are_put_together_and_only_the_first_of_a_phase_counts() -> None:
    words = StatusTextMonitor()
    long = "approach: pad seen: " + "x" * 80
    words.hear(said("search: arrived") + said(long, 2), 3.0)
    words.hear(said("search: pad lost", 3), 9.0)
    assert [t.text for t in words.texts] == ["search: arrived", long, "search: pad lost"]
    assert words.phase_began_s == {"search": 3.0, "approach": 3.0}
    assert words.sighted_s == 3.0


def test_a_text_of_whole_chunks_ends_with_an_empty_one() -> None:
    words = StatusTextMonitor()
    words.hear(said("y" * 100, 7), 1.0)
    assert [t.text for t in words.texts] == ["y" * 100]


# ---------------------------------------------------------------- what is not there cannot fail


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (DiskFull(kind="disk_full", start_s=1.0), "bench-faults"),
        (AutopilotReboots(kind="autopilot_reboots", start_s=1.0), "bundled autopilot"),
    ],
)
def test_a_fault_of_what_is_not_simulated_is_refused(fault: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        FaultSchedule([fault], targets())
