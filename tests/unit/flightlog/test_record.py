"""The flight log: what was written can be read again by other people's tools."""

import base64
import errno
import json
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from companion.base.message_json import encode
from companion.base.message_schema import schema_of
from companion.base.messages import (
    Frame,
    ImuSample,
    Notice,
    PadSighting,
    Phase,
    PlanStep,
    Reference,
    VehicleState,
)
from companion.config import ConfigError
from companion.flightlog.record import FlightLog, split_packets

START_UNIX_S = 1.7e9


def imu(time_s: float) -> ImuSample:
    return ImuSample(time_s, (0.0, 0.1, 0.2), (0.0, 0.0, -9.81), 30.0)


def heartbeats(count: int) -> list[bytes]:
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    return [bytes(link.heartbeat_encode(18, 8, 0, 0, 4).pack(link)) for _ in range(count)]


def read_mcap(path: Path) -> list[tuple[str, dict[str, Any], int]]:
    with path.open("rb") as stream:
        return [
            (channel.topic, json.loads(message.data), message.log_time)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def test_every_message_is_in_the_log_with_its_time(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, START_UNIX_S)
    for k in range(50):
        log.write("imu", imu(0.01 * k), 0.01 * k)
    log.write("notice", Notice(0.3, "phase", "take-off"), 0.3)
    log.close()
    messages = read_mcap(tmp_path / "flight.mcap")
    assert [topic for topic, _, _ in messages].count("/imu") == 50
    notice = next(data for topic, data, _ in messages if topic == "/notice")
    assert notice == {"time_s": 0.3, "kind": "phase", "text": "take-off", "severity": "info"}
    assert messages[0][2] == int(START_UNIX_S * 1e9)


def test_frames_are_logged_at_the_log_s_own_rate_and_can_be_seen(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, START_UNIX_S, frame_rate_hz=10.0)
    image = np.tile(np.arange(160, dtype=np.uint8), (120, 1))
    for k in range(30):
        log.write_frame(Frame(k / 30.0, k / 30.0, k, image), k / 30.0)
    log.close()
    frames = [data for topic, data, _ in read_mcap(tmp_path / "flight.mcap") if topic == "/camera"]
    assert len(frames) == pytest.approx(10, abs=1)
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(frames[0]["data"]), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert np.abs(picture.astype(int) - image).max() < 10


def test_the_tlog_is_read_by_pymavlink_even_when_packets_come_in_pieces(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, START_UNIX_S)
    stream = b"".join(heartbeats(5))
    for start in range(0, len(stream), 7):
        log.write_mavlink(stream[start : start + 7], 2.0, "in")
    log.write_mavlink(heartbeats(1)[0], 3.0, "out")
    log.close()
    reader = mavutil.mavlink_connection(str(tmp_path / "flight.tlog"))
    stamps = []
    while (message := reader.recv_match(type="HEARTBEAT")) is not None:
        stamps.append(message._timestamp)
    reader.close()
    assert stamps == pytest.approx([START_UNIX_S + 2.0] * 5 + [START_UNIX_S + 3.0])


def test_garbage_between_packets_is_passed_over() -> None:
    first, second = heartbeats(2)
    packets, rest = split_packets(b"\x00\x11" + first + b"\x42" + second + b"\xfd\x09")
    assert packets == [first, second]
    assert rest == b"\xfd\x09"


def test_without_a_folder_only_what_the_score_needs_is_kept() -> None:
    log = FlightLog(None, START_UNIX_S)
    log.write("imu", imu(0.0), 0.0)
    notice = Notice(0.0, "a", "b")
    log.write("notice", notice, 0.0)
    log.close()
    assert dict(log.kept) == {"notice": [notice]}


def test_arrays_and_numbers_that_are_none_can_be_written() -> None:
    rows = np.zeros((2, 3))
    reference = Reference(0.0, "pad", 0.1, rows, rows, rows, float("nan"))
    data = json.loads(encode(reference))
    assert data["position_m"] == [0.0] * 6
    assert "minimum_height_m" not in data
    assert data["heading_rad"] is None
    with pytest.raises(Exception, match="cannot log"):
        encode(object())


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"--record .*cannot be written"):
        FlightLog(tmp_path / "file", START_UNIX_S)


def test_schemas_name_every_field_with_its_kind() -> None:
    properties = schema_of(VehicleState)["properties"]
    assert properties["time_s"] == {"type": "number", "description": "s"}
    assert properties["attitude"]["type"] == "array"
    assert properties["aligned"] == {"type": "boolean"}
    counts = schema_of(PadSighting)["properties"]["marker_count"]["properties"]
    assert counts == {key: {"type": "integer"} for key in "FMC"}
    assert schema_of(PlanStep)["properties"]["phase"]["enum"] == [phase.value for phase in Phase]


def test_a_log_of_no_flight_leaves_nothing_behind(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    FlightLog(folder, 0.0).discard()
    assert not folder.exists()


def test_what_others_have_put_into_the_folder_stays(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("windy")
    FlightLog(tmp_path, 0.0).discard()
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_full_disk_ends_the_log_and_says_so_but_raises_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = FlightLog(tmp_path, START_UNIX_S)
    monkeypatch.setattr("companion.flightlog.record._TlogFile.write", _raise_full)
    log.write_mavlink(heartbeats(1)[0], 1.0, "in")
    log.write("notice", Notice(1.0, "a", "b"), 1.0)
    log.close()
    assert log.kept["notice"] == [Notice(1.0, "a", "b")]


def test_what_the_disk_lost_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = FlightLog(tmp_path, START_UNIX_S)
    monkeypatch.setattr("companion.flightlog.record._McapFile.write", _raise_full)
    log.write("imu", imu(0.0), 0.0)
    until_told = threading.Event()
    for _ in range(200):
        if log.problem is not None:
            break
        until_told.wait(0.01)
    assert log.problem == "the flight log on disk ends here: No space left on device"
    log.close()


def _raise_full(*_arguments: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")
