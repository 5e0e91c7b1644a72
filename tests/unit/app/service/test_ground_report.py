"""What ground stations are told of the computer, and the actions that QGroundControl is given."""

import json
from pathlib import Path

import pytest

from companion.app.service.computer_status import ComputerStatus, ground_report
from companion.config import CONFIG_FOLDER, LinkConfig
from companion.link.codec import Codec, mavlink
from companion.link.orders import ASKS_STATUS, BY_PARAMETER


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
