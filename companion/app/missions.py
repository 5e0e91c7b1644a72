"""One mission after another: each has a planner of its own, and each order its answers.

An app that flies at once has one mission. One that stays begins in standby, follows an order, and goes back
to standby once the mission has ended and nothing that was asked of the autopilot is open.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from companion.app.announcer import Announcer
from companion.app.service.order_desk import OrderDesk
from companion.base.clock import Clock
from companion.base.messages import (
    Action,
    Order,
    OrderOutcome,
    OrderReply,
    Phase,
    PlanStep,
)
from companion.flightlog.flights_recorder import FlightsRecorder
from companion.flightlog.record import FlightLog
from companion.link.session import Session
from companion.plan.planner import PlanInputs, Planner

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
