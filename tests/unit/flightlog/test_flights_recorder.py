"""Many flights, a folder each, with the minute before; and what the meter says of the inputs."""

import errno
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.base.message_json import encode
from companion.base.messages import Frame, ImuSample, Notice
from companion.config import CompanionConfig
from companion.flightlog import disk, flights_recorder
from companion.flightlog.disk import DiskWriter
from companion.flightlog.flights import next_flight_folder, numbered_flights
from companion.flightlog.flights_recorder import KEPT_S, FlightsRecorder
from companion.flightlog.log_file import LogReader, records
from companion.flightlog.meter import WINDOW_S, Meter
from companion.flightlog.record import FlightLog
from companion.flightlog.summary import summary_of
from tests.programs import ProgramHere
from tests.waiting import soon


def texts(folder: Path) -> list[str]:
    """The notices of a flight's log, in the order of their times."""
    with (folder / "flight.mcap").open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=["/notice"])
        return [json.loads(message.data)["text"] for _, _, message in found]


def tell(log: FlightsRecorder, time_s: float) -> None:
    log.write("notice", Notice(time_s, "test", f"at {time_s:g}"), time_s)


def dates(root: Path) -> list[float | None]:
    """When the flights began, as `companion logs` lists them."""
    return [summary_of(folder).start_unix_s for folder in numbered_flights(root)]


def test_a_clock_that_is_set_after_the_start_dates_the_next_flight(tmp_path: Path) -> None:
    # a Raspberry Pi without a network starts where it was switched off, and may step either way
    clock = iter((1000.0, 1000.0, 1.9e9, 1.8e9))
    log = FlightsRecorder(tmp_path, lambda: next(clock))
    for time_s in (10.0, 20.0, 30.0):
        tell(log, time_s)
        log.begin()
        assert soon(lambda: log.flight_folder is not None)
        log.end()
    log.close()
    assert [folder.name for folder in numbered_flights(tmp_path)] == [
        "flight-0001",
        "flight-0002",
        "flight-0003",
    ]
    assert dates(tmp_path) == [None, 1.9e9 + 20.0, 1.8e9 + 30.0]


def test_each_flight_begins_with_the_minute_before_it(tmp_path: Path) -> None:
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    log.write_settings(config=CompanionConfig())
    for second in range(100):
        tell(log, float(second))
    assert list(tmp_path.iterdir()) == []
    log.begin()
    assert soon(lambda: log.flight_folder == tmp_path / "flight-0001")
    tell(log, 100.0)
    log.end()
    tell(log, 150.0)
    log.begin()
    tell(log, 151.0)
    log.close()
    assert texts(tmp_path / "flight-0001") == [f"at {second}" for second in range(99 - int(KEPT_S), 101)]
    assert texts(tmp_path / "flight-0002") == ["at 150", "at 151"]
    for folder in tmp_path.iterdir():
        with (folder / "flight.mcap").open("rb") as stream:
            names = [record.name for record in make_reader(stream).iter_metadata()]
        assert "settings" in names


def test_the_minute_before_is_written_through_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[int] = []
    monkeypatch.setattr("os.fsync", written.append)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    for second in range(50):
        tell(log, float(second))
        log.write_mavlink(b"\xfe\x00\x00\x01\x01\x00\x00\x00", float(second), "in")
    log.begin()
    log.end()
    log.close()
    assert len(written) == 2  # each file
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    log.begin()
    assert soon(lambda: log.flight_folder is not None)
    for second in range(50):
        tell(log, float(second))
    log.close()
    assert len(written) > 50


