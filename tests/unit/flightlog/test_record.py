"""The flight log: what was written can be read again by other people's tools."""

import base64
import errno
import io
import json
import math
import os
import shutil
import threading
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

import companion.flightlog.flights as flights_module
from companion.base.message_json import encode, schema_of
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
from companion.flightlog import version
from companion.flightlog.flights import (
    make_room,
    next_flight_folder,
    numbered_flights,
    pack,
    recorded_flights,
)
from companion.flightlog.record import FlightLog, split_packets
from companion.flightlog.summary import summary_of
from tests.programs import ProgramHere
from tests.unit.flightlog.replay.log_files import own_rig
from tests.unit.flightlog.test_result import pad_at

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
    log = FlightLog(tmp_path, START_UNIX_S)
    image = np.tile(np.arange(160, dtype=np.uint8), (120, 1))
    for k in range(30):
        log.write_frame(Frame(k / 30.0, k / 30.0, k, image), k / 30.0)
    log.close()
    frames = [data for topic, data, _ in read_mcap(tmp_path / "flight.mcap") if topic == "/camera"]
    assert len(frames) == pytest.approx(5, abs=1)
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


# ----------------
# Many flights: numbers that sort by time, room for the next, `companion logs` and what it lists.


def record(folder: Path, start_unix_s: float = 1.79e9, last: Phase = Phase.LANDED) -> Path:
    log, rig = FlightLog(folder, start_unix_s), own_rig()
    log.write_settings(config=rig.config, vehicle=rig.vehicle, pad=rig.pad)
    for k in range(300):
        log.write("plan", PlanStep(0.1 * k, Phase.SEARCH if k < 250 else last), 0.1 * k)
        log.write("pad", pad_at(0.1 * k, 0.0), 0.1 * k)
    log.close()
    return folder


def cut(folder: Path) -> None:
    log = folder / "flight.mcap"
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])


def filled(root: Path, numbers: range, size: int) -> list[Path]:
    folders = [root / f"flight-{number:04d}" for number in numbers]
    for folder in folders:
        folder.mkdir(parents=True)
        (folder / "flight.mcap").write_bytes(bytes(size))
    return folders


# ---------------------------------------------------------------- folders


def test_flights_are_numbered_and_sort_by_number_past_9999(tmp_path: Path) -> None:
    assert next_flight_folder(tmp_path / "new") == tmp_path / "new" / "flight-0001"
    for name in ("flight-0009", "flight-0010", "flight-9999", "flight-10000", "flight-9-of-last-year"):
        (tmp_path / name).mkdir()
    (tmp_path / "flight-20000").touch()
    assert [path.name for path in numbered_flights(tmp_path)][-2:] == ["flight-9999", "flight-10000"]
    assert next_flight_folder(tmp_path) == tmp_path / "flight-10001"


def test_a_clock_that_went_back_overwrites_nothing(tmp_path: Path) -> None:
    """GIVEN a flight of today, WHEN the next start has the clock of 1970, THEN it is the newest still."""
    record(next_flight_folder(tmp_path), 1.79e9)
    before = (tmp_path / "flight-0001" / "flight.mcap").read_bytes()
    record(next_flight_folder(tmp_path), 30.0)
    assert [path.name for path in recorded_flights(tmp_path)] == ["flight-0001", "flight-0002"]
    assert (tmp_path / "flight-0001" / "flight.mcap").read_bytes() == before
    with pytest.raises(ConfigError, match="File exists"):
        FlightLog(tmp_path / "flight-0001", 30.0)


def test_the_oldest_flights_make_room(tmp_path: Path) -> None:
    flights = filled(tmp_path, range(8, 13), 1000)
    other = tmp_path / "flight-of-mine"
    other.mkdir()
    (other / "flight.mcap").write_bytes(bytes(50_000))
    assert make_room(tmp_path, 5000, 0) == []
    assert make_room(tmp_path, 3500, 0) == flights[:2]
    assert [path.name for path in sorted(tmp_path.iterdir())] == [
        *(f"flight-{n:04d}" for n in (10, 11, 12)),
        "flight-of-mine",
    ]


def full_disk(monkeypatch: pytest.MonkeyPatch, flights: list[Path], total_bytes: int) -> None:
    """A disk on which only what is removed of these flights, 1000 bytes each, is free."""

    def usage(_: Path) -> Any:
        free = 1000 * sum(not path.exists() for path in flights)
        return shutil._ntuple_diskusage(total_bytes, total_bytes - free, free)

    monkeypatch.setattr(shutil, "disk_usage", usage)


