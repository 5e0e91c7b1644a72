"""`companion replay` as a user meets it: files, words and exit codes."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from companion.flightlog.log_file import log_name
from companion.flightlog.record import FlightLog
from tests.programs import ProgramHere
from tests.unit.estimate.estimate_flight import EstimateFlight, hover, pad_at_rest, sprint
from tests.unit.flightlog.replay.log_files import FLIGHT, write_dataflash, write_own, write_ulog

PLOTS = {"attitude", "velocity", "position", "biases", "refused"}


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("COLUMNS", "200")


def test_a_flight_of_ours_leaves_numbers_and_plots(tmp_path: Path, program: ProgramHere) -> None:
    write_own(tmp_path / "circle")
    said = program("companion", "replay", tmp_path / "circle")
    assert said.code == 0
    folder = Path("replay/circle")
    assert {path.name for path in folder.iterdir()} == {"replay.html", "replay.json"}
    result = json.loads((folder / "replay.json").read_text())
    assert result["repetition"]["identical"] is True
    assert result["errors"]["recorded"]["attitude_deg"]["worst"] == 0.0
    assert result["settings"] == "the flight's own"
    assert "recorded states to the bit" in said.out
    assert str(folder) in said.out
    assert said.err == ""
    page = (folder / "replay.html").read_text()
    assert {
        plot for plot in (*PLOTS, "pad_position", "pad_velocity") if f'id="plot-{plot}"' not in page
    } == set()


@pytest.mark.parametrize("write", [write_dataflash, write_ulog])
def test_an_autopilots_log_leaves_them_where_asked(
    tmp_path: Path, write: object, program: ProgramHere
) -> None:
    assert callable(write)
    log = write(tmp_path / "log.of.mine")
    assert program("companion", "replay", log, "-o", tmp_path / "out" / "first").code == 0
    left = {path.name for path in (tmp_path / "out" / "first").iterdir()}
    assert left == {"replay.html", "replay.json"}
    result = json.loads((tmp_path / "out" / "first" / "replay.json").read_text())
    assert result["repetition"] is None
    assert result["errors"]["recorded"]["pad_position_m"] is None
    assert result["samples"]["imu"] == 3199
    assert result["duration_s"] == pytest.approx(16.0, abs=0.1)


def test_the_same_replay_twice_gives_the_same_numbers(tmp_path: Path, program: ProgramHere) -> None:
    log = write_ulog(tmp_path / "a.ulg")
    texts = []
    for name in ("one", "two"):
        assert program("companion", "replay", log, "--output", tmp_path / name).code == 0
        texts.append((tmp_path / name / "replay.json").read_text())
    assert texts[0] == texts[1]


def test_a_cut_log_is_replayed_and_said_to_be_cut(tmp_path: Path, program: ProgramHere) -> None:
    log = write_own(tmp_path / "flight")
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    said = program("companion", "replay", log)
    assert said.code == 0
    assert "note: the log is cut after" in said.out


def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, program: ProgramHere) -> None:
    (tmp_path / "empty.bin").touch()
    (tmp_path / "text.log").write_text("FMT, 128, 89, FMT, BBnNZ, Type")
    (tmp_path / "magic.bin").write_bytes(b"\xa3\x95")
    (tmp_path / "magic.ulg").write_bytes(b"ULog\x01\x12\x35")
    (tmp_path / "magic.mcap").write_bytes(b"\x89MCAP0\r\n")
    for name, words in {
        "missing.bin": "cannot be read: No such file",
        "here": "flight.mcap: cannot be read: No such file",
        "empty.bin": "not a flight log; expected a flight's folder",
        "text.log": "not a flight log",
        "magic.bin": "no IMU samples",
        "magic.ulg": "not a ULog that can be read",
        "magic.mcap": "no IMU samples in the log (the log is cut after 0.0 s",
    }.items():
        assert words in program("companion", "replay", tmp_path / name).refusal, name
    assert not Path("replay").exists()


def test_a_log_that_nothing_can_be_replayed_from_is_refused(tmp_path: Path, program: ProgramHere) -> None:
    FlightLog(tmp_path / "own", 0.0).close()
    assert "no IMU samples" in program("companion", "replay", tmp_path / "own").refusal
    no_imu = write_dataflash(tmp_path / "a.bin", leave_out=("IMU",))
    assert "no IMU samples" in program("companion", "replay", no_imu).refusal
    no_mag = write_dataflash(tmp_path / "b.bin", leave_out=("MAG",))
    assert "no magnetometer samples" in program("companion", "replay", no_mag).refusal
    short = write_ulog(tmp_path / "c.ulg", EstimateFlight(hover, pad_at_rest, duration_s=1.0))
    words = program("companion", "replay", short).refusal
    assert "never aligned: it is at rest for" in words
    assert "1.0 s long" in words


def test_settings_and_folders_that_are_wrong_are_refused(tmp_path: Path, program: ProgramHere) -> None:
    log = write_ulog(tmp_path / "a.ulg", EstimateFlight(hover, pad_at_rest, duration_s=4.0))
    (tmp_path / "bad.yaml").write_text("estimat: {}\n")
    config = program("companion", "replay", log, "--config", tmp_path / "bad.yaml").refusal
    assert "unknown key 'estimat'" in config
    assert "cannot be made" in program("companion", "replay", log, "-o", log / "inside").refusal
    assert (
        "--config: belongs to a flight"
        in program("companion", "--config", tmp_path / "bad.yaml", "replay", log).refusal
    )
    assert "companion replay --help" in program("companion", "replay").refusal
    assert "companion --help" in program("companion", "replai", log).refusal


def test_a_log_that_starts_in_flight_is_aligned_all_the_same(tmp_path: Path, program: ProgramHere) -> None:
    log = write_ulog(tmp_path / "a.ulg", EstimateFlight(sprint, pad_at_rest, duration_s=42.0), start_s=12.0)
    assert program("companion", "replay", log, "-o", tmp_path / "out").code == 0
    result = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert 1.8 < result["aligned_after_s"] < 2.2
    assert result["errors"]["recorded"]["inclination_deg"]["rms"] < 5.0
    assert result["errors"]["recorded"]["velocity_m_s"]["rms"] < 1.0


def test_the_help_shows_how_to_start() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "companion.cli", "replay", "--help"],
        cwd=Path(__file__).resolve().parents[4],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert "\n companion replay flights/circle\n" in done.stdout.replace("  ", " ")
    assert "--config" in done.stdout


@pytest.mark.parametrize(
    ("path", "name"),
    [("/a/circle/flight.mcap", "circle"), ("/a/00000042.BIN", "00000042"), ("/a/b.ulg", "b")],
)
def test_a_log_is_called_by_its_file_or_its_folder(path: str, name: str) -> None:
    assert log_name(Path(path)) == name


def test_nothing_is_drawn_while_nobody_watches(tmp_path: Path, program: ProgramHere) -> None:
    said = program("companion", "replay", write_ulog(tmp_path / "a.ulg", FLIGHT), "-o", tmp_path / "o")
    assert said.code == 0
    assert "\x1b" not in said.out
    assert "━━━━━━━━━ 1" not in said.out
    assert said.err == ""
