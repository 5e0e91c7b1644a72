"""What people are told, and what only the log is told again."""

from companion.app.missions import REPEATED_S, Announcer
from companion.base.clock import Clock
from companion.base.messages import Notice
from companion.flightlog.record import FlightLog
from tests.virtual_time import in_virtual_time


class LogKept(FlightLog):
    """A log that keeps what it is given."""

    def __init__(self) -> None:
        super().__init__(None, 0.0)
        self.notices = list[Notice]()

    def write(self, topic: str, message: object, time_s: float) -> None:
        assert topic == "notice"
        assert isinstance(message, Notice)
        self.notices.append(message)


@in_virtual_time
async def test_what_holds_on_is_told_once_in_a_run_and_stands_in_each_flights_log() -> None:
    log, told = LogKept(), list[Notice]()
    announcer = Announcer(Clock(), log, told.append)
    for text in ("link loss", "link loss", "no home"):
        announcer.notify_once("setup", text, "warning")
    assert [notice.text for notice in log.notices] == ["link loss", "link loss", "no home"]
    for heard in (told, list(announcer.recent), announcer.take()):
        assert [notice.text for notice in heard] == ["link loss", "no home"]


@in_virtual_time
async def test_what_comes_many_times_a_second_is_told_now_and_then_and_a_sequence_as_it_is() -> None:
    log, told = LogKept(), list[Notice]()
    announcer = Announcer(Clock(), log, told.append)
    for number in range(21):
        time_s = number * REPEATED_S / 10.0
        announcer.publish(Notice(time_s, "imu", "samples lost", "warning"))
        announcer.publish(Notice(time_s, "phase", "search" if number % 2 else "approach", "info"))
    assert len(log.notices) == 42
    assert [n.time_s for n in told if n.kind == "imu"] == [0.0, REPEATED_S, 2.0 * REPEATED_S]
    assert sum(n.kind == "phase" for n in told) == 21


@in_virtual_time
async def test_a_climb_is_told_each_time_however_soon_it_follows_another() -> None:
    log, told = LogKept(), list[Notice]()
    announcer = Announcer(Clock(), log, told.append)
    for time_s in (1.0, 1.2):
        announcer.publish(Notice(time_s, "climb", "climbing 6.0 m to look for the pad", "warning"))
    assert [notice.time_s for notice in told] == [1.0, 1.2]
