"""The flight controller's loop: estimator, commander, navigator and the cascade, at the pace of the physics.

Attitude and rates at every call (400 Hz), the outer loop at the profile's rate. SI units.
"""

from __future__ import annotations

import math

from companion.base.geometry import (
    tilt_from_quat,
    yaw_from_quat,
)
from sitl.autopilot.control.cascade import STOPPED
from sitl.autopilot.control.estimator import TrueMotion
from sitl.autopilot.control.mixer import Motors
from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.flight_state import FlightState
from sitl.autopilot.flight.landing_target import VehicleEstimate
from sitl.autopilot.flight.mission import MissionInputs
from sitl.autopilot.flight.modes import Severity, StickMode, Task

_EARLY_S = 1e-6
_THRUST_OPTION = 8
_NO_ATTITUDE = AttitudeSetpoint(None, 0.0)


class FlightLoop(FlightState):
    """The state, stepped."""

    # ------------------------------------------------------------ time

    def step(self, truth: TrueMotion, dt_s: float, now_s: float) -> Motors:
        """One step of the physics: the four motor commands 0..1 (front, right, rear, left)."""
        self.estimate.update_attitude(truth)
        if now_s >= self._outer_due_s - _EARLY_S:
            self._outer(truth, now_s)
        armed = self._commander.armed
        motors = self._motors = self._cascade.step(self.estimate, dt_s) if armed else STOPPED
        return motors

    def _outer(self, truth: TrueMotion, now_s: float) -> None:
        if self.booted_s is None:
            self.booted_s = now_s
        # a late step is made up for by the next ones, a long gap is not
        self._outer_due_s = (
            max(self._outer_due_s, now_s - self.profile.outer_period_s) + self.profile.outer_period_s
        )
        self._now_s = now_s
        estimate = self.estimate
        self.battery.step(self._motors, self.profile.outer_period_s)
        estimate.step_to(now_s)
        estimate.update_position(truth, self.profile.outer_period_s)
        self._note_arming()  # by commands since the step before
        self._watch(now_s - self.booted_s, now_s - self._setpoint_s)
        self._note_arming()  # by a failsafe in this one
        if self._precision_landing is not None:
            self._precision_landing.watch(self._view(), self.profile.outer_period_s)
        if self._commander.armed:
            self._fly()
        elif not self._navigator.home_is_fixed:
            self._navigator.home_ned_m = estimate.position_ned_m

    def _note_arming(self) -> None:
        """Reset the cascade after every arming and disarming, however close together."""
        now = (self._commander.armed, self._commander.disarmings)
        if now == self._arming_seen:
            return
        stopped, self._arming_seen = now[1] != self._arming_seen[1], now
        self._cascade.disarm(self.estimate)
        if stopped:
            self._runner.rest()
            self._navigator.speeds.forget()

    def _watch(self, up_s: float, setpoint_age_s: float) -> None:
        """Update the commander's vehicle status."""
        now = self._commander.situation
        now.home_set = up_s >= self.profile.home_s
        if self.position_lost:
            now.aligned = False
        elif not now.aligned and up_s >= self.profile.alignment_s:
            now.aligned = True
            for text in self.profile.texts.aligned:
                self._commander.send_text(Severity.INFO, text)
        now.landed = self._cascade.landed
        now.has_flown = now.has_flown or self._cascade.airborne
        now.tilt_rad = tilt_from_quat(self.estimate.attitude)
        now.setpoint_age_s = setpoint_age_s
        parameters = self.profile.parameter_map
        now.setpoint_timeout_s = self.parameters.si(parameters.setpoint_timeout)
        if parameters.setpoints_lost_action is not None:
            now.setpoints_lost_action = round(self.parameters.si(parameters.setpoints_lost_action))
        now.fence_broken = self.fence_broken
        now.fence_action = round(self.parameters.si(parameters.fence_action))
        self._watch_mission()
        self._manual_control.watch(now, self.task, self._now_s)
        self._runner.started = self._runner.started or now.throttle_up
        self._commander.stays_armed = "auto_disarm" in self.refused
        self._commander.update(self.profile.outer_period_s)

    def _begin_task(self) -> None:
        """The task has changed since the last step."""
        self._last_task, self._precision_landing_active = self.task, False
        if self.task is Task.MISSION:
            self._runner.enter()

    def _fly(self) -> None:
        if self.task is not self._last_task:
            self._begin_task()
        setpoint = self.wanted = self._wanted()
        cascade, texts = self._cascade, self.profile.texts
        if cascade.landed:
            lifts = self.profile.takes_off_by_setpoint or self._commander.mode.by_attitude
            by_setpoint = self.task is Task.SETPOINT and lifts
            may_lift = (
                by_setpoint or self._manual_control.stick_mode or self._commander.flown is Task.TAKE_OFF
            )
            by_climb_rate = self._thrust_is_climb_rate()
            if not may_lift or not cascade.wants_up(setpoint, self.estimate, by_climb_rate):
                return
            cascade.lift_off()
            self._commander.send_text(Severity.INFO, texts.lifted)
        if (hover := self.profile.parameter_map.hover_thrust) is not None:
            believed = self.parameters.si(hover)
            learnt = cascade.learn_hover(believed, self.estimate, self.profile.outer_period_s)
            self.parameters.set(hover.name, learnt)  # what lies beyond its range is not learnt
        cascade.outer(
            setpoint,
            self.estimate,
            self._thrust_is_climb_rate(),
            self._still_speed(),
            self.profile.outer_period_s,
        )
        if cascade.landed:
            self._navigator.let_go()
            self._commander.send_text(Severity.INFO, texts.landed)

    def _wanted(self) -> MotionSetpoint | AttitudeSetpoint:
        """The setpoint of the present task; after a task is done, the next one starts."""
        heading = yaw_from_quat(self.estimate.attitude)
        if self.task is Task.SETPOINT and self._setpoint is not None:
            self._navigator.let_go()  # the next hold starts at a new position
            now = self._commander.situation
            return self.profile.as_aged(self._setpoint, now.setpoint_age_s, now.setpoint_timeout_s, heading)
        if self.task is Task.HOLD and self._commander.mode.by_attitude:
            self._navigator.let_go()
            return self.profile.as_aged(_NO_ATTITUDE, math.inf, 0.0, heading)
        by_sticks = self._manual_control.setpoint(
            self._commander.mode, heading, self._now_s, self.profile.outer_period_s
        )
        if by_sticks is not None:
            self._navigator.let_go()
            return by_sticks
        task = self.task
        if task is Task.MISSION:
            here = MissionInputs(
                self.estimate.position_ned_m, heading, self._cascade.landed, self.profile.outer_period_s
            )
            wanted = self._runner.step(here)
            self._commander.subtask = wanted if isinstance(wanted, Task) else None
            if isinstance(wanted, MotionSetpoint):
                self._navigator.let_go()
                return wanted
            task = wanted
        return self._by_task(task)

    def _by_task(self, task: Task) -> MotionSetpoint:
        """The setpoint of a task; after a task is done, the next one starts."""
        landing = self._precision_landing_setpoint(task)
        if landing is not None:
            self._navigator.let_go()
            return landing
        task = Task.LAND if task is Task.PRECISION_LAND else task
        estimate = self.estimate
        setpoint, following = self._navigator.step(task, estimate.position_ned_m, estimate.velocity_ned_m_s)
        if following is None:
            return setpoint
        if self.task is Task.MISSION:
            self._runner.task_done(following)
            return setpoint
        if task is Task.TAKE_OFF:
            self.set_mode_named(self.profile.after_take_off_mode)
        self._commander.begin(following)
        return setpoint

    def _precision_landing_setpoint(self, task: Task) -> MotionSetpoint | None:
        """The setpoint of the autopilot's precision landing, or None."""
        precision_landing = self._precision_landing
        if precision_landing is None or task not in self.profile.precision_landing_tasks:
            self._precision_landing_active = False
            return None
        if not self._precision_landing_active:
            self._precision_landing_active = True
            precision_landing.begin(required=self.task is not Task.MISSION or self._runner.precision_required)
        return precision_landing.fly(self._view(), self.profile.outer_period_s)

    def _view(self) -> VehicleEstimate:
        estimate = self.estimate
        position = estimate.position_ned_m
        return VehicleEstimate(
            self._now_s,
            position,
            estimate.velocity_ned_m_s,
            estimate.attitude,
            self._navigator.home_ned_m[2] - position[2],
            self._navigator.landing_speed(position),
        )

    def _thrust_is_climb_rate(self) -> bool:
        if self._manual_control.stick_mode is not None:
            return self._manual_control.stick_mode is StickMode.ANGLE_AND_CLIMB
        options = self.profile.parameter_map.guided_options
        if options is None:
            return self.profile.thrust_is_climb_rate
        return not int(self.parameters.si(options)) & _THRUST_OPTION

    def _still_speed(self) -> float:
        setting = self.profile.parameter_map.still_speed
        return self.profile.still_speed_m_s if setting is None else self.parameters.si(setting)
