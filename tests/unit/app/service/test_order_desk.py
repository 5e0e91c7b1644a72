"""The desk of orders: one at a time, each answered, and a stop for whatever is under way."""

import errno
import json
import shutil
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.app.missions import MOST_WAITING, TOO_MANY, OrderDesk
from companion.app.service import state_report
from companion.app.service.commands import _machine
from companion.app.service.state_report import ComputerStatus, ComputerWatch, ground_report
from companion.base.message_json import schema_of
from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply, Phase, Refusal
from companion.config import CONFIG_FOLDER, LinkConfig
from companion.link.codec import Codec, mavlink
from companion.link.orders import ASKS_STATUS, BY_PARAMETER


class AnsweredDesk:
    """A desk whose answers are kept."""

    def __init__(self) -> None:
        self.replies: list[tuple[str, OrderOutcome, str]] = []
        self.desk = OrderDesk(self._take)

    def _take(self, order: Order, reply: OrderReply) -> None:
        assert (reply.kind, reply.source) == (order.kind, order.source)
        self.replies.append((order.source, reply.outcome, reply.text))


def followed(d: AnsweredDesk) -> Order | None:
    return d.desk.followed


def stop_requested(d: AnsweredDesk) -> bool:
    return d.desk.stop_requested


def order(source: str, kind: OrderKind = OrderKind.LAND) -> Order:
    return Order(1.0, kind, source)


def test_an_order_is_followed_and_its_end_is_reported() -> None:
    d = AnsweredDesk()
    d.desk.take([order("a")])
    taken = d.desk.next_order(Phase.STANDBY, 1.0)
    assert taken is not None
    d.desk.decided(taken, None, 1.0)
    assert followed(d) is taken
    d.desk.mission_ended(Phase.LANDED, "landed: disarmed", 60.0)
    assert followed(d) is None
    assert d.replies == [
        ("a", OrderOutcome.IN_PROGRESS, ""),
        ("a", OrderOutcome.ACCEPTED, "landed: disarmed"),
    ]


def test_a_refusal_for_now_differs_from_one_by_the_settings() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), Refusal("no pad camera"), 1.0)
    d.desk.decided(order("b"), Refusal("not allowed", lasting=True), 1.0)
    assert d.desk.followed is None
    assert d.replies == [
        ("a", OrderOutcome.TEMPORARILY_REJECTED, "no pad camera"),
        ("b", OrderOutcome.DENIED, "not allowed"),
    ]


def test_in_a_mission_a_second_order_is_busy_and_a_stop_stops() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), None, 1.0)
    d.desk.take([order("b"), order("c", OrderKind.STOP)])
    assert d.desk.next_order(Phase.TAKE_OFF, 2.0) is None
    assert stop_requested(d)
    d.desk.mission_ended(Phase.ABORT, "abort: stop requested", 3.0)
    assert not stop_requested(d)
    assert d.replies[1:] == [
        ("b", OrderOutcome.TEMPORARILY_REJECTED, "busy: take off"),
        ("c", OrderOutcome.IN_PROGRESS, ""),
        ("a", OrderOutcome.CANCELLED, "abort: stop requested"),
        ("c", OrderOutcome.ACCEPTED, "abort: stop requested"),
    ]


def test_a_mission_that_ends_otherwise_has_failed() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), None, 1.0)
    d.desk.mission_ended(Phase.ABORT, "abort: taken over", 3.0)
    assert d.replies[-1] == ("a", OrderOutcome.FAILED, "abort: taken over")


def test_who_sends_orders_without_end_fills_no_memory_and_each_is_answered() -> None:
    d = AnsweredDesk()
    d.desk.take(order(str(number)) for number in range(1000))
    assert len(d.replies) == 1000 - MOST_WAITING
    assert set(d.replies[0][1:]) == {OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY}
    waiting = 0
    while d.desk.next_order(Phase.STANDBY, 1.0) is not None:
        waiting += 1
    assert waiting == MOST_WAITING


def test_a_flood_of_orders_keeps_no_stop_out_and_a_flood_of_stops_fills_no_memory() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), None, 1.0)
    d.desk.take(order("flood") for _ in range(100))
    d.desk.take([order("operator", OrderKind.STOP)])
    d.desk.next_order(Phase.APPROACH, 2.0)
    assert d.replies[-1] == ("operator", OrderOutcome.IN_PROGRESS, "")
    for cycle in range(100):
        d.desk.take([order(f"stop {cycle}", OrderKind.STOP)])
        d.desk.next_order(Phase.HOLD, 2.0)
    assert d.replies[-1] == ("stop 99", OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY)
    before = len(d.replies)
    d.desk.mission_ended(Phase.ABORT, "stopped", 3.0)
    assert len(d.replies) - before == 1 + MOST_WAITING


