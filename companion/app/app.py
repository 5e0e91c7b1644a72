"""The application: a task a device, one for the link, and one that plans, controls and sends.

    frames ─► vision ─┐
    mpu9250 ──────────┼─► estimator ─► planner ─► controller ─► link ─► autopilot
    neo6m, ultrasonic ┘                                          ▲ telemetry, beacon
    (or, for those three, the autopilot's own by its telemetry)

Samples go into the estimator when they arrive. Each control cycle reads the newest estimates; nothing queues.
Only the control task sends setpoints: when it stops, they stop, and the autopilot's failsafe acts.
A mission is one planner's; an app that stays goes back to standby after it, with a new one.
"""

import asyncio
import math
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from typing import Final

from companion.app.hardware import ActionsFactory, Hardware
from companion.app.missions import Announcer, Missions
from companion.app.pacing import LoopMonitor
from companion.app.sensing import Notify, forced_calibrations
from companion.app.service.systemd import ServiceNotifier
from companion.app.stages import STANDBY_WORDS, Stages
from companion.base.autopilots import PROFILES
from companion.base.clock import Clock, handing_over_soon, infrequent_collection
from companion.base.messages import (
    IMU_PREDICTED_S,
    Action,
    ActionKind,
    ActionResult,
    AutopilotSetup,
    CarriedPad,
    ControlReport,
    FrameReport,
    Notice,
    PadState,
    Phase,
    PlanStep,
    Setpoint,
    VehicleState,
)
from companion.config import CompanionConfig, ConfigError
from companion.control.controller import Controller
from companion.control.response.fitting import misfits
from companion.control.setpoints import resolved
from companion.flightlog.record import FlightLog
from companion.link.actions.actions import PymavlinkActions
from companion.link.autopilot_setup import loss_warnings
from companion.link.streams import THRUST_RATES_HZ
from companion.plan.planner import PlanInputs

# ---------------------------------------------------------------- tasks that fail

# long enough that a task which fails at once costs nothing, short beside what a flight survives without it
RESTART_PAUSE_S: Final = 1.0
# what has failed is back once it has run for this long
BACK_AFTER_S: Final = 2.0


async def supervised(
    name: str, work: Callable[[], Awaitable[None]], notify: Notify, on_ground: Callable[[], bool]
) -> None:
    """Run a task; each time it fails, report that and start it again after `RESTART_PAUSE_S`.

    Meanwhile the planner knows what a flight without that device may still do. An internal fault is treated
    alike: better no GPS than no control. The same failure in a row is reported once, and so is its end.

    Raises:
        ConfigError: something the user can correct, while the vehicle is still on the ground.
    """
    failures, reported = 0, ""

    def say_back() -> None:
        nonlocal reported
        reported = ""
        notify("device_back", f"{name} is back", "info")

    while True:
        back = asyncio.get_running_loop().call_later(BACK_AFTER_S, say_back) if reported else None
        try:
            return await work()
        except ConfigError as error:
            if on_ground():
                raise
            text = str(error)
        except Exception as error:
            text = failure_words(error)
        finally:
            if back is not None:
                back.cancel()
        failures += 1
        if text != reported:
            again = "" if failures == 1 else f" (failure {failures})"
            notify("device_lost", f"{name} lost: {text}{again}", "error")
            reported = text
        await asyncio.sleep(RESTART_PAUSE_S)


def failure_words(error: Exception) -> str:
    """What a person reads of it; the operating system's errors without their number."""
    if not isinstance(error, OSError):
        return f"{type(error).__name__}: {error}"
    reason = error.strerror or str(error)
    return reason if error.filename is None else f"{error.filename}: {reason}"


# ---------------------------------------------------------------- what the terminal shows

STATUS_PERIOD_S: Final = 0.25
FRAME_RATE_WINDOW_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Status:
    """What the terminal shows; times count from the app's start."""

    time_s: float
    phase: Phase
    mode: str
    vehicle: VehicleState | None
    pad: PadState | None
    last_frame: FrameReport | None
    frame_rate_hz: float
    latency_ms: float | None
    notices: tuple[Notice, ...]
    camera_problem: str | None = None


