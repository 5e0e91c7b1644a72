"""The flight controller's loop: estimator, commander, navigator and the cascade, at the pace of the physics.

Attitude and rates at every call (400 Hz), everything outer at 100 Hz. Its NED frame, height and heading are
its own (see `estimator`). SI units.
"""

from __future__ import annotations

import math
from math import inf

import numpy as np

from companion.geometry import (
    Quaternion,
    Vector3,
    geodetic_from_ned,
    tilt_from_quat,
)
from companion.messages import LandedState
from companion.messages import Manner as MannerName
from sitl.autopilot.airframe import Airframe
from sitl.autopilot.ardupilot import ARDUPILOT
from sitl.autopilot.cascade import STOPPED, Cascade
from sitl.autopilot.commander import Commander, Text
from sitl.autopilot.estimator import Estimator, EstimatorErrors, TrueMotion
from sitl.autopilot.manners import Manner
from sitl.autopilot.mixer import Motors
from sitl.autopilot.modes import Result, Severity, Task
from sitl.autopilot.navigator import Navigator
from sitl.autopilot.px4 import PX4
from sitl.autopilot.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.parameters import Parameters

MANNERS: dict[MannerName, Manner] = {"px4": PX4, "ardupilot": ARDUPILOT}

_OUTER_PERIOD_S = 0.01
_EARLY_S = 1e-6
_THRUST_OPTION = 8


