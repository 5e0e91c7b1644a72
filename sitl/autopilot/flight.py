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
    ned_from_geodetic,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.messages import LandedState, Truth
from companion.messages import Manner as MannerName
from sitl.autopilot.airframe import Airframe, hover_thrust
from sitl.autopilot.ardupilot import ARDUPILOT
from sitl.autopilot.cascade import STOPPED, Cascade
from sitl.autopilot.commander import Commander, Text
from sitl.autopilot.estimator import Estimator, EstimatorErrors
from sitl.autopilot.landing_target import View
from sitl.autopilot.manners import Manner
from sitl.autopilot.mission import Here, MissionRunner
from sitl.autopilot.mission_items import Command, ItemFrame, MissionItem, MissionStore
from sitl.autopilot.mixer import Motors
from sitl.autopilot.modes import Mode, Result, Severity, StickLaw, Task
from sitl.autopilot.navigator import Navigator
from sitl.autopilot.px4 import PX4
from sitl.autopilot.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.sticks import Radio, StickPilot, StickScales
from sitl.parameters import Parameters

MANNERS: dict[MannerName, Manner] = {"px4": PX4, "ardupilot": ARDUPILOT}

_OUTER_PERIOD_S = 0.01
_EARLY_S = 1e-6
_THRUST_OPTION = 8
# bits of the parameter that says in which tasks a lost radio is of no matter, and tasks where it never is
_RADIO_EXCEPTIONS = {Task.MISSION: 1, Task.HOLD: 2, Task.GO_TO: 2, Task.SETPOINT: 4}
_RADIO_NOT_NEEDED = (Task.LAND, Task.PRECISION_LAND, Task.RETURN)


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
        self.mission = MissionStore(self.manner.mission, home=self._home_item)
        self.boots = 0
        self._airframe = airframe
        self._origin = home
        self._setpoint: MotionSetpoint | AttitudeSetpoint | None = None
        self._boot()

    def _boot(self) -> None:
        """Everything that does not outlive a reboot; the parameters and the mission do."""
        self.boots += 1
        self.booted_s: float | None = None
        self.radio = Radio(self.manner.forward_is_low)
        self._commander = Commander(self.manner)
        self._navigator = Navigator(self.manner, self.parameters)
        self._cascade = Cascade(self.manner, self._airframe)
        self._runner = MissionRunner(
            self.mission, self._navigator, self.parameters, self.manner.settings, self._local
        )
        self._lander = self.manner.lander(self.parameters)
        self._pilot = StickPilot()
        self._outer_due_s = -inf
        self._now_s = -inf
        self._setpoint = None
        self._setpoint_s = -inf
        self._was_armed = False
        self._mission_version = -1
        self._last_task: Task | None = None
        self._lands_precisely = False
        self._stick_law: StickLaw | None = None

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
        if self._commander.flown is Task.TAKE_OFF:
            return LandedState.TAKEOFF
        landing = self._commander.flown in (Task.LAND, Task.PRECISION_LAND)
        return LandedState.LANDING if landing else LandedState.IN_AIR

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
        speakers = [self.mission.texts] if self._lander is None else [self.mission.texts, self._lander.texts]
        texts = list(self._commander.texts)
        self._commander.texts.clear()
        for speaker in speakers:
            texts += speaker
            speaker.clear()
        return texts

    def set_mode_named(self, name: str) -> Result:
        """Change to a mode of the manner's own."""
        return self._change_mode(self.manner.mode(name))

    def _change_mode(self, mode: Mode | None, number: int = 0) -> Result:
        self._watch_mission()  # one that has come since the last step counts already
        return self._commander.change_mode(mode, number)

    # ------------------------------------------------------------ time

    def step(self, truth: Truth, dt_s: float, now_s: float) -> Motors:
        """One step of the physics: the four motor commands 0..1 (front, right, rear, left)."""
        self.estimate.update_attitude(truth)
        if now_s >= self._outer_due_s - _EARLY_S:
            self._outer(truth, now_s)
        if not self._commander.armed:
            return STOPPED
        return self._cascade.step(self.estimate, dt_s)

    def _outer(self, truth: Truth, now_s: float) -> None:
        if self.booted_s is None:
            self.booted_s = now_s
        # a step that comes late is made up for by the next ones, a long silence is not
        self._outer_due_s = max(self._outer_due_s, now_s - _OUTER_PERIOD_S) + _OUTER_PERIOD_S
        self._now_s = now_s
        estimate = self.estimate
        estimate.update_position(truth, _OUTER_PERIOD_S)
        self._watch(now_s - self.booted_s, now_s - self._setpoint_s)
        if self._commander.armed != self._was_armed:
            self._was_armed = self._commander.armed
            self._cascade.disarm(estimate)
            if not self._was_armed:
                self._runner.rest()
                self._navigator.speeds.forget()
        if self._lander is not None:
            self._lander.watch(self._view(), _OUTER_PERIOD_S)
        if self._commander.armed:
            self._fly()
        elif not self._navigator.home_is_fixed:
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
        self._watch_mission()
        self._watch_radio()
        self._commander.update(_OUTER_PERIOD_S)

    def _watch_mission(self) -> None:
        if self._mission_version != self.mission.version:
            self._mission_version = self.mission.version
            now = self._commander.situation
            now.mission_ready = self.mission.flyable
            now.mission_climbs = self.mission.starts_with_take_off()

    def _watch_radio(self) -> None:
        now, settings, task = self._commander.situation, self.manner.settings, self.task
        timeout_s = self._radio_timeout_s()
        sticks = self.radio.sticks(self._now_s, timeout_s)
        now.radio = sticks is not None
        now.throttle_up = sticks is not None and sticks.throttle_is_up
        exceptions = settings.radio_exceptions
        kept = 0 if exceptions is None else int(self.parameters.si(exceptions))
        excepted = task in _RADIO_NOT_NEEDED or kept & _RADIO_EXCEPTIONS.get(task, 0)
        watched = settings.radio_watched is None or self.parameters.si(settings.radio_watched) > 0.0
        now.radio_lost = watched and not excepted and self.radio.lost(self._now_s, timeout_s)
        if now.throttle_up:
            self._runner.started = True

    def _radio_timeout_s(self) -> float:
        """How long sticks are good for; a negative time-out is none."""
        timeout_s = self.parameters.si(self.manner.settings.radio_timeout)
        return timeout_s if timeout_s >= 0.0 else inf

    def _fly(self) -> None:
        setpoint = self._wanted()
        cascade, texts = self._cascade, self.manner.texts
        if cascade.landed:
            by_setpoint = self.task is Task.SETPOINT and self.manner.takes_off_by_setpoint
            may_lift = by_setpoint or self._stick_law or self._commander.flown is Task.TAKE_OFF
            if not may_lift or not cascade.wants_up(setpoint, self.estimate):
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
        by_sticks = self._by_sticks()
        if by_sticks is not None:
            self._navigator.let_go()
            return by_sticks
        task = self.task
        if task is not self._last_task and task is Task.MISSION:
            self._runner.enter()
        self._last_task = task
        if task is Task.MISSION:
            heading = yaw_from_quat(self.estimate.attitude)
            here = Here(self.estimate.position_ned_m, heading, self._cascade.landed, _OUTER_PERIOD_S)
            wanted = self._runner.step(here)
            self._commander.subtask = wanted if isinstance(wanted, Task) else None
            if isinstance(wanted, MotionSetpoint):
                self._navigator.let_go()
                return wanted
            task = wanted
        return self._by_task(task)

    def _by_task(self, task: Task) -> MotionSetpoint:
        """The setpoint of a task; one that is done hands over to the next."""
        landing = self._by_lander(task)
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
            self.set_mode_named(self.manner.after_take_off_mode)
        self._commander.begin(following)
        return setpoint

    def _by_lander(self, task: Task) -> MotionSetpoint | None:
        """The autopilot's own precision landing, where it is asked for."""
        lander = self._lander
        if lander is None or task not in self.manner.lands_precisely:
            self._lands_precisely = False
            return None
        if not self._lands_precisely:
            self._lands_precisely = True
            lander.begin(required=self.task is not Task.MISSION or self._runner.precision_required)
        return lander.fly(self._view(), _OUTER_PERIOD_S)

    def _by_sticks(self) -> MotionSetpoint | AttitudeSetpoint | None:
        """What the sticks ask for in a mode that is flown by them; None: nothing, hold."""
        law = self._commander.mode.sticks
        sticks = None if law is None else self.radio.sticks(self._now_s, self._radio_timeout_s())
        self._stick_law = None
        if law is None or sticks is None:
            self._pilot.rest()
            return None
        heading = yaw_from_quat(self.estimate.attitude)
        setpoint = self._pilot.setpoint(law, sticks, self._stick_scales(), heading, _OUTER_PERIOD_S)
        if setpoint is not None:
            self._stick_law = law
        return setpoint

    def _stick_scales(self) -> StickScales:
        settings, si = self.manner.settings, self.parameters.si
        return StickScales(
            speed_m_s=si(settings.stick_speed),
            climb_m_s=si(settings.stick_climb),
            descent_m_s=si(settings.stick_descent),
            tilt_rad=si(settings.stick_tilt),
            yaw_rate_rad_s=si(settings.stick_yaw_rate),
            hover=hover_thrust(self._airframe),
        )

    def _view(self) -> View:
        estimate = self.estimate
        position = estimate.position_ned_m
        return View(
            self._now_s,
            position,
            estimate.velocity_ned_m_s,
            estimate.attitude,
            self._navigator.home_ned_m[2] - position[2],
            self._navigator.landing_speed(position),
        )

    def _local(self, place: Vector3, over_home: bool) -> Vector3:
        """Latitude, longitude (deg) and altitude (m) in the own NED; what is no number is the present one."""
        latitude, longitude, altitude = self.geodetic(self.estimate.position_ned_m)
        if math.isfinite(place[0]) and math.isfinite(place[1]):
            latitude, longitude = place[0], place[1]
        if math.isfinite(place[2]):
            altitude = place[2] + (self.geodetic(self.home_ned_m)[2] if over_home else 0.0)
        return ned_from_geodetic(latitude, longitude, altitude, self._origin)

    def _home_item(self) -> MissionItem:
        """Home as a mission's item 0."""
        latitude, longitude, altitude = self.geodetic(self.home_ned_m)
        parameters = (0.0, 0.0, 0.0, 0.0)
        return MissionItem(Command.WAYPOINT, ItemFrame.GLOBAL, parameters, latitude, longitude, altitude)

    def _timed_out(self, setpoint: MotionSetpoint | AttitudeSetpoint) -> bool:
        """ArduPilot stops by itself, within the mode, when a stream of anything but positions ends."""
        now = self._commander.situation
        if not self.manner.external_times_out_in_mode or now.setpoint_age_s <= now.setpoint_timeout_s:
            return False
        return isinstance(setpoint, AttitudeSetpoint) or math.isnan(setpoint.position_ned_m[0])

    def _thrust_is_climb_rate(self) -> bool:
        if self._stick_law is not None:
            return self._stick_law is StickLaw.ANGLE_AND_CLIMB
        options = self.manner.settings.guided_options
        if options is None:
            return self.manner.thrust_is_climb_rate
        return not int(self.parameters.si(options)) & _THRUST_OPTION

    def _still_speed(self) -> float:
        setting = self.manner.settings.still_speed
        return self.manner.still_speed_m_s if setting is None else self.parameters.si(setting)
