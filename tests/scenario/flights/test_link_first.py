"""The whole app in virtual time: whose word counts on the link, and what becomes of a flight without it.

A pilot's mode ends the setpoints within 100 ms of the HEARTBEAT that tells it, in every phase and for good;
an app that can receive nothing any more ends its flight.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

import pytest

from companion.base.clock import Clock
from companion.config import merge
from companion.link.codec import AUTOPILOT_COMPONENT, Codec, mavlink
from companion.link.dialect import CURRENT_MODE
from companion.link.inbox import MemoryTransport, memory_pair
from companion.link.modes import CONTROL_MODE, custom_mode
from sitl.scenario.scenario import Scenario
from tests.bench.faults import fault_flight
from tests.bench.faults.cases import Run, faultless, scenario_of
from tests.bench.faults.witness import FlightRecord

PROMPT_S = 0.1
SETPOINTS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET")


@dataclass
class Listener:
    """The app's end of the link: notes when a mode arrived and when setpoints left, by the app's clock.

    Without `quick` nothing but HEARTBEAT tells the mode. From `deaf_s` on reading fails.
    """

    end: MemoryTransport
    quick: bool = True
    deaf_s: float | None = None
    modes: list[tuple[float, int]] = field(default_factory=list)
    setpoints_s: list[float] = field(default_factory=list)
    failures: int = 0

    def __post_init__(self) -> None:
        self._incoming, self._outgoing = Codec(1), Codec(1)

    async def read(self) -> bytes:
        if self.deaf_s is not None and asyncio.get_running_loop().time() >= self.deaf_s:
            self.failures += 1
            raise OSError("the line is gone")
        data, now_s = await self.end.read(), asyncio.get_running_loop().time()
        passed = b""
        for message in self._incoming.decode(data):
            ours = message.get_srcComponent() == AUTOPILOT_COMPONENT  # the ground station has a heartbeat too
            if ours and message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.modes.append((now_s, message.custom_mode))
            if self.quick or message.get_msgId() != CURRENT_MODE:
                passed += bytes(message.get_msgbuf())
        return passed or b"\0"

    def write(self, data: bytes) -> None:
        if any(message.get_type() in SETPOINTS for message in self._outgoing.decode(data)):
            self.setpoints_s.append(asyncio.get_running_loop().time())
        self.end.write(data)

    def close(self) -> None:
        self.end.close()


def fly(
    monkeypatch: pytest.MonkeyPatch, scenario: Scenario, **settings: Any
) -> tuple[FlightRecord, Listener]:
    made: list[Listener] = []

    def heard_pair() -> tuple[Listener, MemoryTransport]:
        app_end, vehicle_end = memory_pair()
        made.append(Listener(app_end, **settings))
        return made[0], vehicle_end

    monkeypatch.setattr(fault_flight, "memory_pair", heard_pair)
    record, _ = fault_flight.fly(scenario, 0)
    return record, made[0]


@pytest.mark.parametrize(
    ("phase", "autopilot", "mode"),
    [
        ("search", "px4", "position"),
        ("approach", "px4", "position"),
        ("descend", "px4", "return"),
        ("descend", "ardupilot", "position"),
        ("last_metre", "px4", "position"),
        ("on_pad", "px4", "position"),
    ],
)
def test_a_pilots_mode_ends_our_setpoints_at_once_and_for_good(
    monkeypatch: pytest.MonkeyPatch, phase: Any, autopilot: Any, mode: str
) -> None:
    scenario = scenario_of(Run("pilot: Position", phase, "line", 0))
    changed = {"faults": [{**scenario.faults[0].model_dump(exclude_unset=True), "mode": mode}]}
    content = scenario.model_dump(by_alias=True, exclude_unset=True)
    scenario = Scenario.model_validate(merge(content, {**changed, "autopilot": autopilot}))
    record, listener = fly(monkeypatch, scenario, quick=False)
    assert record.fault_began
    # until control is ours PX4 flies in LOITER, which is no pilot's word
    ours = {custom_mode(autopilot, CONTROL_MODE[autopilot]), custom_mode("px4", "AUTO.LOITER")}
    first_s = listener.setpoints_s[0]
    other_s = next(time_s for time_s, heard in listener.modes if time_s > first_s and heard not in ours)
    before = [time_s for time_s in listener.setpoints_s if time_s < other_s]
    assert other_s - before[-1] < 0.5, "setpoints were sent until the pilot's mode was told"
    assert max(listener.setpoints_s) - other_s <= PROMPT_S
    assert any("pilot took over" in said.text for said in record.texts)


def test_a_link_that_cannot_be_read_any_more_ends_the_flight_in_the_autopilots_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = scenario_of(Run("frames lost 0.2 s", "search", "line", 0))
    record, listener = fly(monkeypatch, scenario, deaf_s=24.0)
    assert listener.failures > 3, "the link's task is started again and again"
    words = [said.text for said in record.texts]
    assert any("autopilot link lost: the line is gone" in text for text in words), words
    assert any(text.startswith("hold: link lost") for text in words), words
    assert words[-1].startswith("abort:") or any(text.startswith("abort:") for text in words), words
    assert record.app_ended_s is not None
    assert record.app_failed == ""
    assert not record.crashed
    assert record.samples[-1].mode not in {"OFFBOARD", "GUIDED"}
    assert max(listener.setpoints_s) < record.app_ended_s


def wakes_at(monkeypatch: pytest.MonkeyPatch, woken_s: float) -> None:
    """The machine was suspended for an hour just before: no clock of the loop shows it."""
    monkeypatch.setattr(Clock, "suspended_s", lambda clock: 3600.0 if clock.now_s() >= woken_s else 0.0)


@pytest.mark.parametrize(
    ("autopilot", "ended"),
    [("px4", "abort: pilot took over: mode AUTO.LOITER"), ("ardupilot", "abort: estimate lost")],
)
def test_a_machine_that_was_suspended_in_the_descent_flies_by_nothing_that_it_knew(
    monkeypatch: pytest.MonkeyPatch, autopilot: str, ended: str
) -> None:
    woken_s = 27.0
    wakes_at(monkeypatch, woken_s)
    content = faultless("line").model_dump(by_alias=True, exclude_unset=True)
    scenario = Scenario.model_validate(merge(content, {"autopilot": autopilot}))
    record, listener = fly(monkeypatch, scenario)
    words = [said.text for said in record.texts]
    before = [said.text for said in record.texts if said.time_s < woken_s]
    assert any(text.startswith("descend: ") for text in before), words
    assert any("stood still for 3600" in text for text in words), words
    assert any(text.startswith(ended) for text in words), words
    assert max(listener.setpoints_s) <= woken_s + PROMPT_S
    assert record.samples[-1].mode in {"AUTO_LOITER", "BRAKE"}
    assert not record.crashed


def test_a_machine_that_was_suspended_before_the_take_off_does_not_take_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wakes_at(monkeypatch, 2.0)
    record, listener = fly(monkeypatch, faultless("line"))
    assert not any(sample.armed for sample in record.samples)
    assert listener.setpoints_s == []
    assert any(said.text.startswith("abort: stop requested") for said in record.texts), record.texts
