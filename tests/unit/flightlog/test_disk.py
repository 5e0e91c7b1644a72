"""A card that stalls or is full: `put` returns at once, what explains the flight is dropped last."""

import errno
import threading
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest

from companion.flightlog import disk
from companion.flightlog.disk import DiskWriter


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


def test_a_full_card_ends_the_log_and_nothing_else() -> None:
    def full(_item: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    written: list[object] = []
    writer = DiskWriter()
    writer.put(full, "a")
    writer.put(written.append, "b")
    writer.finish()
    assert written == []
    assert writer.problem == "the flight log on disk ends here: No space left on device"


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


def test_what_cannot_be_written_leaves_the_rest_of_the_log_whole() -> None:
    def no_number(_item: object) -> None:
        raise ValueError("not a number")

    written: list[object] = []
    writer = DiskWriter()
    writer.put(no_number, "a")
    writer.put(written.append, "b")
    writer.finish()
    assert written == ["b"]
    assert writer.problem == ("1 messages could not be written to the log: ValueError: not a number")


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