# ----------------
# What ground stations are told of the computer, and the actions that QGroundControl is given.


def test_the_computer_s_state_is_a_message_that_others_read(tmp_path: Path) -> None:
    status = ComputerStatus(cpu_percent=40.0, memory_mb=120.0, temperature_deg_c=61.4, disk_free_mb=1000.0)
    sent = Codec(1, 191).encode(ground_report(status, tmp_path, 1.7e9, 12.5))
    (heard,) = Codec(255).decode(sent)
    assert heard.get_type() == "ONBOARD_COMPUTER_STATUS"
    assert (heard.time_usec, heard.uptime) == (1_700_000_000_000_000, 12_500)
    assert 0 <= heard.cpu_combined[0] <= 40
    assert heard.temperature_board == 61
    assert heard.ram_usage == 120 < heard.ram_total
    assert heard.storage_total[0] - heard.storage_usage[0] == pytest.approx(1000, abs=1)


@pytest.mark.parametrize("fails", ["exists", "disk_usage"])
def test_a_disk_that_fails_has_no_room_and_ends_no_report(
    fails: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error", str(tmp_path))

    monkeypatch.setattr(Path if fails == "exists" else shutil, fails, broken)
    status = ComputerWatch(0.0).state(1.0, tmp_path)
    assert status.disk_free_mb == 0.0
    (heard,) = Codec(255).decode(Codec(1, 191).encode(ground_report(status, tmp_path, 1.7e9, 0.0)))
    assert heard.storage_total[0] == 0xFFFFFFFF  # not known


def test_a_log_that_loses_messages_is_no_healthy_state() -> None:
    app: Any = SimpleNamespace(
        not_ready=lambda _now_s: [],
        vision_only=True,
        sensing=SimpleNamespace(camera_problem=None),
        estimator=SimpleNamespace(tally=SimpleNamespace(uses=tuple)),
        loop_monitor=SimpleNamespace(late_share=0.0),
    )
    rates: Any = {"frame_report": SimpleNamespace(age_s=0.0)}
    for problem in (None, "the disk does not answer: 7 messages lost from the log"):
        log: Any = SimpleNamespace(problem=problem)
        found = state_report._problems(app, rates, ComputerStatus(memory_mb=120.0), log, 1.0)
        assert found == ([] if problem is None else [problem])


def test_temperature_and_clock_frequency_are_the_kernel_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in {
        "temp": "81400\n",
        "scaling_cur_freq": "1000000\n",
        "cpuinfo_max_freq": "1800000\n",
    }.items():
        (tmp_path / name).write_text(text, "ascii")
    monkeypatch.setattr(state_report, "_THERMAL", tmp_path / "temp")
    monkeypatch.setattr(state_report, "_CLOCK", tmp_path)
    hot = ComputerWatch(0.0).state(1.0, None)
    assert (hot.temperature_deg_c, hot.clock_mhz, hot.full_clock_mhz) == (81.4, 1000.0, 1800.0)
    assert _machine(asdict(hot)).endswith("81 °C, 1000 of 1800 MHz")
    assert schema_of(ComputerStatus)["required"] == ["memory_mb"]
    monkeypatch.setattr(state_report, "_CLOCK", tmp_path / "none")
    assert ComputerWatch(0.0).state(1.0, None).clock_mhz is None


def test_what_is_not_known_is_said_to_be_unknown(tmp_path: Path) -> None:
    report = ground_report(ComputerStatus(memory_mb=120.0), tmp_path, 1.7e9, 0.0)
    (heard,) = Codec(255).decode(Codec(1, 191).encode(report))
    assert (heard.cpu_combined[0], heard.temperature_board) == (0xFF, 127)
    assert heard.storage_total[0] == 0xFFFFFFFF


def test_qgroundcontrol_s_actions_are_orders_that_the_companion_takes() -> None:
    # QGroundControl passes over a file with any other key
    plan = json.loads((CONFIG_FOLDER / "qgroundcontrol" / "companion.json").read_text())
    assert set(plan) == {"version", "fileType", "actions"}
    assert plan["fileType"] == "MavlinkActions"
    *orders, status = plan["actions"]
    assert [BY_PARAMETER[action["param1"]].value for action in orders] == ["land", "stop"]
    assert status["param1"] == ASKS_STATUS
    for action in plan["actions"]:
        assert set(action) == {"label", "description", "mavCmd", "compId", "param1"}
        assert action["mavCmd"] == mavlink.MAV_CMD_USER_1
        assert action["compId"] == LinkConfig().component_id