def test_a_full_disk_makes_room_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flights = filled(tmp_path, range(1, 6), 1000)
    full_disk(monkeypatch, flights, 9000)
    assert make_room(tmp_path, 10**9, 2000) == flights[:2]


def test_no_flight_is_removed_in_vain_where_other_programs_have_filled_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GIVEN a disk full of others' files, WHEN all flights would not make room, THEN they stay, and why."""
    flights = filled(tmp_path, range(1, 6), 1000)
    full_disk(monkeypatch, flights, 9_000_000)
    with pytest.raises(ConfigError, match=r"^record\.free_mb 0\.005: without all old flights 0 MB"):
        make_room(tmp_path, 10**9, 5000)  # the newest stays: four of them make 4000
    assert numbered_flights(tmp_path) == flights
    with pytest.raises(ConfigError, match=r"^record\.free_mb"):
        make_room(tmp_path, 3500, 5000)  # what all flights may take is within reach
    assert numbered_flights(tmp_path) == flights[2:]


def test_what_cannot_be_removed_makes_no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flights = filled(tmp_path, range(1, 6), 1000)
    full_disk(monkeypatch, flights, 9000)
    removes = flights_module._remove
    monkeypatch.setattr(flights_module, "_remove", lambda path: path != flights[0] and removes(path))
    with pytest.raises(ConfigError, match=r"^record\.free_mb 0\.004"):
        make_room(tmp_path, 10**9, 4000)
    assert numbered_flights(tmp_path) == flights


@pytest.mark.parametrize("free_bytes", [1e15, math.inf])
def test_no_flight_is_removed_for_more_room_than_the_disk_has(tmp_path: Path, free_bytes: float) -> None:
    """GIVEN bytes or gigabytes typed for megabytes, WHEN room is made, THEN all flights stay, and why."""
    flights = filled(tmp_path, range(1, 6), 1000)
    with pytest.raises(ConfigError, match=r"^record\.free_mb .*: without all old flights [0-9]+ MB would"):
        make_room(tmp_path, math.inf, free_bytes)
    assert numbered_flights(tmp_path) == flights


def test_neither_the_newest_nor_the_one_being_written_is_removed(tmp_path: Path) -> None:
    flights = filled(tmp_path, range(1, 5), 1000)
    assert make_room(tmp_path, 0, 0, keep=[flights[1]]) == [flights[0], flights[2]]
    assert numbered_flights(tmp_path) == [flights[1], flights[3]]
    assert next_flight_folder(tmp_path).name == "flight-0005"


def test_a_flight_that_cannot_be_removed_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flights = filled(tmp_path, range(1, 5), 1000)
    rename = Path.rename

    def refused(self: Path, target: Path) -> Path:
        if self == flights[0]:
            raise PermissionError
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refused)
    assert make_room(tmp_path, 2000, 0) == flights[1:3]


def test_a_file_that_cannot_be_read_any_more_counts_for_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flights = filled(tmp_path, range(1, 5), 1000)
    stat = Path.stat

    def damaged(self: Path, **given: bool) -> os.stat_result:
        if self.parent == flights[0]:
            raise OSError(errno.EUCLEAN, "Structure needs cleaning")
        return stat(self, **given)

    monkeypatch.setattr(Path, "stat", damaged)
    assert make_room(tmp_path, 2000, 0) == flights[:2]


def test_a_removal_that_was_cut_short_is_ended_by_the_next(tmp_path: Path) -> None:
    (tmp_path / ".removed-flight-0001").mkdir()
    make_room(tmp_path, 10**9, 0)
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- the list


def test_flights_are_listed_with_date_outcome_error_and_length(tmp_path: Path, program: ProgramHere) -> None:
    record(tmp_path / "flight-0001", 1.7e9)
    cut(record(tmp_path / "flight-0002", 30.0, Phase.ABORT))
    record(tmp_path / "flight-0003", 1.79e9, Phase.ABORT)
    simulated = record(tmp_path / "circle", 1.79e9, Phase.ABORT)
    result = {"outcome": "missed", "touchdown": {"lateral_error_m": 1.25}}
    (simulated / "result.json").write_text(json.dumps(result))
    (tmp_path / "latch.json").touch()
    said = program("companion", "logs", "--record", tmp_path)
    assert said.err.split() == ["flight", "began", "time", "off", "the", "pad", "size", "outcome"]
    lines = said.out.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["flight-0001", "flight-0002", "flight-0003", "circle"]
    assert "2023-11-14 22:13" not in lines[0]  # 1.7e9 is before 2024: no clock of today's
    assert lines[0].split()[-1] == "landed"
    assert " 30 s" in lines[0]
    assert "~50.0 cm" in lines[0]
    assert "no date (clock)" in lines[1]
    assert "log cut short" in lines[1]
    assert "2026-09-21 14:13" in lines[2]
    assert lines[2].split()[-1] == "aborted"
    assert "125.0 cm  " in lines[3]
    assert lines[3].split()[-1] == "missed"
    assert lines[4].startswith("4 flights in")
    assert max(map(len, lines[:4])) <= 100


