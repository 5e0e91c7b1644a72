"""One mission after another: each has a planner of its own, and each order its answers; notices to people.

An app that flies at once has one mission. One that stays begins in standby, follows an order, and goes back
to standby once the mission has ended and nothing that was asked of the autopilot is open.

    link (commands, switch, mode, mission) ─┐                 ┌─► planner, for one cycle
    local socket (`companion order`) ───────┴─► OrderDesk ────┤
                                            ◄── replies ──────┴── refused, followed, ended
"""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final

from companion.base.clock import Clock
from companion.base.messages import (
    Action,
    Notice,
    Order,
    OrderKind,
    OrderOutcome,
    OrderReply,
    Phase,
    PlanStep,
    Refusal,
)
from companion.flightlog.flights_recorder import FlightsRecorder
from companion.flightlog.record import FlightLog
from companion.link.codec import Severity
from companion.link.session import Session
from companion.plan.planner import PlanInputs, Planner

# ---------------------------------------------------------------- notices

KEPT_NOTICES: Final = 20
# the same fault again within it is for the log alone: many a second would crowd out everything else
REPEATED_S: Final = 2.0
# what the vehicle is about to do is no fault: it is told each time
_ACTIONS: Final = frozenset({"climb"})


class Announcer:
    """Takes notices; `deliver` sends each on to the ground station and the service manager."""

    def __init__(self, clock: Clock, log: FlightLog, deliver: Callable[[Notice], None]) -> None:
        self._clock, self._log, self._deliver = clock, log, deliver
        self._new: list[Notice] = []
        self._log_problem_reported = False
        self._notified_once: set[str] = set()
        self._told_s: dict[tuple[str, str, Severity], float] = {}
        self.recent: deque[Notice] = deque(maxlen=KEPT_NOTICES)

    def notify(self, kind: str, text: str, severity: Severity) -> None:
        self.publish(Notice(self._clock.now_s(), kind, text, severity))

    def notify_once(self, kind: str, text: str, severity: Severity) -> None:
        """Tell something that holds on; what was told before goes into the log alone: each flight has it."""
        if text not in self._notified_once:
            self._notified_once.add(text)
            self.notify(kind, text, severity)
        else:
            now_s = self._clock.now_s()
            self._log.write("notice", Notice(now_s, kind, text, severity), now_s)

    def publish(self, notice: Notice) -> None:
        """Tell the log, the terminal and the ground station; the log alone of a fault that was just told."""
        self._log.write("notice", notice, notice.time_s)
        fault = notice.severity != "info" and notice.kind not in _ACTIONS
        if fault and self._just_told(notice):
            return
        self._new.append(notice)
        self.recent.append(notice)
        self._deliver(notice)

    def _just_told(self, notice: Notice) -> bool:
        told, now_s = (notice.kind, notice.text, notice.severity), notice.time_s
        self._told_s = {key: time_s for key, time_s in self._told_s.items() if now_s - time_s < REPEATED_S}
        return self._told_s.setdefault(told, now_s) < now_s

    def take(self) -> list[Notice]:
        new, self._new = self._new, []
        return new

    def watch_log(self) -> None:
        """Tell once that the log on disk has a gap or has ended; the flight goes on."""
        problem = self._log.problem
        reported, self._log_problem_reported = self._log_problem_reported, problem is not None
        if problem is not None and not reported:
            self.notify("record", problem, "warning")


# ---------------------------------------------------------------- orders

ReplyCallback = Callable[[Order, OrderReply], None]
# of one kind, of one cycle and the last few: more is a fault of whoever sends them
MOST_WAITING: Final = 8
TOO_MANY: Final = "too many orders"