class FrameRate:
    """Frames per second over the last `FRAME_RATE_WINDOW_S`, from a count that is read every period."""

    def __init__(self) -> None:
        self._counts = deque([0], maxlen=round(FRAME_RATE_WINDOW_S / STATUS_PERIOD_S) + 1)

    def add(self, count: int) -> float:
        """Take the count of all frames so far; returns the rate (Hz)."""
        self._counts.append(count)
        return (self._counts[-1] - self._counts[0]) / (STATUS_PERIOD_S * (len(self._counts) - 1))


# ---------------------------------------------------------------- the queue of the mission's actions
# Most are performed one after another. Hold, land and disarm overtake everything: the action under way is
# cancelled and what waits is dropped, so that no late command undoes them. A request to the ground station
# for the pad's position does not wait in the queue.

URGENT: Final = frozenset({ActionKind.HOLD, ActionKind.LAND, ActionKind.DISARM})


class ActionQueue:
    """The actions waiting and under way; `on_result` receives each result once."""

    def __init__(self, actions: PymavlinkActions, on_result: Callable[[ActionResult], None]) -> None:
        self._actions, self._on_result = actions, on_result
        self._waiting: deque[tuple[Action, str]] = deque()  # and the mode in which it was asked for
        self._arrived = asyncio.Event()
        self._beside: set[asyncio.Task[None]] = set()
        self._under_way: ActionKind | None = None

    @property
    def busy(self) -> bool:
        return self._under_way is not None or bool(self._waiting)

    def add(self, action: Action) -> None:
        """Append an action; an urgent one goes before all others."""
        if action.kind is ActionKind.REQUEST_PAD_POSITION:
            task = asyncio.create_task(self._perform(action, self._actions.mode))
            self._beside.add(task)
            task.add_done_callback(self._beside.discard)
            return
        if action.kind in URGENT:
            self._waiting = deque(waiting for waiting in self._waiting if waiting[0].kind in URGENT)
            if self._under_way not in URGENT:
                self._actions.cancel()
        self._waiting.append((action, self._actions.mode))
        self._arrived.set()

    def clear(self) -> None:
        self._waiting.clear()
        self._actions.cancel()

    async def run(self) -> None:
        try:
            while True:
                while self._waiting:
                    action, asked_in = self._waiting.popleft()
                    self._under_way = action.kind
                    try:
                        await self._perform(action, asked_in)
                    finally:
                        self._under_way = None
                self._arrived.clear()
                await self._arrived.wait()
        finally:
            for task in self._beside:
                task.cancel()

    async def _perform(self, action: Action, asked_in: str) -> None:
        self._on_result(await self._actions.perform(action, asked_in))


LINK_TICK_S: Final = 0.05
LAST_HOLD_S: Final = 2.0
# before the first setpoint leaves, the autopilot's heading is known
ASKS_FOR_CONTROL: Final = (Phase.ROUTE, Phase.SEARCH)
# there an error in the settings ends the app
ON_THE_GROUND: Final = (Phase.STANDBY, Phase.CONNECT, Phase.ARM)