def test_the_minute_before_is_written_in_slices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # the writer's processor time passes with each message that it writes
    rests_at: list[int] = []
    written = [0]

    def counted(message: object) -> bytes:
        written[0] += 1
        return encode(message)

    monkeypatch.setattr("companion.flightlog.record.encode", counted)
    monkeypatch.setattr(disk, "thread_processor_s", lambda: 1e-4 * written[0])
    monkeypatch.setattr(disk, "sleep_s", lambda _: rests_at.append(written[0]))
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    for number in range(1000):
        tell(log, 0.05 * number)
    log.begin()
    assert soon(lambda: log.flight_folder is not None and written[0] == 1000)
    log.close()
    slices = [after - before for before, after in pairwise([0, *rests_at, 1000])]
    assert 1e-4 * max(slices) < disk.SLICE_S + 2e-4


def test_the_settings_are_prepared_before_an_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    log.write_settings(config=CompanionConfig())
    assert log._settings_record is not None
    log._settings_record.result(10.0)
    monkeypatch.setattr("yaml.safe_dump", None)  # would be called
    log.begin()
    log.close()
    assert (tmp_path / "flight-0001" / "settings.yaml").read_text().startswith("versions:")


def test_pictures_and_mavlink_of_the_minute_are_there_too(tmp_path: Path) -> None:
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    image = np.zeros((48, 64), np.uint8)
    for number in range(100):
        time_s = 0.1 * number
        log.write_frame(Frame(time_s, time_s, number, image), time_s)
        log.write_mavlink(b"\xfe\x00\x00\x01\x01\x00\x00\x00", time_s, "in")
    log.begin()
    log.close()
    with (tmp_path / "flight-0001" / "flight.mcap").open("rb") as stream:
        pictures = list(make_reader(stream).iter_messages(topics=["/camera"]))
    assert len(pictures) == 10  # one a second
    assert (tmp_path / "flight-0001" / "flight.tlog").stat().st_size == 100 * 16