class OrderDesk:
    """Give orders with `take`; each cycle ask `next_order`, and tell what the planner made of it."""

    def __init__(self, on_reply: ReplyCallback) -> None:
        """`on_reply` receives every answer: a refusal or IN_PROGRESS, and later how it ended."""
        self._on_reply = on_reply
        self._waiting: deque[Order] = deque()
        self._followed: Order | None = None
        self._stops: list[Order] = []

    @property
    def followed(self) -> Order | None:
        return self._followed

    @property
    def stop_requested(self) -> bool:
        return bool(self._stops)

    def take(self, orders: Iterable[Order]) -> None:
        """Take orders in. Too many of a kind are refused; of another kind they keep no stop out."""
        for order in orders:
            if _count(self._waiting, order.kind) < MOST_WAITING:
                self._waiting.append(order)
            else:
                self._reply(order, OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY, order.time_s)

    def next_order(self, phase: Phase, now_s: float) -> Order | None:
        """The order for this cycle's planner, in standby; in a mission all but a stop are refused."""
        if not self._waiting:
            return None
        if phase is Phase.STANDBY:
            return self._waiting.popleft()
        while self._waiting:
            order = self._waiting.popleft()
            if order.kind is not OrderKind.STOP:
                busy = f"busy: {phase.value.replace('_', ' ')}"
                self._reply(order, OrderOutcome.TEMPORARILY_REJECTED, busy, now_s)
            elif len(self._stops) >= MOST_WAITING:
                self._reply(order, OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY, now_s)
            else:
                self._stops.append(order)
                self._reply(order, OrderOutcome.IN_PROGRESS, "", now_s)
        return None

    def decided(self, order: Order, refusal: Refusal | None, now_s: float) -> None:
        """What the planner made of this cycle's order."""
        if refusal is None:
            self._followed = order
            self._reply(order, OrderOutcome.IN_PROGRESS, "", now_s)
        else:
            outcome = OrderOutcome.DENIED if refusal.lasting else OrderOutcome.TEMPORARILY_REJECTED
            self._reply(order, outcome, refusal.text, now_s)

    def mission_ended(self, phase: Phase, words: str, now_s: float) -> None:
        """The mission has ended in LANDED or ABORT, for the reason in `words`."""
        if self._followed is not None:
            stopped = OrderOutcome.CANCELLED if self._stops else OrderOutcome.FAILED
            outcome = OrderOutcome.ACCEPTED if phase is Phase.LANDED else stopped
            self._reply(self._followed, outcome, words, now_s)
        for stop in self._stops:
            self._reply(stop, OrderOutcome.ACCEPTED, words, now_s)
        self._followed, self._stops = None, []

    def _reply(self, order: Order, outcome: OrderOutcome, text: str, now_s: float) -> None:
        self._on_reply(order, OrderReply(now_s, order.kind, order.source, outcome, text))


def _count(orders: Iterable[Order], kind: OrderKind) -> int:
    return sum(order.kind is kind for order in orders)


# how long the app goes on recording after the flight has ended, so that the log holds the standstill
LINGER_S: Final = 1.0
# the last requests (hold, land, disarm) are repeated after it for this long
LAST_REQUESTS_S: Final = 12.0
END_PHASES: Final = (Phase.LANDED, Phase.ABORT)
_REFUSALS: Final = frozenset({OrderOutcome.DENIED, OrderOutcome.TEMPORARILY_REJECTED})


