"""The whole app in virtual time: whose word counts on the link, and what becomes of a flight without it.

A pilot's mode ends the setpoints within 100 ms of the HEARTBEAT that tells it, in every phase and for good;
an app that can receive nothing any more ends its flight.
"""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

import pytest

from benchmarks import in_process
from benchmarks.faults import fault_flight
from benchmarks.faults.cases import FaultRun, changed, faultless, scenario_of
from benchmarks.faults.witness import WitnessedFlight
from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES, custom_mode
from companion.base.clock import Clock
from companion.link.codec import AUTOPILOT_COMPONENT, CURRENT_MODE, Codec, mavlink
from companion.link.transport import MemoryTransport, memory_pair
from tests.scenario.flights.forked import fly_forked
from tests.scenario.flying import FEW_PICTURES

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


@dataclass(frozen=True)
class RecordedFlight:
    """What the record shows of a flight, and what its listener noted."""

    record: WitnessedFlight
    modes: list[tuple[float, int]]
    setpoints_s: list[float]
    failures: int


@contextmanager
def listening(**settings: Any) -> Iterator[Callable[[WitnessedFlight], RecordedFlight]]:
    """Flights have a listener; yields what puts a flight's record together with what that has noted."""
    made: list[Listener] = []

    def heard_pair() -> tuple[Listener, MemoryTransport]:
        app_end, vehicle_end = memory_pair()
        made.append(Listener(app_end, **settings))
        return made[-1], vehicle_end

    def heard(record: WitnessedFlight) -> RecordedFlight:
        listener = made[-1]
        return RecordedFlight(record, listener.modes, listener.setpoints_s, listener.failures)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(in_process, "memory_pair", heard_pair)
        yield heard


# a pilot's mode and the phase in which it comes
TAKEOVERS: Final = [
    FaultRun("pilot: Position", "search", "line", 0),
    FaultRun("pilot: Position", "approach", "line", 0),
    FaultRun("pilot: Return", "descend", "line", 0),
    FaultRun("pilot: Position", "last_metre", "line", 0),
    FaultRun("pilot: Position", "on_pad", "line", 0),
]


@pytest.fixture(scope="module")
def taken_over() -> dict[FaultRun, RecordedFlight]:
    with listening(quick=False) as heard:
        return fly_forked(TAKEOVERS, lambda _, record: heard(record))


@pytest.mark.parametrize("run", TAKEOVERS, ids=lambda run: f"{run.phase}-{run.fault}")
def test_a_pilots_mode_ends_our_setpoints_at_once_and_for_good(
    run: FaultRun, taken_over: dict[FaultRun, RecordedFlight]
) -> None:
    assert_prompt(taken_over[run], "px4")


def test_so_does_an_ardupilots() -> None:
    takeover = scenario_of(FaultRun("pilot: Position", "descend", "line", 0))
    with listening(quick=False) as heard:
        record, _ = fault_flight.fly(changed(takeover, {**FEW_PICTURES, "autopilot": "ardupilot"}), 0)
    assert_prompt(heard(record), "ardupilot")


def assert_prompt(heard: RecordedFlight, autopilot: AutopilotKind) -> None:
    """No setpoint left later than `PROMPT_S` after the pilot's mode was told."""
    assert heard.record.fault_began
    # until control is ours PX4 flies in LOITER, which is no pilot's word
    ours = {custom_mode(autopilot, PROFILES[autopilot].control_mode), custom_mode("px4", "AUTO.LOITER")}
    first_s = heard.setpoints_s[0]
    other_s = next(time_s for time_s, mode in heard.modes if time_s > first_s and mode not in ours)
    before = [time_s for time_s in heard.setpoints_s if time_s < other_s]
    assert other_s - before[-1] < 0.5, "setpoints were sent until the pilot's mode was told"
    assert max(heard.setpoints_s) - other_s <= PROMPT_S
    assert any("taken over" in said.text for said in heard.record.texts)


def test_a_link_that_cannot_be_read_any_more_ends_the_flight_in_the_autopilots_hold() -> None:
    scenario = scenario_of(FaultRun("frames lost 0.2 s", "search", "line", 0))
    with listening(deaf_s=24.0) as put_together:
        record, _ = fault_flight.fly(changed(scenario, FEW_PICTURES), 0)
    heard = put_together(record)
    assert heard.failures > 3, "the link's task is started again and again"
    words = [said.text for said in record.texts]
    assert any("autopilot link lost: the line is gone" in text for text in words), words
    assert any(text.startswith("hold: link lost") for text in words), words
    assert words[-1].startswith("abort:") or any(text.startswith("abort:") for text in words), words
    assert record.app_ended_s is not None
    assert record.app_failed == ""
    assert not record.crashed
    assert record.samples[-1].mode not in {"OFFBOARD", "GUIDED"}
    assert max(heard.setpoints_s) < record.app_ended_s


@contextmanager
def waking_at(woken_s: float) -> Iterator[None]:
    """The machine was suspended for an hour just before: the loop's clock does not show it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Clock, "suspended_s", lambda clock: 3600.0 if clock.now_s() >= woken_s else 0.0)
        yield


def test_a_machine_that_was_suspended_in_the_descent_flies_by_nothing_that_it_knew() -> None:
    # ArduPilot stays in GUIDED meanwhile, so that its mode says nothing
    woken_s = 27.0
    scenario = faultless("line", {**FEW_PICTURES, "autopilot": "ardupilot"})
    with listening() as put_together, waking_at(woken_s):
        record, _ = fault_flight.fly(scenario, 0)
    heard = put_together(record)
    words = [said.text for said in record.texts]
    before = [said.text for said in record.texts if said.time_s < woken_s]
    assert any(text.startswith("descend: ") for text in before), words
    assert any("stalled for 3600" in text for text in words), words
    assert any(text.startswith("abort: estimate lost") for text in words), words
    assert max(heard.setpoints_s) <= woken_s + PROMPT_S
    assert record.samples[-1].mode == "BRAKE"
    assert not record.crashed


def test_a_machine_that_was_suspended_before_the_take_off_does_not_take_off() -> None:
    with listening() as put_together, waking_at(2.0):
        record, _ = fault_flight.fly(faultless("line"), 0)
    assert not any(sample.armed for sample in record.samples)
    assert put_together(record).setpoints_s == []
    assert any(said.text.startswith("abort: suspended") for said in record.texts), record.texts
