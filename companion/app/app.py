"""The application: one task a stage, at their own rates. Nothing here decides how to fly.

    frames ─► vision ─┐
    mpu9250 ──────────┼─► estimator ─► planner ─► controller ─► link ─► autopilot
    neo6m, ultrasonic ┘                                          ▲ telemetry, beacon
    (or, for those three, the autopilot's own by its telemetry)

Samples go into the estimator when they arrive. Each control cycle reads the newest estimates; nothing queues.
Only the control task sends setpoints: when it stops, they stop, and the autopilot's failsafe acts.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Final

from companion.app.action_queue import ActionQueue
from companion.app.calibration_warnings import forced_calibrations
from companion.app.hardware import ActionsFactory, Hardware
from companion.app.loop_monitor import LoopMonitor
from companion.app.stages import build_stages
from companion.app.status import STATUS_PERIOD_S, FrameRate, Status
from companion.app.supervision import supervised
from companion.app.systemd import ServiceNotifier
from companion.base.clock import Clock
from companion.base.collecting import collecting_little
from companion.base.messages import (
    Action,
    ActionKind,
    ActionResult,
    AutopilotSetup,
    ControlReport,
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
from companion.link.codec import Severity
from companion.plan.planner import PlanInputs

LINK_TICK_S: Final = 0.05
# how long the app goes on recording after the flight has ended, so that the log holds the standstill
LINGER_S: Final = 1.0
# the last requests (hold, land, disarm) are repeated after it for this long
LAST_REQUESTS_S: Final = 12.0
LAST_HOLD_S: Final = 2.0
END_PHASES: Final = (Phase.LANDED, Phase.ABORT)
NO_MORE_ACTIONS: Final = (*END_PHASES, Phase.HOLD)  # entering one of these clears the action queue
ON_THE_GROUND: Final = (
    Phase.STANDBY,
    Phase.CONNECT,
    Phase.ARM,
)  # there an error in the settings ends the app


class App:
    """One flight, from connecting to disarmed, or to control returned. Make it inside the running loop."""

    def __init__(
        self,
        config: CompanionConfig,
        hardware: Hardware,
        log: FlightLog,
        make_actions: ActionsFactory,
        on_status: Callable[[Status], None] | None = None,
        *,
        standby: str | None = None,
    ) -> None:
        """Make the stages; with a reason for `standby` it watches, and asks for no flight.

        Raises:
            ConfigError: a settings file named in the configuration is missing or wrong.
        """
        self._config, self._hardware, self._log, self._on_status = config, hardware, log, on_status
        self._clock = Clock()
        stages = build_stages(config, hardware, log, self._clock, self._notice, standby)
        self._vehicle, self.session, self._planner = stages.vehicle, stages.session, stages.planner
        self._estimator, self._sensing = stages.estimator, stages.sensing
        self.loop_monitor = LoopMonitor(self.session, self._clock)
        self._controller: Controller | None = None  # made when it is known whose autopilot obeys
        self._actions = make_actions(self.session, self._send, self._clock, config)
        self._action_queue = ActionQueue(self._actions, self._take_result)
        self._action_results: list[ActionResult] = []
        self._service = ServiceNotifier()
        self._phase = self._planner.phase
        self._new_notices: list[Notice] = []
        self._latency_ms: float | None = None
        self._last_exposure_s: float | None = None
        self._stop_requested = self._on_pad = self._log_problem_told = False
        self._start_s = self._clock.now_s()

    @property
    def phase(self) -> Phase:
        """Where the mission is."""
        return self._phase

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
            with nullcontext() if self._clock.virtual else collecting_little():
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
            **self._sensing.tasks(),
            "autopilot link": self._receive_task,
            "heartbeat": self._link_task,
            "actions": self._action_queue.run,
            "status": self._status_task,
        }
        for warning in forced_calibrations(self._config):
            self._notice("calibration", warning, "warning")
        async with asyncio.TaskGroup() as group:
            workers = [
                group.create_task(supervised(name, work, self._notice, self._on_ground), name=name)
                for name, work in works.items()
            ]
            phase = await group.create_task(self._controlled(), name="control")
            for worker in workers:
                worker.cancel()
        return phase

    def _on_ground(self) -> bool:
        return self._phase in ON_THE_GROUND

    def _notice(self, kind: str, text: str, severity: Severity) -> None:
        self._publish(Notice(self._clock.now_s(), kind, text, severity))

    # ------------------------------------------------------------ plan and control

    async def _controlled(self) -> Phase:
        """The control task; when it fails, the autopilot is asked to hold before the failure is told."""
        try:
            return await self._control_task()
        except Exception:
            self.loop_monitor.end()
            if self.session.state.offboard:
                self._action_queue.clear()
                hold = self._actions.perform(Action(ActionKind.HOLD))
                with suppress(TimeoutError):
                    self._take_result(await asyncio.wait_for(hold, LAST_HOLD_S))
            raise

    async def _control_task(self) -> Phase:
        """Plan, control and send at a fixed rate until the mission has ended."""
        period_s = 1.0 / self._config.plan.rate_hz
        due_s = self._clock.now_s()
        ended_s: float | None = None
        while not self._finished(ended_s):
            late_s = self._clock.now_s() - due_s
            if late_s > period_s:
                await self._catch_up(late_s)
                due_s = self._clock.now_s()  # what was missed is not made up for
            self.loop_monitor.turn(late_s, period_s)
            await self._control_step(self._clock.now_s(), late_s)
            self._service.alive()
            if ended_s is None and self._phase in END_PHASES:
                ended_s = self._clock.now_s()
            due_s += period_s
            await self._clock.sleep_until(due_s)
        return self._phase

    async def _catch_up(self, late_s: float) -> None:
        """Whoever was held up believes nothing from before, and does not go on with what was under way."""
        if self.loop_monitor.silent:
            self._action_queue.clear()
        if await self.loop_monitor.catch_up(late_s, self._service.alive):
            self._notice("stalled", f"stood still for {late_s:.1f} s: read the autopilot anew", "warning")

    def _finished(self, ended_s: float | None) -> bool:
        """Whether the flight is over and nothing asked of the autopilot is open, or has been for too long."""
        if ended_s is None:
            return False
        since_s = self._clock.now_s() - ended_s
        open_requests = self._action_queue.busy or self._planner.waiting
        return since_s >= (LAST_REQUESTS_S if open_requests else LINGER_S)

    async def _control_step(self, now_s: float, late_s: float) -> None:
        """One cycle: newest estimates to a setpoint."""
        self._sensing.take_attitude(self.session.state)
        for kind, words in self._estimator.take_notices():
            self._notice(kind, words, "warning")
        if self.session.setup is not None:
            self._control()  # takes a while to make, which is to pass on the ground
        vehicle, pad = self._estimator.vehicle(now_s), self._estimator.pad(now_s)
        plan = self._plan(vehicle, pad, now_s)
        if vehicle is None:
            return
        self._log.write("vehicle", vehicle, now_s)
        if pad is not None:
            self._log.write("pad", pad, now_s)
        if plan.reference is None:
            return
        self.session.align(vehicle.attitude, vehicle.time_s)
        controlled = self._control().step(plan, vehicle, pad, now_s, obeyed=self.session.state.offboard)
        await self._clock.spend(self._config.compute.control_s)
        if controlled is not None:
            setpoint, report = controlled
            self._send_setpoint(setpoint, replace(report, cycle_late_s=late_s))

    def _control(self) -> Controller:
        if self._controller is None:
            autopilot_kind = self.session.state.autopilot_kind or "px4"
            setup = self.session.setup or AutopilotSetup()
            self._controller = Controller(
                self._config.control,
                self._vehicle,
                self._clock.now_s,
                autopilot_kind=autopilot_kind,
                setup=setup,
            )
            flown = resolved(self._config.control, autopilot_kind)
            for misfit in misfits(flown, self._vehicle, setup, autopilot_kind):
                self._notice("setup", misfit, "warning")
        return self._controller

    def _plan(self, vehicle: VehicleState | None, pad: PadState | None, now_s: float) -> PlanStep:
        results, self._action_results = tuple(self._action_results), []
        inputs = PlanInputs(
            vehicle=vehicle,
            pad=pad,
            autopilot=self.session.state,
            beacon=self.session.beacon,
            range=self._sensing.last_range,
            results=results,
            stop_requested=self._stop_requested,
        )
        plan = self._planner.step(inputs, now_s)
        # a disarming that was asked for on the pad is none for a vehicle that has left it
        left_pad, self._on_pad = self._on_pad and not plan.on_ground, plan.on_ground
        if left_pad or (plan.phase in NO_MORE_ACTIONS and plan.phase is not self._phase):
            self._action_queue.clear()
        self._phase = plan.phase
        self._log.write("plan", plan, now_s)
        for notice in plan.notices:
            self._publish(notice)
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
            self._sensing.take_samples(self.session.take_samples())
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

    def _publish(self, notice: Notice) -> None:
        """Tell the log, the terminal and the ground station."""
        self._log.write("notice", notice, notice.time_s)
        self._new_notices.append(notice)
        self._service.status(f"{self._phase}: {notice.text}")
        self._send(self.session.send_notice(notice.text, notice.severity))

    def _watch_log(self) -> None:
        """Tell once that the log on disk has a gap or has ended; the flight goes on."""
        problem = self._log.problem
        if problem is not None and not self._log_problem_told:
            self._log_problem_told = True
            self._notice("record", problem, "warning")

    async def _status_task(self) -> None:
        """Hand the newest state to the terminal a few times a second."""
        self._service.ready()
        frame_rate = FrameRate()
        while True:
            await asyncio.sleep(STATUS_PERIOD_S)
            self._watch_log()
            frame_rate_hz = frame_rate.add(self._sensing.frame_count)
            notices, self._new_notices = self._new_notices, []
            if self._on_status is None:
                continue
            now_s = self._clock.now_s()
            status = Status(
                time_s=now_s - self._start_s,
                phase=self._phase,
                mode=self.session.state.mode,
                vehicle=self._estimator.vehicle(now_s),
                pad=self._estimator.pad(now_s),
                last_frame=self._sensing.last_frame,
                frame_rate_hz=frame_rate_hz,
                latency_ms=self._latency_ms,
                notices=tuple(replace(n, time_s=n.time_s - self._start_s) for n in notices),
                camera_problem=self._sensing.camera_problem,
            )
            self._on_status(status)