def test_a_summary_by_the_index_is_that_of_the_whole_log(tmp_path: Path) -> None:
    folder = record(tmp_path / "flight-0001")
    by_index = summary_of(folder)
    log = folder / "flight.mcap"
    log.write_bytes(log.read_bytes()[:-16])  # no magic at the end, so no index
    through = summary_of(folder)
    assert (through.outcome, through.lateral_m, through.start_unix_s, through.seconds) == (
        by_index.outcome,
        by_index.lateral_m,
        by_index.start_unix_s,
        by_index.seconds,
    )


# ---------------------------------------------------------------- one flight


def test_a_flight_is_exported_whole_by_its_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: ProgramHere
) -> None:
    record(tmp_path / "flights" / "flight-0007")
    monkeypatch.chdir(tmp_path)
    assert program("companion", "logs", "export", "7", "--record", "flights").code == 0
    with zipfile.ZipFile("flight-0007.zip") as archive:
        assert {name for name in archive.namelist() if not name.endswith("/")} == {
            f"flight-0007/{name}" for name in ("flight.mcap", "flight.tlog", "settings.yaml")
        }
        assert archive.read("flight-0007/flight.mcap") == Path("flights/flight-0007/flight.mcap").read_bytes()
    again = program("companion", "logs", "export", "flights/flight-0007")
    assert "flight-0007.zip: exists already" in again.refusal


def test_a_flight_of_1970_is_packed_too(tmp_path: Path) -> None:
    """GIVEN a Raspberry Pi whose clock was never set, WHEN its flight is packed, THEN all of it is there."""
    (folder,) = filled(tmp_path, range(1, 2), 1000)
    os.utime(folder / "flight.mcap", (30.0, 30.0))
    with zipfile.ZipFile(io.BytesIO(b"".join(pack(folder)))) as archive:
        assert archive.testzip() is None
        assert archive.read("flight-0001/flight.mcap") == (folder / "flight.mcap").read_bytes()


def test_a_flight_is_exported_by_its_name_in_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: ProgramHere
) -> None:
    record(tmp_path / "flights" / "circle")
    monkeypatch.chdir(tmp_path)
    assert program("companion", "logs", "export", "circle").code == 0
    with zipfile.ZipFile("circle.zip") as archive:
        assert "circle/flight.mcap" in archive.namelist()
    (tmp_path / "circle").mkdir()  # one of that name lies here too: where the flights are was said
    program("companion", "logs", "export", "circle", "--record", "flights", "--output", "second.zip")
    assert Path("second.zip").stat().st_size == Path("circle.zip").stat().st_size


@pytest.mark.parametrize(
    ("words", "told"),
    [
        pytest.param(("export", "8"), "no flight 8", id="no such number"),
        pytest.param(("export",), "which one", id="none named"),
        pytest.param(("list", "7"), "lists all flights", id="one too many"),
        pytest.param(("export", "nowhere"), "cannot be read", id="no such folder"),
        pytest.param(("--record", "nowhere"), "nowhere: cannot be read", id="no such root"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line(
    words: tuple[str, ...], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: ProgramHere
) -> None:
    monkeypatch.chdir(tmp_path)
    record(Path("flights/flight-0007"))
    assert told in program("companion", "logs", *words).refusal


def test_settings_calibrations_versions_and_revision_lie_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(version, "revision", lambda: "0123456789ab-dirty")
    told = yaml.safe_load((record(tmp_path / "flight-0001") / "settings.yaml").read_text())
    assert told.keys() == {"versions", "config", "vehicle", "pad"}
    assert told["versions"]["revision"] == "0123456789ab-dirty"
    assert told["config"] == own_rig().config.model_dump(mode="json")


def test_an_installed_copy_knows_its_revision_by_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(version, "REVISION_FILE", tmp_path / "REVISION")
    monkeypatch.setattr(version, "ROOT", tmp_path)
    version.revision.cache_clear()
    assert version.revision() is None
    (tmp_path / "REVISION").write_text("abc123\n")
    version.revision.cache_clear()
    assert version.revision() == "abc123"
    version.revision.cache_clear()
