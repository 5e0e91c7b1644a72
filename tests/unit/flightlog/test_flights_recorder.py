"""Many flights, a folder each, with the minute before; and what the meter says of the inputs."""

import json
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.base.message_json import encode
from companion.base.messages import Frame, Notice
from companion.config import CompanionConfig
from companion.flightlog import disk, flights_recorder
from companion.flightlog.flights import next_flight_folder, numbered_flights
from companion.flightlog.flights_recorder import KEPT_S, FlightsRecorder
from companion.flightlog.meter import WINDOW_S, Meter
from companion.flightlog.summary import summary_of


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


def until(holds: Callable[[], bool]) -> None:
    """Wait for what a thread does."""
    by_s = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < by_s
        time.sleep(0.01)


def test_a_clock_that_is_set_after_the_start_dates_the_next_flight(tmp_path: Path) -> None:
    # a Raspberry Pi without a network starts where it was switched off, and may step either way
    clock = iter((1000.0, 1000.0, 1.9e9, 1.8e9))
    log = FlightsRecorder(tmp_path, lambda: next(clock))
    for time_s in (10.0, 20.0, 30.0):
        tell(log, time_s)
        log.begin()
        until(lambda: log.flight_folder is not None)
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
    until(lambda: log.flight_folder == tmp_path / "flight-0001")
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
    until(lambda: log.flight_folder is not None)
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
    until(lambda: log.flight_folder is not None and written[0] == 1000)
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
    until(lambda: "cannot be written" in (log.problem or ""))
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
    until(lambda: log.flight_folder is not None)
    tell(log, 2.0)
    log.close()
    assert texts(tmp_path / "flight-0001") == ["at 0", "at 1", "at 2"]


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
    until(lambda: log.flight_folder is not None)
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
        until(lambda: "can't start new thread" in (log.problem or ""))
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