class FlightLoop:
    """One autopilot on one airframe.

    `home` is latitude (deg), longitude (deg), altitude (m) of the origin of the SITL's NED.
    """

    def __init__(
        self,
        manner: MannerName,
        airframe: Airframe,
        rng: np.random.Generator,
        home: Vector3,
        errors: EstimatorErrors | None = None,
    ) -> None:
        self.manner = MANNERS[manner]
        self.parameters = Parameters(self.manner.parameters)
        self.estimate = Estimator(errors or EstimatorErrors(), rng)
        self.booted_s: float | None = None
        self._commander = Commander(self.manner)
        self._navigator = Navigator(self.manner, self.parameters)
        self._cascade = Cascade(self.manner, airframe)
        self._origin = home
        self._outer_due_s = -inf
        self._setpoint: MotionSetpoint | AttitudeSetpoint | None = None
        self._setpoint_s = -inf
        self._was_armed = False

    # ------------------------------------------------------------ what it shows

    @property
    def armed(self) -> bool:
        """Motors live."""
        return self._commander.armed

    @property
    def mode(self) -> str:
        """Name of the flight mode."""
        return self._commander.mode.name

    @property
    def mode_numbers(self) -> tuple[int, int]:
        """HEARTBEAT's base_mode and custom_mode."""
        mode = self._commander.mode
        return mode.base_mode | (128 if self.armed else 0), mode.custom_mode

    @property
    def task(self) -> Task:
        """What is being flown."""
        return self._commander.task

    @property
    def aligned(self) -> bool:
        """The estimator knows attitude and position."""
        return self._commander.situation.aligned

    @property
    def ready_to_arm(self) -> bool:
        """What SYS_STATUS reports as the pre-arm check: position known and level."""
        now = self._commander.situation
        return now.aligned and (now.tilt_rad < math.radians(20.0) or not now.landed)

    @property
    def in_failsafe(self) -> bool:
        """A failsafe has taken over."""
        return self._commander.in_failsafe

    @property
    def landed_state(self) -> LandedState:
        """EXTENDED_SYS_STATE's landed_state."""
        if self._cascade.landed:
            return LandedState.ON_GROUND
        if self.task is Task.TAKE_OFF:
            return LandedState.TAKEOFF
        return LandedState.LANDING if self.task is Task.LAND else LandedState.IN_AIR

    @property
    def thrust(self) -> float:
        """Collective thrust asked of the motors, 0..1."""
        return self._cascade.thrust

    @property
    def attitude_setpoint(self) -> Quaternion:
        """Attitude that the inner loop follows, in the autopilot's own frame."""
        return self._cascade.attitude_setpoint

    @property
    def home_ned_m(self) -> Vector3:
        """Where it was last disarmed, in its own NED."""
        return self._navigator.home_ned_m

    def geodetic(self, position_ned_m: Vector3) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m) of a place in its own NED."""
        return geodetic_from_ned(position_ned_m, self._origin)

    def take_texts(self) -> list[Text]:
        """Severities and texts since the last call."""
        texts = list(self._commander.texts)
        self._commander.texts.clear()
        return texts

    def set_mode_named(self, name: str) -> Result:
        """Change to a mode of the manner's own."""
        return self._commander.change_mode(self.manner.mode(name))

    # ------------------------------------------------------------ time

    def step(self, truth: TrueMotion, dt_s: float, now_s: float) -> Motors:
        """One step of the physics: the four motor commands 0..1 (front, right, rear, left)."""
        self.estimate.update_attitude(truth)
        if now_s >= self._outer_due_s - _EARLY_S:
            self._outer(truth, now_s)
        if not self._commander.armed:
            return STOPPED
        return self._cascade.step(self.estimate, dt_s)

    def _outer(self, truth: TrueMotion, now_s: float) -> None:
        if self.booted_s is None:
            self.booted_s = now_s
        # a step that comes late is made up for by the next ones, a long silence is not
        self._outer_due_s = max(self._outer_due_s, now_s - _OUTER_PERIOD_S) + _OUTER_PERIOD_S
        estimate = self.estimate
        estimate.update_position(truth, _OUTER_PERIOD_S)
        self._watch(now_s - self.booted_s, now_s - self._setpoint_s)
        if self._commander.armed != self._was_armed:
            self._was_armed = self._commander.armed
            self._cascade.disarm(estimate)
        if self._commander.armed:
            self._fly()
        else:
            self._navigator.home_ned_m = estimate.position_ned_m

    def _watch(self, up_s: float, setpoint_age_s: float) -> None:
        """Tell the commander how things stand."""
        now = self._commander.situation
        if not now.aligned and up_s >= self.manner.alignment_s:
            now.aligned = True
            for text in self.manner.texts.aligned:
                self._commander.say(Severity.INFO, text)
        now.landed = self._cascade.landed
        now.has_flown = now.has_flown or self._cascade.airborne
        now.tilt_rad = tilt_from_quat(self.estimate.attitude)
        now.setpoint_age_s = setpoint_age_s
        now.setpoint_timeout_s = self.parameters.si(self.manner.settings.setpoint_timeout)
        self._commander.update(_OUTER_PERIOD_S)

    def _fly(self) -> None:
        setpoint = self._wanted()
        cascade, texts = self._cascade, self.manner.texts
        if cascade.landed:
            by_setpoint = self.task is Task.SETPOINT and self.manner.takes_off_by_setpoint
            if not (by_setpoint or self.task is Task.TAKE_OFF) or not cascade.wants_up(
                setpoint, self.estimate
            ):
                return
            cascade.lift_off()
            self._commander.say(Severity.INFO, texts.lifted)
        cascade.outer(
            setpoint, self.estimate, self._thrust_is_climb_rate(), self._still_speed(), _OUTER_PERIOD_S
        )
        if cascade.landed:
            self._navigator.let_go()
            self._commander.say(Severity.INFO, texts.landed)

    def _wanted(self) -> MotionSetpoint | AttitudeSetpoint:
        """The setpoint of the task on hand; a task that is done hands over to the next."""
        if self.task is Task.SETPOINT and self._setpoint is not None:
            self._navigator.let_go()  # wherever it is held afterwards, it is not where it was held before
            if not self._timed_out(self._setpoint):
                return self._setpoint
            self._commander.begin(Task.HOLD)
        estimate = self.estimate
        setpoint, following = self._navigator.step(
            self.task, estimate.position_ned_m, estimate.velocity_ned_m_s
        )
        if following is not None:
            if self.task is Task.TAKE_OFF:
                self.set_mode_named(self.manner.after_take_off_mode)
            self._commander.begin(following)
        return setpoint

    def _timed_out(self, setpoint: MotionSetpoint | AttitudeSetpoint) -> bool:
        """ArduPilot stops by itself, within the mode, when a stream of anything but positions ends."""
        now = self._commander.situation
        if not self.manner.external_times_out_in_mode or now.setpoint_age_s <= now.setpoint_timeout_s:
            return False
        return isinstance(setpoint, AttitudeSetpoint) or math.isnan(setpoint.position_ned_m[0])

    def _thrust_is_climb_rate(self) -> bool:
        options = self.manner.settings.guided_options
        if options is None:
            return self.manner.thrust_is_climb_rate
        return not int(self.parameters.si(options)) & _THRUST_OPTION

    def _still_speed(self) -> float:
        setting = self.manner.settings.still_speed
        return self.manner.still_speed_m_s if setting is None else self.parameters.si(setting)
