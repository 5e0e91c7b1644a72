"""A log whose writer was killed, or that was cut anywhere: all but the last second reads."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from companion.base.messages import ImuSample
from companion.cli import cli
from companion.config import ConfigError
from companion.flightlog.log_file import records
from companion.flightlog.record import FlightLog

# logs at 200 Hz by its own clock, and says how far it has come
WRITER = """
import sys, time
from companion.base.messages import ImuSample
from companion.flightlog.record import FlightLog
from pathlib import Path
log = FlightLog(Path(sys.argv[1]), 1.7e9)
begun = time.monotonic()
while True:
    now = time.monotonic() - begun
    log.write("imu", ImuSample(now, (0.0, 0.1, 0.2), (0.0, 0.0, -9.81), 30.0), now)
    print(now, flush=True)
    time.sleep(0.005)
"""


def last_time_s(path: Path) -> float:
    """The time of the newest message that reads."""
    newest_ns = 0
    with path.open("rb") as stream:
        for record in records(stream, lambda: None):
            newest_ns = max(newest_ns, getattr(record, "log_time", 0))
    return 1e-9 * newest_ns - 1.7e9


def test_after_kill_9_at_most_the_last_second_is_missing(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    reached_s = 0.0
    with process:
        for line in process.stdout:
            reached_s = float(line)
            if reached_s > 2.3:
                process.send_signal(signal.SIGKILL)
                break
    assert last_time_s(tmp_path / "flight.mcap") > reached_s - 1.0


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    log = FlightLog(folder, 1.7e9)
    for k in range(2000):
        log.write("imu", ImuSample(0.005 * k, (0.001 * k, 0.1, 0.2), (0.0, 0.0, -9.81), 30.0), 0.005 * k)
    log.close()
    return (folder / "flight.mcap").read_bytes()


def test_cut_anywhere_it_reads_without_an_exception_and_in_order(whole: bytes, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = tmp_path / "cut.mcap"
    for length in sorted(rng.integers(0, len(whole), 120)):
        path.write_bytes(whole[:length])
        last_s = last_time_s(path)
        # ten seconds: what is missing is less than a chunk of half a second and the index behind the data
        assert last_s == -1.7e9 or last_s >= 10.0 * length / len(whole) - 2.0


def test_what_comes_before_a_bit_that_flipped_reads_without_an_exception(
    whole: bytes, tmp_path: Path
) -> None:
    rng = np.random.default_rng(6)
    path = tmp_path / "flipped.mcap"
    for _ in range(120):
        data = bytearray(whole)
        place = int(rng.integers(len(data)))
        data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        assert 10.0 * place / len(whole) - 2.0 <= max(last_time_s(path), 0.0) < 10.0


def test_a_cut_log_is_repaired_beside_it_and_then_every_reader_takes_it(whole: bytes, tmp_path: Path) -> None:
    cut = tmp_path / "flight.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    result = CliRunner().invoke(cli, ["logs", "repair", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "cut short" in result.output
    assert cut.read_bytes() == whole[: len(whole) // 2]
    with (tmp_path / "flight-repaired.mcap").open("rb") as stream:
        messages = [message for _, _, message in make_reader(stream).iter_messages()]
    assert 500 < len(messages) < 2000
    assert f"{len(messages)} messages over" in result.output
    again = CliRunner().invoke(cli, ["logs", "repair", str(tmp_path)])
    assert isinstance(again.exception, ConfigError)
    assert "exists already" in str(again.exception)


@pytest.mark.parametrize("content", [b"", b"no log at all", None])
def test_what_is_no_log_is_reported_in_one_line_and_leaves_nothing(
    content: bytes | None, tmp_path: Path
) -> None:
    path = tmp_path / "flight.mcap"
    if content is not None:
        path.write_bytes(content)
    result = CliRunner().invoke(cli, ["logs", "repair", str(path)])
    assert isinstance(result.exception, ConfigError)
    assert str(path) in str(result.exception)
    assert [p.name for p in tmp_path.iterdir()] == ([] if content is None else ["flight.mcap"])
