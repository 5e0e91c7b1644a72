"""What people are told, and what only the log is told again."""

from companion.app.announcer import Announcer
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import Notice
from companion.flightlog.record import FlightLog


class Kept(FlightLog):
    """A log that keeps what it is given."""

    def __init__(self) -> None:
        super().__init__(None, 0.0)
        self.notices = list[Notice]()

    def write(self, topic: str, message: object, time_s: float) -> None:
        assert topic == "notice"
        assert isinstance(message, Notice)
        self.notices.append(message)


def test_what_holds_on_is_told_once_in_a_run_and_stands_in_each_flights_log() -> None:
    log, told = Kept(), list[Notice]()

    async def two_flights() -> Announcer:
        announcer = Announcer(Clock(), log, told.append)
        for text in ("link loss", "link loss", "no home"):
            announcer.notify_once("setup", text, "warning")
        return announcer

    announcer = run_in_virtual_time(two_flights())
    assert [notice.text for notice in log.notices] == ["link loss", "link loss", "no home"]
    for heard in (told, list(announcer.recent), announcer.take()):
        assert [notice.text for notice in heard] == ["link loss", "no home"]