def test_a_card_that_cannot_be_written_is_reported_and_ends_no_flight(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    log = FlightsRecorder(blocked, lambda: 1.7e9)
    log.begin()
    tell(log, 1.0)
    assert soon(lambda: "cannot be written" in (log.problem or ""))
    log.end()


def hanging_card(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """No flight's folder is made before the event is set."""
    answers = threading.Event()

    def slow_folder(root: Path) -> Path:
        assert answers.wait(10.0)
        return next_flight_folder(root)

    monkeypatch.setattr(flights_recorder, "next_flight_folder", slow_folder)
    return answers


def test_a_card_that_hangs_holds_nobody_up_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = hanging_card(monkeypatch)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    tell(log, 0.0)
    log.begin()
    tell(log, 1.0)
    assert (log.flight_folder, log.problem) == (None, None)
    answers.set()
    assert soon(lambda: log.flight_folder is not None)
    tell(log, 2.0)
    log.close()
    assert texts(tmp_path / "flight-0001") == ["at 0", "at 1", "at 2"]


def losses(folder: Path) -> dict[str, str]:
    """What the log says it has lost; nothing: nothing."""
    reader = LogReader(folder / "flight.mcap")
    assert list(reader.messages())
    return reader.metadata.get("losses", {})


@pytest.mark.parametrize("ends_first", [False, True])
def test_what_a_card_that_hangs_for_over_a_minute_costs_is_counted_and_told(
    ends_first: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = hanging_card(monkeypatch)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    for second in range(100):
        tell(log, float(second))
        if second == 9:
            log.begin()
        if second == 10 + KEPT_S:
            assert log.problem is None  # of the minute before, not of the flight
    told = "the disk does not answer: 29 messages lost from the log"
    assert log.problem == told
    if ends_first:
        log.end()
    answers.set()
    if not ends_first:
        assert soon(lambda: log.flight_folder is not None)
        assert "29 messages lost" in (log.problem or "")
    log.close()
    folder = tmp_path / "flight-0001"
    assert texts(folder) == [f"at {second}" for second in range(39, 100)]
    assert losses(folder) == {"messages": "29"}


def test_what_does_not_fit_in_memory_while_a_card_hangs_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flights_recorder, "MOST_KEPT", 5)
    answers = hanging_card(monkeypatch)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    for second in range(10):
        tell(log, float(second))  # in standby that is no loss
    log.begin()
    for second in range(10, 18):
        tell(log, float(second))
    answers.set()
    log.close()
    assert losses(tmp_path / "flight-0001") == {"messages": "3"}


def test_a_flight_that_ends_before_its_log_is_open_is_logged(tmp_path: Path) -> None:
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    for number in (1, 2):
        tell(log, 10.0 * number)
        log.begin()
        log.end()
    log.close()
    assert [texts(tmp_path / f"flight-000{number}") for number in (1, 2)] == [["at 10"], ["at 20"]]


def test_a_card_that_hangs_beyond_the_flight_s_end_holds_nobody_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = hanging_card(monkeypatch)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    for number in (1, 2):
        tell(log, 10.0 * number)
        log.begin()
        tell(log, 10.0 * number + 1.0)
        log.end()  # would wait for ever: the card answers only after it
    tell(log, 30.0)
    assert list(tmp_path.iterdir()) == []
    answers.set()
    log.close()
    assert texts(tmp_path / "flight-0001") == ["at 10", "at 11"]
    assert texts(tmp_path / "flight-0002") == ["at 20", "at 21"]


def test_a_card_that_hangs_in_a_flight_does_not_hold_its_end_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs, answers = threading.Event(), threading.Event()

    def hang(_: int) -> None:
        hangs.set()
        assert answers.wait(10.0)

    monkeypatch.setattr("companion.flightlog.disk.QUEUE_SIZE", 4)
    monkeypatch.setattr("os.fsync", hang)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    log.begin()
    assert soon(lambda: log.flight_folder is not None)
    assert hangs.wait(10.0)
    for second in range(20):
        tell(log, float(second))
    assert "lost" in (log.problem or "")  # the queue is full
    ending = threading.Thread(target=log.end, daemon=True)
    ending.start()
    ending.join(5.0)
    waited = ending.is_alive()
    answers.set()
    ending.join()
    log.close()
    assert not waited


def test_no_fault_of_the_opening_reaches_who_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_thread(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    log = FlightsRecorder(tmp_path, lambda: 1.7e9)
    with monkeypatch.context() as patch:
        patch.setattr("threading.Thread.start", no_thread)
        log.begin()
        tell(log, 1.0)
        assert soon(lambda: "can't start new thread" in (log.problem or ""))
        log.end()
    log.begin()
    tell(log, 2.0)
    log.close()
    assert texts(tmp_path / "flight-0002") == ["at 1", "at 2"]


def test_room_is_made_after_each_flight(tmp_path: Path) -> None:
    made = threading.Semaphore(0)
    log = FlightsRecorder(tmp_path, lambda: 1.7e9, made.release)
    for _ in range(2):
        log.begin()
        log.end()
        assert made.acquire(timeout=10.0)
    log.close()


def test_without_a_folder_nothing_is_kept(tmp_path: Path) -> None:
    log = FlightsRecorder(None, lambda: 1.7e9)
    for second in range(1000):
        tell(log, float(second))
    log.begin()
    assert (log.flight_folder, log.problem) == (None, None)
    assert log.kept == {}
    log.close()


def test_the_meter_tells_rates_ages_and_latencies() -> None:
    meter = Meter()
    for number in range(int(4.0 * WINDOW_S * 50)):
        meter.note("imu", None, number / 50.0)
    end_s = 4.0 * WINDOW_S
    rate = meter.rates(end_s)["imu"]
    assert rate.rate_hz == pytest.approx(50.0, rel=0.02)
    assert rate.age_s == pytest.approx(0.02)
    # silent since: the rate falls to nothing
    meter.rates(end_s + 2.0 * WINDOW_S)
    assert meter.rates(end_s + 4.0 * WINDOW_S)["imu"].rate_hz == 0.0
    assert meter.latency_ms() == {}


# ----------------
# A card that stalls or is full: `put` returns at once, what explains the flight is dropped last.


class SlowCard:
    """Writes nothing until it is let go on; keeps what came through."""

    def __init__(self) -> None:
        self.goes_on, self.stands = threading.Event(), threading.Event()
        self.written: list[object] = []

    def write(self, item: object) -> None:
        self.stands.set()
        assert self.goes_on.wait(30.0)
        self.written.append(item)


@pytest.fixture
def card() -> Iterator[SlowCard]:
    card = SlowCard()
    yield card
    card.goes_on.set()


def held_up(card: SlowCard) -> DiskWriter:
    """A writer whose thread stands in its first write, with an empty queue."""
    writer = DiskWriter()
    writer.put(card.write, "first")
    assert card.stands.wait(30.0)
    return writer


def test_with_the_queue_full_put_waits_for_nobody_and_counts(
    card: SlowCard, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = held_up(card)
    put = writer._queue.put

    def put_without_waiting(item: Any, block: bool = True) -> None:
        assert not block
        put(item, block=False)

    monkeypatch.setattr(writer._queue, "put", put_without_waiting)
    for k in range(disk.QUEUE_SIZE + 50):
        writer.put(card.write, k)
    assert writer.lost == 50
    assert writer.problem == "the disk does not keep up: 50 messages lost from the log"
    monkeypatch.undo()
    card.goes_on.set()
    writer.finish()
    assert card.written == ["first", *range(disk.QUEUE_SIZE)]


def test_what_is_bulky_goes_first(card: SlowCard) -> None:
    writer = held_up(card)
    for k in range(disk.QUEUE_SIZE):
        writer.put(card.write, ("sample", k), bulky=True)
    kept = disk.QUEUE_SIZE - writer.lost
    assert kept == pytest.approx(disk.BULKY_SHARE * disk.QUEUE_SIZE, abs=1)
    writer.put(card.write, "notice")
    card.goes_on.set()
    writer.finish()
    assert card.written[-1] == "notice"
    assert len(card.written) == 1 + kept + 1


def test_frames_are_bounded_by_the_memory_they_hold(card: SlowCard) -> None:
    writer = held_up(card)
    for k in range(20):
        writer.put(card.write, k, bulky=True, size_bytes=disk.QUEUE_BYTES // 10)
    assert writer.lost == 10
    card.goes_on.set()
    writer.finish()
    assert len(card.written) == 1 + 10


def test_once_the_card_keeps_up_again_so_does_the_log(card: SlowCard) -> None:
    writer = held_up(card)
    for _ in range(2):
        writer.put(card.write, "frame", size_bytes=disk.QUEUE_BYTES)
    assert writer.lost == 1
    card.goes_on.set()
    done = threading.Event()
    writer.put(done.set)
    assert done.wait(30.0)
    writer.put(card.write, "later", size_bytes=disk.QUEUE_BYTES)
    writer.finish()
    assert card.written == ["first", "frame", "later"]


def test_in_virtual_time_the_flight_waits_for_the_disk(card: SlowCard) -> None:
    writer = DiskWriter(waits=True)
    card.goes_on.set()
    for k in range(disk.QUEUE_SIZE + 500):
        writer.put(card.write, k, bulky=True)
    writer.finish()
    assert writer.problem is None
    assert len(card.written) == disk.QUEUE_SIZE + 500


@pytest.mark.parametrize(
    ("error", "after_it", "problem"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device"),
            [],
            "the flight log on disk ends here: No space left on device",
        ),
        (
            ValueError("not a number"),
            ["b"],
            "1 messages could not be written to the log: ValueError: not a number",
        ),
    ],
)
def test_a_full_card_ends_the_log_and_what_cannot_be_written_leaves_the_rest_whole(
    error: Exception, after_it: list[object], problem: str
) -> None:
    def fails(_item: object) -> None:
        raise error

    written: list[object] = []
    writer = DiskWriter()
    writer.put(fails, "a")
    writer.put(written.append, "b")
    writer.finish()
    assert written == after_it
    assert writer.problem == problem


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), ValueError("NaN")])
def test_whatever_a_write_raises_it_is_counted_reported_and_the_files_are_closed(error: Exception) -> None:
    def fails(*_: object) -> None:
        raise error

    closed: list[str] = []
    writer = DiskWriter()
    writer.put(fails, "a")
    writer.put(fails, "b")
    writer.finish(fails, lambda: closed.append("mcap"), lambda: closed.append("tlog"))
    assert closed == ["mcap", "tlog"]
    assert writer.problem is not None
    assert ("No space left" if isinstance(error, OSError) else "3 messages") in writer.problem


def test_a_full_queue_keeps_no_file_from_being_closed(card: SlowCard) -> None:
    writer = held_up(card)
    for k in range(disk.QUEUE_SIZE - 1):
        writer.put(card.write, k)
    closed: list[str] = []
    writer.finish(lambda: closed.append("mcap"), wait=False)
    card.goes_on.set()
    writer.join()
    assert closed == ["mcap"]


WORK_S = 0.0003  # each write computes for so long, by the thread's own clock


class Processor:
    """The writer's processor time and its rests, without a real clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.worked_s = 0.0
        self.rests_at_s: list[float] = []
        monkeypatch.setattr(disk, "thread_processor_s", lambda: self.worked_s)
        monkeypatch.setattr(disk, "sleep_s", lambda _: self.rests_at_s.append(self.worked_s))

    def compute(self) -> None:
        self.worked_s += WORK_S


def test_a_backlog_is_written_in_slices_with_rests_between(monkeypatch: pytest.MonkeyPatch) -> None:
    processor, written = Processor(monkeypatch), threading.Event()
    writer = DiskWriter()
    for _ in range(600):
        writer.put(processor.compute)
    writer.put(written.set)
    assert written.wait(30.0)
    moments_s = [0.0, *processor.rests_at_s, processor.worked_s]
    slices_s = [after - before for before, after in pairwise(moments_s)]
    assert max(slices_s) < disk.SLICE_S + 2.0 * WORK_S
    # once nothing flies, what is left is written without rests
    rests = len(processor.rests_at_s)
    writer._hurries = True
    for _ in range(600):
        writer.put(processor.compute)
    writer.finish()
    assert len(processor.rests_at_s) == rests


def test_in_virtual_time_the_writer_never_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    processor = Processor(monkeypatch)
    writer = DiskWriter(waits=True)
    for _ in range(600):
        writer.put(processor.compute)
    writer.finish()
    assert processor.rests_at_s == []


# ---------------- A log whose writer was killed, or that was cut anywhere: all but the last second reads

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


def test_a_cut_log_is_repaired_beside_it_and_then_every_reader_takes_it(
    whole: bytes, tmp_path: Path, program: ProgramHere
) -> None:
    cut = tmp_path / "flight.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    result = program("companion", "logs", "repair", tmp_path)
    assert result.code == 0, result
    assert "cut short" in result.out + result.err
    assert cut.read_bytes() == whole[: len(whole) // 2]
    with (tmp_path / "flight-repaired.mcap").open("rb") as stream:
        messages = [message for _, _, message in make_reader(stream).iter_messages()]
    assert 500 < len(messages) < 2000
    assert f"{len(messages)} messages over" in result.out + result.err
    assert "exists already" in program("companion", "logs", "repair", tmp_path).refusal


@pytest.mark.parametrize("content", [b"", b"no log at all", None])
def test_what_is_no_log_is_reported_in_one_line_and_leaves_nothing(
    content: bytes | None, tmp_path: Path, program: ProgramHere
) -> None:
    path = tmp_path / "flight.mcap"
    if content is not None:
        path.write_bytes(content)
    assert str(path) in program("companion", "logs", "repair", path).refusal
    assert [p.name for p in tmp_path.iterdir()] == ([] if content is None else ["flight.mcap"])