class Missions:
    """The mission under way, and those that follow it."""

    def __init__(
        self,
        make_planner: Callable[[str | None], Planner],
        session: Session,
        log: FlightLog,
        announcer: Announcer,
        clock: Clock,
        *,
        standby: str | None,
        stays: bool,
    ) -> None:
        """With a reason for `standby` no order is followed; else the first mission begins now, or `stays`."""
        self._make_planner, self._session, self._log = make_planner, session, log
        self._announcer, self._clock = announcer, clock
        self._standby, self.stays = "" if stays and standby is None else standby, stays
        self._planner = make_planner(self._standby)
        self._desk = OrderDesk(self._replied)
        self._askers: dict[Order, Callable[[OrderReply], None]] = {}
        self._ended_s: float | None = None
        self._held_words = self._end_words = ""
        self._inputs: PlanInputs | None = None  # of the last cycle
        self.stopped_idle = self._recorded = False
        self.phase = self._planner.phase
        session.orders.stand_by(clock.now_s())

    @property
    def order(self) -> Order | None:
        return self._desk.followed

    @property
    def withdraws(self) -> bool:
        """Whether what was asked for before the last cycle, and waits to be sent, is withdrawn."""
        return self._planner.withdraws

    def control_failed(self, why: str) -> Action | None:
        """Say so, and what the autopilot is asked for; returns that."""
        word = self._planner.last_request(self._session.state)
        ordered = "nothing" if word is None else word.kind.value
        self._announcer.notify("control", f"control failed: {why}; {ordered} requested", "error")
        return word

    def not_ready(self, now_s: float) -> list[str]:
        """Why an order to land would be refused, beside that the vehicle stands on the ground."""
        return ["starting"] if self._inputs is None else self._planner.not_ready(self._inputs, now_s)

    def estimate_problem(self, now_s: float) -> str | None:
        """Why nothing would be flown by our estimate of the vehicle; None when it is good enough."""
        return "starting" if self._inputs is None else self._planner.estimate_problem(self._inputs, now_s)

    def give(self, order: Order, on_reply: Callable[[OrderReply], None]) -> None:
        """Give an order beside those of the link; `on_reply` receives its answers, the last one last."""
        self._askers[order] = on_reply
        self._desk.take([order])

    def step(self, inputs: PlanInputs, now_s: float) -> PlanStep:
        """One cycle of the planner, with the order that has come, if one has."""
        self._inputs = inputs
        self._desk.take(self._session.orders.take())
        order = self._desk.next_order(self.phase, now_s)
        stop = inputs.stop_requested or self._desk.stop_requested
        plan = self._planner.step(replace(inputs, order=order, stop_requested=stop), now_s)
        if order is not None:
            refused = self._planner.refused
            if refused is None and isinstance(self._log, FlightsRecorder):
                self._log.begin()
            self._desk.decided(order, refused, now_s)
        self._note_phase(plan, now_s)
        self.phase = plan.phase
        return plan

    def _note_phase(self, plan: PlanStep, now_s: float) -> None:
        """Keep the words for whoever ordered it: how it ended, and why it held before."""
        words = next((n.text for n in reversed(plan.notices) if n.kind == "phase"), "")
        if plan.phase is Phase.HOLD:
            self._held_words = words or self._held_words
        elif plan.phase not in END_PHASES:
            self._held_words = ""
        elif self._ended_s is None:
            self._ended_s, self.stopped_idle = now_s, self.phase is Phase.STANDBY
            self._end_words = "; ".join(filter(None, (self._held_words, words)))

    def finished(self, *, busy: bool) -> bool:
        """Whether the mission is over and nothing asked of the autopilot is open, or has been for too long.

        Whoever ordered it has the last answer then. `busy`: actions wait or are under way.
        """
        if self._ended_s is None:
            return False
        since_s = self._clock.now_s() - self._ended_s
        if since_s < (LAST_REQUESTS_S if busy or self._planner.waiting else LINGER_S):
            return False
        self._desk.mission_ended(self.phase, self._end_words, self._clock.now_s())
        return True

    def stand_by(self) -> None:
        """Begin anew: nothing of the last mission is left, but what the sensors and the link tell."""
        self._planner = self._make_planner(self._standby)
        self.phase, self._ended_s = self._planner.phase, None
        self._held_words = self._end_words = ""
        self._session.orders.stand_by(self._clock.now_s())
        self.tell()
        if isinstance(self._log, FlightsRecorder):
            self._log.end()

    def record(self, *, armed: bool) -> None:
        """Where no mission begins a record, the autopilot's own flight does: as long as it is armed."""
        if isinstance(self._log, FlightsRecorder) and armed is not self._recorded:
            self._recorded = armed
            (self._log.begin if armed else self._log.end)()

    def tell(self) -> None:
        """Say what it waits for."""
        if self.stays:
            self._announcer.notify("standby", f"standby: {self._standby or 'waiting for an order'}", "info")

    def _replied(self, order: Order, reply: OrderReply) -> None:
        """An order has its answer: tell whoever gave it, and everybody why it is refused."""
        self._log.write("order", reply, reply.time_s)
        if reply.outcome in _REFUSALS:
            text = f"order to {reply.kind} by {reply.source} refused: {reply.text}"
            self._announcer.notify("order", text, "warning")
        self._session.orders.reply(order, reply)
        last = reply.outcome is not OrderOutcome.IN_PROGRESS
        asker = self._askers.pop(order, None) if last else self._askers.get(order)
        if asker is not None:
            asker(reply)