class App:
    """One flight, or a companion that stands by for orders. Make it inside the running loop."""

    def __init__(
        self,
        config: CompanionConfig,
        hardware: Hardware,
        log: FlightLog,
        make_actions: ActionsFactory,
        on_status: Callable[[Status], None] | None = None,
        *,
        standby: str | None = None,
        stays: bool = False,
    ) -> None:
        """Make the stages; with a reason for `standby` it watches, and follows no order.

        Else it flies at once, unless it `stays`: then it stands by, before its first order and after each.
        """
        self._config, self._hardware, self._log, self._on_status = config, hardware, log, on_status
        self._clock = Clock()
        self.announcer = Announcer(self._clock, log, self._deliver)
        stages = Stages(config, hardware, log, self._clock, self.announcer.notify)
        self._vehicle, self.session, self._timer = stages.vehicle, stages.session, stages.control_timer
        self.estimator, self.sensing, self.sources = stages.estimator, stages.sensing, stages.sources
        self._stamps, self._watch, self._target = stages.stamps, stages.estimate_watch, stages.target
        self._setup_watch = stages.setup_watch
        if self._target is not None:
            standby = STANDBY_WORDS
        self.sensing.on_ground = self._on_ground
        self.missions = Missions(
            stages.make_planner, self.session, log, self.announcer, self._clock, standby=standby, stays=stays
        )
        self.loop_monitor = LoopMonitor(self.session, self._clock, self.sensing.pace)
        self._control_failure = ""
        self._controller: Controller | None = None  # made when it is known whose autopilot obeys
        self._actions = make_actions(self.session, self._send, self._clock, config)
        self._action_queue = ActionQueue(self._actions, self._take_result)
        self._action_results: list[ActionResult] = []
        self._service = ServiceNotifier()
        self._latency_ms: float | None = None
        self._short_of: dict[str, str] = {}  # what this mission's wind took all of, and the words told
        self._last_exposure_s: float | None = None
        self._stop_requested = False
        self._start_s = self._clock.now_s()

    @property
    def phase(self) -> Phase:
        return self.missions.phase

    @property
    def vision_only(self) -> bool:
        """Whether it flies nothing and sends landing targets (`control.output: landing_target`)."""
        return self._target is not None

    def not_ready(self, now_s: float) -> list[str]:
        """What stands against a landing; vision only: against sending a pad that is seen."""
        return self.missions.not_ready(now_s) if self._target is None else self._target.problems(now_s)

    def request_stop(self) -> None:
        """Hold, hand the vehicle back to the autopilot and end (Ctrl-C, or the service's stop)."""
        self._stop_requested = True

    async def run(self) -> Phase:
        """Fly; returns the phase in which the flight ended (LANDED or ABORT).

        Raises:
            ConfigError: something that a user can mend showed itself in flight.
            ExceptionGroup: a stage failed in a way it should not; setpoints have stopped by then.
        """
        await self._actions.start()
        try:
            # in virtual time nothing waits for a collection, and others share the process
            with handing_over_soon(), nullcontext() if self._clock.virtual else infrequent_collection():
                return await self._run_tasks()
        except ExceptionGroup as group:
            mendable, _ = group.split(ConfigError)
            raise (group if mendable is None else mendable.exceptions[0]) from None
        finally:
            self._service.stopping()
            await self._actions.close()

    async def _run_tasks(self) -> Phase:
        """Run every task until the control task ends; a failure of one ends them all."""
        works = {
            **self.sensing.tasks(),
            "autopilot link": self._receive_task,
            "heartbeat": self._link_task,
            "actions": self._action_queue.run,
            "status": self._status_task,
            "signing stamps": self._stamps.run,
            "estimate": self._watch.run,
        }
        self.missions.tell()
        for warning in forced_calibrations(self._config):
            self.announcer.notify("calibration", warning, "warning")
        async with asyncio.TaskGroup() as group:
            workers = [
                group.create_task(supervised(name, work, self.announcer.notify, self._on_ground), name=name)
                for name, work in works.items()
            ]
            phase = await group.create_task(self._controlled(), name="control")
            for worker in workers:
                worker.cancel()
        return phase

    def _on_ground(self) -> bool:
        return self.phase in ON_THE_GROUND and not self.session.state.armed

    # ------------------------------------------------------------ plan and control

    async def _controlled(self) -> Phase:
        """The control task; when it fails, that is told, and control returned, before the app ends."""
        try:
            return await self._control_task()
        except Exception as error:
            self.loop_monitor.end()
            word = self.missions.control_failed(failure_words(error))
            if word is not None:
                self._action_queue.clear()
                hold = self._actions.perform(word)
                with suppress(TimeoutError):
                    self._take_result(await asyncio.wait_for(hold, LAST_HOLD_S))
            raise

    async def _control_task(self) -> Phase:
        """Plan, control and send in every cycle until the mission has ended."""
        timer = self._timer
        timer.restart()
        while not self._over():
            late_s = timer.late_s + self.loop_monitor.slept_s()
            if late_s > timer.period_s:
                await self._catch_up(late_s)
                timer.restart()
            self.loop_monitor.turn(late_s, timer.period_s)
            await self._control_step(self._clock.now_s(), late_s)
            self._service.alive()
            await timer.next_cycle()
        return self.phase

    async def _catch_up(self, late_s: float) -> None:
        """Whoever was held up believes nothing from before, and does not go on with what was under way."""
        if self.loop_monitor.silent:
            self._action_queue.clear()
        if await self.loop_monitor.catch_up(late_s, self._service.alive):
            self.announcer.notify(
                "stalled", f"app stalled for {late_s:.1f} s: autopilot state read again", "warning"
            )

    def _over(self) -> bool:
        """Whether the app ends. One that stays goes back to standby when a mission has ended."""
        if not self.missions.finished(busy=self._action_queue.busy):
            return False
        if self._stop_requested or not self.missions.stays:
            return True
        self.missions.stand_by()
        self.sources.begin()
        self._controller = self._latency_ms = None
        self._short_of.clear()
        self._action_queue.clear()
        self._action_results.clear()
        self._control_failure = ""
        return False

    async def _control_step(self, now_s: float, late_s: float) -> None:
        """One cycle: newest estimates to a setpoint."""
        self.session.correct_clock(self.estimator.link_delay_s)
        self.sensing.take_motion(self.session.state)
        for kind, words in self.estimator.take_notices():
            self.announcer.notify(kind, words, "warning")
        vehicle, pad = self.estimator.vehicle(now_s), self.estimator.pad(now_s)
        if self.loop_monitor.woke:  # they are from long ago, though the clock, which stood still, says fresh
            self.estimator.start_over()
            vehicle = pad = None
        if self.session.setup is not None:  # it takes a while to make, which is to pass on the ground
            self._control().thrust.feel(vehicle, self.session.state, self.session.setup, now_s)
        carried = self.estimator.carried_pad(now_s)
        plan = self._plan(vehicle, pad, carried, now_s)
        for topic, estimate in (("vehicle", vehicle), ("pad", pad), ("carried_pad", carried)):
            if estimate is not None:
                self._log.write(topic, estimate, now_s)
        if self._target is not None:
            self.missions.record(armed=self.session.state.armed)
            target = self._target.due(vehicle, pad, self.sensing.last_sighting, now_s)
            if target is not None:
                self._send(self.session.send_landing_target(target))
                self._log.write("landing_target", target, now_s)
                self._latency_ms = 1e3 * (now_s - target.time_s)
            return
        aims = plan.reference is not None or plan.phase in ASKS_FOR_CONTROL
        if aims and vehicle is not None and vehicle.imu_age_s <= IMU_PREDICTED_S:
            self.session.align(vehicle.attitude, vehicle.time_s)
        if plan.reference is None or self.session.setup is None:
            return
        obeyed, link = self.session.state.offboard, self.session.health(now_s)
        controlled = self._control().step(plan, vehicle, pad, now_s, obeyed=obeyed, link=link)
        self._control_failure = "" if controlled is None else controlled[1].failure
        await self._clock.spend(self._config.compute.control_s)
        if controlled is not None:
            self._send_setpoint(controlled[0], replace(controlled[1], cycle_late_s=late_s))

    def _control(self) -> Controller:
        control, kind = self._config.control, self.session.state.autopilot_kind or "px4"
        setup, new = self.session.setup or AutopilotSetup(), self._controller is None
        if self._controller is None:
            self._controller = Controller(control, self._vehicle, self._clock.now_s, kind, setup, True)
            if self._controller.thrust.measures:
                self.session.rates.want(THRUST_RATES_HZ)
        if self._controller.fit(setup) or new:
            resolves, ours = resolved(control, kind), self.session.system_id
            own, by_attitude = misfits(resolves, self._vehicle, setup), resolves.setpoint == "attitude"
            lost = loss_warnings(setup, kind, by_attitude=by_attitude, system_id=ours)
            unflown = PROFILES[kind].unflown(self.session.state.version)
            for warning in (*own, *lost, *([unflown] if unflown else [])):
                self.announcer.notify_once("setup", warning, "warning")
        return self._controller

    def _plan(
        self, vehicle: VehicleState | None, pad: PadState | None, carried: CarriedPad | None, now_s: float
    ) -> PlanStep:
        results, self._action_results = tuple(self._action_results), []
        inputs = PlanInputs(
            vehicle=vehicle,
            pad=pad,
            autopilot=self.session.state,
            carried=carried,
            beacon=self.session.beacons.beacon,
            range=self.sensing.last_range,
            results=results,
            stop_requested=self._stop_requested,
            camera_problem=self.sensing.camera_problem,
            comparisons=self.sources.look(now_s),
            computer=self.loop_monitor.load,
            setup_problem=self._setup_watch.problem(now_s),
            control_failure=self._control_failure,
            shortage="; ".join(self._short_of.values()),
            thrust_doubt="" if self._controller is None else self._controller.thrust.doubt,
            link=self.session.health(now_s),
        )
        plan = self.missions.step(inputs, now_s)
        if self.missions.withdraws:
            self._action_queue.clear()
        self._log.write("plan", plan, now_s)
        for notice in plan.notices:
            self.announcer.publish(notice)
        for action in plan.actions:
            self._log.write("action", action, now_s)
            self._action_queue.add(action)
        return plan

    def _send_setpoint(self, setpoint: Setpoint, report: ControlReport) -> None:
        now_s = self._clock.now_s()
        sent = replace(setpoint, time_s=now_s)
        self._send(self.session.send_setpoint(sent, now_s))
        self._log.write("setpoint", sent, now_s)
        self._log.write("control_report", report, now_s)
        if report.short_of and report.short_of not in self._short_of:
            self._short_of[report.short_of] = words = _shortage(report)
            self.announcer.notify("control", words, "warning")
        # later setpoints that still live on the same sighting say nothing about the latency
        if sent.exposure_time_s is not None and sent.exposure_time_s != self._last_exposure_s:
            self._latency_ms = 1e3 * (now_s - sent.exposure_time_s)
            self._last_exposure_s = sent.exposure_time_s

    # ------------------------------------------------------------ link

    async def _receive_task(self) -> None:
        """Take what the autopilot and the ground station say."""
        while True:
            data = await self._hardware.transport.read()
            now_s = self._clock.now_s()
            self.loop_monitor.heard += 1
            self._log.write_mavlink(data, now_s, "in")
            self.session.receive(data, now_s)
            self._stamps.note(ordered=self.session.orders.waiting)
            self.sensing.take_samples(self.session.take_samples())
            self.sensing.take_beacon(self.session.beacons.beacon)
            self._actions.receive(data)
            self._send(self.session.tick(now_s))

    async def _link_task(self) -> None:
        """Heartbeats, time synchronisation and requests for telemetry."""
        while True:
            self._send(self.session.tick(self._clock.now_s()))
            await asyncio.sleep(LINK_TICK_S)

    def _take_result(self, result: ActionResult) -> None:
        self._log.write("action_result", result, self._clock.now_s())
        self._action_results.append(result)

    def _send(self, data: bytes) -> None:
        if data and not self.loop_monitor.silent:
            self._hardware.transport.write(data)
            self._log.write_mavlink(data, self._clock.now_s(), "out")

    # ------------------------------------------------------------ telling people

    def _deliver(self, notice: Notice) -> None:
        """Tell the service manager and the ground station."""
        self._service.status(f"{self.phase}: {notice.text}")
        self._send(self.session.send_notice(notice.text, notice.severity))

    async def _status_task(self) -> None:
        """Hand the newest state to the terminal a few times a second."""
        self._service.ready()
        frame_rate = FrameRate()
        while True:
            await asyncio.sleep(STATUS_PERIOD_S)
            self.announcer.watch_log()
            frame_rate_hz = frame_rate.add(self.sensing.frame_count)
            notices = self.announcer.take()
            if self._on_status is None:
                continue
            now_s = self._clock.now_s()
            status = Status(
                time_s=now_s - self._start_s,
                phase=self.phase,
                mode=self.session.state.mode,
                vehicle=self.estimator.vehicle(now_s),
                pad=self.estimator.pad(now_s),
                last_frame=self.sensing.last_frame,
                frame_rate_hz=frame_rate_hz,
                latency_ms=self._latency_ms,
                notices=tuple(replace(n, time_s=n.time_s - self._start_s) for n in notices),
                camera_problem=self.sensing.camera_problem,
            )
            self._on_status(status)


def _shortage(report: ControlReport) -> str:
    """What there is too little of, and what the wind takes: little, where the vehicle does not follow."""
    pushes_m_s2 = math.hypot(*report.disturbance_ned_m_s2[:2])
    hover = "" if report.hover_thrust is None else f", hover thrust {report.hover_thrust:.2f}"
    return f"too little {report.short_of}: it drifts (wind {pushes_m_s2:.1f} m/s2{hover})"
