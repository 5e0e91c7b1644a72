"""The comparison with recordings: how a row is judged, how a record is read."""

import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.autopilot.autopilot_record import read_tlog
from benchmarks.autopilot.bench_sitl import main, row
from companion.config import ConfigError


@pytest.mark.parametrize(
    ("recorded", "ours", "rule", "holds"),
    [
        (2.0, (2.2, 2.2), "15%", True),
        (2.0, (2.4, 2.4), "15%", False),
        (0.01, (0.03, 0.03), "resolution", True),
        (2.0, (2.2, 2.6), "scatter", True),
        (2.0, (2.2, 4.2), "lost", None),
        (None, (1.0, 1.0), "lost", None),
        (1.0, (1.0, None), "lost", None),
    ],
)
def test_a_row_is_judged_by_the_widest_of_its_rules(
    recorded: float | None, ours: tuple[float | None, ...], rule: str, holds: bool | None
) -> None:
    judged = row("stop (s)", recorded, ours, 0.15)
    assert (judged.rule, judged.holds) == (rule, holds)


def test_how_far_ours_wanders_is_not_excused_by_its_own_scatter() -> None:
    judged = row("hover: height (m)", 0.2, (0.1, 1.9), 0.25)
    assert (judged.rule, judged.holds) == ("25%", False)


def test_a_tlog_gives_motion_on_one_clock_what_was_sent_and_what_was_said(tmp_path: Path) -> None:
    vehicle, client = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), mavlink.MAVLink(None, 255, 191)
    data = b""
    for i in range(200):
        at = 100.0 + 0.02 * i
        late = 0.004 * (i % 5)  # on its way; the shortest counts
        data += frame(
            at + late, mavlink.MAVLink_local_position_ned_message(5000 + 20 * i, i, 0, 0, 1, 0, 0), vehicle
        )
        data += frame(at + late, mavlink.MAVLink_attitude_message(5000 + 20 * i, 0, 0.1, 0, 0, 0, 0), vehicle)
    data += frame(104.0, mavlink.MAVLink_command_ack_message(22, 4), vehicle)
    data += frame(104.1, mavlink.MAVLink_heartbeat_message(255, 8, 0, 0, 4, 3), client)
    path = tmp_path / "flight.tlog"
    path.write_bytes(data)
    record = read_tlog(path)
    assert record.motion.shape == (200, 7)
    assert record.motion[:, 0] == pytest.approx([0.02 * i for i in range(200)], abs=1e-6)
    assert record.booted_s == pytest.approx(-5.0)
    assert [said.what for said in record.heard("ack")] == [(22, 4)]
    assert len(record.sent) == 1


def frame(time_s: float, message: mavlink.MAVLink_message, sender: mavlink.MAVLink) -> bytes:
    return struct.pack(">Q", round(time_s * 1e6)) + bytes(message.pack(sender))


def test_a_folder_without_recordings_ends_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        main([str(tmp_path)])
    (tmp_path / "arducopter.tlog").write_bytes(b"no recording at all, not one frame of it")
    with pytest.raises(ConfigError, match=r"expected a \.tlog"):
        main([str(tmp_path)])
