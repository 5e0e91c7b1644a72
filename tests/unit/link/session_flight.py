"""A session and a fake autopilot, in virtual time."""

from companion.config import LinkConfig, SenseConfig
from companion.link.codec import Codec, Message
from companion.link.session import Session
from tests.unit.link.fake_autopilot import FakeAutopilot

DELAY_S = 0.004


class SessionFlight:
    """A session and an autopilot with a line of constant delay between them, in steps of 2 ms."""

    def __init__(
        self,
        config: LinkConfig | None = None,
        autopilot: FakeAutopilot | None = None,
        sense: SenseConfig | None = None,
    ) -> None:
        self.session = Session(config or LinkConfig(), sense)
        self.autopilot = autopilot or FakeAutopilot()
        self.now_s = 100.0
        self.heard = Codec(9)
        self.sent: list[tuple[float, Message]] = []
        self.cut = self.unheard = False
        self.delay_s = DELAY_S
        self._to_autopilot: list[tuple[float, bytes]] = []
        self._to_session: list[tuple[float, bytes]] = []

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / 0.002)):
            self.now_s += 0.002
            while self._to_session and self._to_session[0][0] <= self.now_s:
                self.session.receive(self._to_session.pop(0)[1], self.now_s)
            self.send(self.session.tick(self.now_s))
            while self._to_autopilot and self._to_autopilot[0][0] <= self.now_s:
                self._answer(self.autopilot.receive(self._to_autopilot.pop(0)[1], self.now_s))
            self._answer(self.autopilot.tick(self.now_s))

    def is_connected(self) -> bool:
        return self.session.state.connected

    def send(self, data: bytes) -> None:
        self.sent += [(self.now_s, message) for message in self.heard.decode(data)]
        if data and not self.cut and not self.unheard:
            self._to_autopilot.append((self.now_s + self.delay_s, data))

    def _answer(self, data: bytes) -> None:
        if data and not self.cut:
            self._to_session.append((self.now_s + self.delay_s, data))

    def sent_of(self, kind: str) -> list[tuple[float, Message]]:
        return [(time_s, m) for time_s, m in self.sent if m.get_type() == kind]
