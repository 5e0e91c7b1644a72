"""The simulated flight controller: estimator, commander, navigator and cascade, at the pace of the physics.

Attitude and rates at every call (400 Hz), the outer loop at the profile's rate. Its NED frame, height and
heading have the errors of `estimator`. The MAVLink endpoint's commands are method calls that return a
MAV_RESULT; texts for the ground are in `take_texts`. SI units.
"""

import dataclasses
import math
from collections import deque
from math import inf, isfinite, isnan, nan
from typing import Literal

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import (
    Quaternion,
    Vector3,
    geodetic_from_ned,
    ned_from_geodetic,
    subtract,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.base.messages import LandedState
from sitl.autopilot.ardupilot.profile import ARDUPILOT
from sitl.autopilot.control.attitude_control import RateGains
from sitl.autopilot.control.cascade import Cascade
from sitl.autopilot.control.estimator import EstimatorErrors, SimulatedEstimator
from sitl.autopilot.control.setpoints import (
    OVER_HOME,
    AttitudeSetpoint,
    MotionSetpoint,
    SetpointRefusal,
    StreamedAttitude,
    StreamedMotion,
)
from sitl.autopilot.flight.commander import Commander, Text
from sitl.autopilot.flight.manual_control import ManualControl, RcInput, Sticks
from sitl.autopilot.flight.mission import MissionInputs, MissionRunner, heading_from_condition
from sitl.autopilot.flight.mission_items import (
    Fence,
    ItemFrame,
    MissionCommand,
    MissionItem,
    MissionStore,
    wrong_place,
)
from sitl.autopilot.flight.modes import CommandResult, Mode, Severity, StickMode, Task
from sitl.autopilot.flight.navigator import Navigator
from sitl.autopilot.flight.profile import (
    AutopilotProfile,
    LandingTarget,
    Parameters,
    VehicleEstimate,
    setpoints_stopped,
)
from sitl.autopilot.px4.profile import PX4
from sitl.sensors.autopilot_sensors import Pace
from sitl.vehicle.battery import Battery
from sitl.vehicle.quadrotor import QuadrotorParameters, QuadrotorState, RotorValues

RefusedRequest = Literal["arm", "take_off", "offboard", "land", "disarm", "auto_disarm"]
_CEILING, _CIRCLE = 1, 2  # bits of an autopilot's own fences
PROFILES: dict[AutopilotKind, AutopilotProfile] = {"px4": PX4, "ardupilot": ARDUPILOT}
_THRUST_OPTION = 8
_NO_ATTITUDE = AttitudeSetpoint(None, 0.0)
_LEAST_TAKE_OFF_M = 0.5
_MOST_ALTITUDE_M = 30_000.0


class SimulatedAutopilot:
    """One autopilot on one airframe.

    `home` is latitude (deg), longitude (deg), altitude (m) of the origin of the SITL's NED.
    """

    def __init__(
        self,
        profile: AutopilotKind,
        airframe: QuadrotorParameters,
        rng: np.random.Generator,
        home: Vector3,
        errors: EstimatorErrors | None = None,
        rates: RateGains | None = None,
    ) -> None:
        self.profile = PROFILES[profile]
        self.parameters = Parameters(self.profile.parameters)
        self.estimate = SimulatedEstimator(errors or EstimatorErrors(), rng)
        self.mission = MissionStore(self.profile.mission, home=self._home_item)
        self.fence = Fence(self.profile.mission.fences_unite)
        self._airframe, self._rates = airframe, rates
        self._origin = home
        self.battery = Battery(airframe.max_thrust_n)
        self._stopped: RotorValues = (0.0,) * airframe.layout.count
        self._motors = self._stopped
        self._setpoint: MotionSetpoint | AttitudeSetpoint | None = None
        self.clear_faults()
        self._boot()

    def clear_faults(self) -> None:
        """Nothing refused, the position known, the battery's charge as it is."""
        self.refused: frozenset[RefusedRequest] = frozenset()
        self.position_lost = False
        self.battery.false_share = None

    def _boot(self) -> None:
        """Reset everything but the parameters and the mission, as a reboot does."""
        self.booted_s: float | None = None
        self.commander = Commander(self.profile)
        self._navigator = Navigator(self.profile, self.parameters)
        self._cascade = Cascade(self.profile, self._airframe, self._rates)
        self._runner = MissionRunner(
            self.mission, self._navigator, self.parameters, self.profile.parameter_map, self._local
        )
        self._precision_landing = self.profile.precision_landing(self.parameters)
        self._manual_control = ManualControl(self.profile, self.parameters, self._airframe.hover_share())
        self._pace = Pace(self.profile.outer_period_s)
        self._now_s = -inf
        self._setpoint = None
        self.wanted: MotionSetpoint | AttitudeSetpoint | None = None  # what is flown, None before
        self._setpoint_s = -inf
        self._arming_seen = (False, 0)  # armed, and disarmings so far
        self._mission_version = -1
        self._last_task: Task | None = None
        self._precision_landing_active = False

    # ------------------------------------------------------------ public state

    @property
    def armed(self) -> bool:
        return self.commander.armed

    @property
    def mode(self) -> str:
        return self.commander.mode.name

    @property
    def mode_numbers(self) -> tuple[int, int]:
        """HEARTBEAT's base_mode and custom_mode."""
        mode = self.commander.mode
        return mode.base_mode | (128 if self.armed else 0), mode.custom_mode

    @property
    def task(self) -> Task:
        return self.commander.task

    @property
    def obeys_setpoints(self) -> bool:
        """It flies a streamed setpoint whose time is not up."""
        now = self.commander.situation
        return self.task is Task.SETPOINT and now.setpoint_age_s <= now.setpoint_timeout_s

    @property
    def aligned(self) -> bool:
        """The estimator knows attitude and position."""
        return self.commander.situation.aligned

    @property
    def ready_to_arm(self) -> bool:
        """What SYS_STATUS reports as the pre-arm check: level, and what the mode needs is there.

        That is a known position, and for PX4's OFFBOARD setpoints that keep coming.
        """
        now, mode = self.commander.situation, self.commander.mode
        needs_position = mode.sticks in (None, StickMode.VELOCITY)
        known = now.aligned if needs_position else now.home_set
        if self.profile.external_needs_setpoints and setpoints_stopped(now):
            return False
        return known and (now.tilt_rad < math.radians(20.0) or not now.landed)

    @property
    def landed_state(self) -> LandedState:
        """EXTENDED_SYS_STATE's landed_state."""
        if self._cascade.landed:
            return LandedState.ON_GROUND
        if self.commander.flown is Task.TAKE_OFF:
            return LandedState.TAKEOFF
        landing = self.commander.flown in (Task.LAND, Task.PRECISION_LAND)
        return LandedState.LANDING if landing else LandedState.IN_AIR

    @property
    def fence_enabled(self) -> bool:
        switch = self.profile.parameter_map.fence_enabled
        present = bool(self.fence.items) or bool(self._own_fences())
        return present and (switch is None or self.parameters.si(switch) != 0.0)

    @property
    def fence_broken(self) -> bool:
        if not self.fence_enabled or not self.aligned:
            return False
        latitude, longitude, _ = self.geodetic(self.estimate.position_ned_m)
        return self.fence.broken_at(latitude, longitude) or self._beyond_own_fence()

    def _own_fences(self) -> int:
        """Bits of the ceiling and the circle about home that the autopilot has by its parameters alone."""
        types = self.profile.parameter_map.fence_types
        return 0 if types is None else int(self.parameters.si(types)) & (_CEILING | _CIRCLE)

    def _beyond_own_fence(self) -> bool:
        own = self.profile.parameter_map
        north, east, down = subtract(self.estimate.position_ned_m, self.home_ned_m)
        bounds = ((_CIRCLE, own.fence_radius, math.hypot(north, east)), (_CEILING, own.fence_ceiling, -down))
        return any(
            self._own_fences() & bit and most is not None and value > self.parameters.si(most)
            for bit, most, value in bounds
        )

    @property
    def battery_percent(self) -> int:
        """Remaining charge as the autopilot reports it."""
        return round(100.0 * self.battery.share)

    @property
    def thrust(self) -> float:
        """Collective thrust setpoint, 0..1."""
        return self._cascade.thrust

    @property
    def attitude_setpoint(self) -> Quaternion:
        """Attitude that the inner loop follows, in the autopilot's own frame."""
        return self._cascade.attitude_setpoint

    @property
    def rc_input(self) -> RcInput:
        return self._manual_control.rc_input

    @property
    def home_ned_m(self) -> Vector3:
        """Where it was last disarmed, in its own NED."""
        return self._navigator.home_ned_m

    def geodetic(self, position_ned_m: Vector3) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m) of a place in its own NED."""
        return geodetic_from_ned(position_ned_m, self._origin)

    def take_texts(self) -> list[Text]:
        """Severities and texts since the last call."""
        speakers: list[deque[Text] | list[Text]] = [self.commander.texts, self.mission.texts]
        if self._precision_landing is not None:
            speakers.append(self._precision_landing.texts)
        texts: list[Text] = []
        for speaker in speakers:
            texts += speaker
            speaker.clear()
        return texts

    def set_mode_named(self, name: str) -> CommandResult:
        """Change to one of the profile's modes by name."""
        return self._change_mode(self.profile.mode(name))

    def _change_mode(self, mode: Mode | None, number: int = 0) -> CommandResult:
        refused: RefusedRequest | None = None
        if mode is not None and mode.takes_setpoints:
            refused = "offboard"
        elif mode is not None and mode.task is Task.LAND:
            refused = "land"
        if refused in self.refused:
            return self.profile.refused
        self._watch_mission()  # one received since the last step counts already
        return self.commander.change_mode(mode, number)

    def _watch_mission(self) -> None:
        if self._mission_version != self.mission.version:
            self._mission_version = self.mission.version
            now = self.commander.situation
            now.mission_ready = self.mission.flyable
            now.mission_climbs = self.mission.starts_with_take_off()

    # ------------------------------------------------------------ places

    def _local(self, place: Vector3, over_home: bool) -> Vector3:
        """Latitude, longitude (deg) and altitude (m) in local NED; NaN means the present one."""
        latitude, longitude, altitude = self.geodetic(self.estimate.position_ned_m)
        if math.isfinite(place[0]) and math.isfinite(place[1]):
            latitude, longitude = place[0], place[1]
        if math.isfinite(place[2]):
            altitude = place[2] + (self.geodetic(self.home_ned_m)[2] if over_home else 0.0)
        return ned_from_geodetic(latitude, longitude, altitude, self._origin)

    def _home_item(self) -> MissionItem:
        latitude, longitude, altitude = self.geodetic(self.home_ned_m)
        parameters = (0.0, 0.0, 0.0, 0.0)
        return MissionItem(
            MissionCommand.WAYPOINT, ItemFrame.GLOBAL, parameters, latitude, longitude, altitude
        )

    # ------------------------------------------------------------ time

    def step(self, truth: QuadrotorState, dt_s: float, now_s: float) -> RotorValues:
        """One step of the physics: the four motor commands 0..1 (front, right, rear, left)."""
        self.estimate.update_attitude(truth)
        if self._pace.due(now_s):
            self._outer(truth, now_s)
        armed = self.commander.armed
        motors = self._motors = self._cascade.step(self.estimate, dt_s) if armed else self._stopped
        return motors

    def _outer(self, truth: QuadrotorState, now_s: float) -> None:
        if self.booted_s is None:
            self.booted_s = now_s
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
        if self.commander.armed:
            self._fly()
        elif not self._navigator.home_is_fixed:
            self._navigator.home_ned_m = estimate.position_ned_m

    def _note_arming(self) -> None:
        """Reset the cascade after every arming and disarming, however close together."""
        now = (self.commander.armed, self.commander.disarmings)
        if now == self._arming_seen:
            return
        stopped, self._arming_seen = now[1] != self._arming_seen[1], now
        self._cascade.disarm(self.estimate)
        if stopped:
            self._runner.rest()
            self._navigator.speeds.forget()

    def _watch(self, up_s: float, setpoint_age_s: float) -> None:
        now = self.commander.situation
        now.home_set = up_s >= self.profile.home_s
        if self.position_lost:
            now.aligned = False
        elif not now.aligned and up_s >= self.profile.alignment_s:
            now.aligned = True
            for text in self.profile.texts.aligned:
                self.commander.send_text(Severity.INFO, text)
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
        self.commander.stays_armed = "auto_disarm" in self.refused
        self.commander.update(self.profile.outer_period_s)

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
            lifts = self.profile.takes_off_by_setpoint or self.commander.mode.by_attitude
            by_setpoint = self.task is Task.SETPOINT and lifts
            may_lift = by_setpoint or self._manual_control.stick_mode or self.commander.flown is Task.TAKE_OFF
            by_climb_rate = self._thrust_is_climb_rate()
            if not may_lift or not cascade.wants_up(setpoint, self.estimate, by_climb_rate):
                return
            cascade.lift_off()
            self.commander.send_text(Severity.INFO, texts.lifted)
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
            self.commander.send_text(Severity.INFO, texts.landed)

    def _wanted(self) -> MotionSetpoint | AttitudeSetpoint:
        heading = yaw_from_quat(self.estimate.attitude)
        if self.task is Task.SETPOINT and self._setpoint is not None:
            self._navigator.let_go()  # the next hold starts at a new position
            now = self.commander.situation
            return self.profile.as_aged(self._setpoint, now.setpoint_age_s, now.setpoint_timeout_s, heading)
        if self.task is Task.HOLD and self.commander.mode.by_attitude:
            self._navigator.let_go()
            return self.profile.as_aged(_NO_ATTITUDE, math.inf, 0.0, heading)
        by_sticks = self._manual_control.setpoint(
            self.commander.mode, heading, self._now_s, self.profile.outer_period_s
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
            self.commander.subtask = wanted if isinstance(wanted, Task) else None
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
        self.commander.begin(following)
        return setpoint

    def _precision_landing_setpoint(self, task: Task) -> MotionSetpoint | None:
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

    # ------------------------------------------------------------ commands

    def arm(self, force: bool = False) -> CommandResult:
        """Arm; refused with a text before alignment, when tilting, or in a mode that lands."""
        if "arm" in self.refused:
            return self.profile.refused
        return self.commander.arm(force)

    def disarm(self, force: bool = False) -> CommandResult:
        """Disarm; refused in flight unless forced."""
        if "disarm" in self.refused:
            return self.profile.refused
        return self.commander.disarm(force)

    def set_mode(self, custom_mode: int) -> CommandResult:
        return self._change_mode(self.profile.mode_by_number(custom_mode), custom_mode)

    def take_off(self, altitude_m: float) -> CommandResult:
        """NAV_TAKEOFF.

        PX4 takes an altitude above sea level, NaN or too low a one meaning MIS_TAKEOFF_ALT; ArduPilot
        takes one over home, in GUIDED, armed, from the ground.
        """
        if "take_off" in self.refused:
            return CommandResult.TEMPORARILY_REJECTED
        if self.profile.take_off_needs_guided:
            if self.mode != self.profile.take_off_mode or not self.armed or not self._cascade.landed:
                return CommandResult.FAILED
            if not _LEAST_TAKE_OFF_M <= altitude_m <= _MOST_ALTITUDE_M:
                return CommandResult.FAILED
            self._navigator.climb_to_m = altitude_m
            self.commander.begin(Task.TAKE_OFF)
            return CommandResult.ACCEPTED
        if not self._cascade.landed:
            return self.set_mode_named(self.profile.hold_mode)
        height = altitude_m - self.geodetic(self._navigator.home_ned_m)[2]
        if self.profile.parameter_map.take_off_height and not _LEAST_TAKE_OFF_M <= height <= _MOST_ALTITUDE_M:
            height = self.parameters.si(self.profile.parameter_map.take_off_height)
            self.commander.send_text(Severity.INFO, f"Using default takeoff altitude: {height:.2f} m")
        self._navigator.climb_to_m = height
        return self.set_mode_named(self.profile.take_off_mode)

    def go_to(
        self, place: Vector3, over_home: bool, yaw_rad: float = nan, speed_m_s: float | None = None
    ) -> CommandResult:
        """DO_REPOSITION: fly to latitude, longitude and altitude (over home, or above sea level), and hold.

        NaN keeps the present latitude and longitude, or altitude; a NaN yaw keeps the heading.
        """
        if not self.armed or self._cascade.landed or not _is_place(place):
            return CommandResult.DENIED
        result = self.set_mode_named(self.profile.after_take_off_mode)
        if result is CommandResult.ACCEPTED:
            self._navigator.target_ned_m = self._local(place, over_home)
            self._navigator.target_yaw_rad = yaw_rad if isfinite(yaw_rad) else nan
            self._navigator.target_speed_m_s = speed_m_s
            self.commander.begin(Task.GO_TO)
        return result

    def go_to_where_guided(self, place: Vector3, over_home: bool) -> bool:
        """A waypoint with current = 2: `go_to`, in the mode that takes such orders; whether it does."""
        takes_orders = self.mode == self.profile.after_take_off_mode
        return takes_orders and self.go_to(place, over_home) is CommandResult.ACCEPTED

    def precision_land(self) -> CommandResult:
        """NAV_PRECLAND, where there is a mode for it."""
        mode = next((mode for mode in self.profile.modes if mode.task is Task.PRECISION_LAND), None)
        return CommandResult.UNSUPPORTED if mode is None else self._change_mode(mode)

    def change_speed(self, kind: int, speed_m_s: float) -> CommandResult:
        if not self._navigator.speeds.change(kind, speed_m_s):
            return CommandResult.DENIED
        if self.task is Task.GO_TO and kind in (0, 1) and speed_m_s > 0.0:
            self._navigator.target_speed_m_s = speed_m_s
        return CommandResult.ACCEPTED

    def turn_to(self, parameters: tuple[float, ...]) -> CommandResult:
        """CONDITION_YAW while it holds a place or flies to one; parameters 1 to 4 of the command."""
        heading = heading_from_condition(parameters, yaw_from_quat(self.estimate.attitude))
        if heading is None or not self.armed or self.task not in (Task.HOLD, Task.GO_TO):
            return CommandResult.FAILED
        self._navigator.target_yaw_rad = self._navigator.held_yaw_rad = heading
        return CommandResult.ACCEPTED

    def set_home(self, place: Vector3 | None, over_home: bool = False) -> CommandResult:
        """DO_SET_HOME to a place (deg, deg, m), None: to where the vehicle is; denied when too far away."""
        if not self.aligned:
            return CommandResult.FAILED
        home = self.estimate.position_ned_m if place is None else self._local(place, over_home)
        return CommandResult.ACCEPTED if self._navigator.fix_home(home) else CommandResult.DENIED

    def terminate(self) -> CommandResult:
        """Flight termination: motors off."""
        self.commander.terminate()
        return CommandResult.ACCEPTED

    def reboot(self) -> CommandResult:
        """Reboot on the ground, as after power-up; parameters and mission stay. Refused while armed."""
        if self.armed:
            return self.profile.refused
        self._boot()
        return CommandResult.ACCEPTED

    def recover(self, now_s: float) -> None:
        """A watchdog's reset: the motors stay on, the time since boot begins again, and it holds."""
        self.booted_s, self._setpoint, self._setpoint_s = now_s, None, -inf
        self.commander.recover()

    # ------------------------------------------------------------ missions

    def start_mission(self, first: int = -1) -> CommandResult:
        """MISSION_START; PX4 arms for it, ArduPilot has to be armed."""
        if not self.mission.flyable or (first >= 0 and not self.mission.select(first)):
            self.commander.send_text(Severity.CRITICAL, self.profile.texts.no_mission)
            return self.profile.refused
        mode = next(mode for mode in self.profile.modes if mode.task is Task.MISSION)
        waits = self.profile.mission.waits_for_start
        if waits and not self.armed:
            return CommandResult.FAILED
        result = self._change_mode(mode)
        if result is CommandResult.ACCEPTED and not waits:
            result = self.arm()
        if result is CommandResult.ACCEPTED:
            self._runner.started = True
        return result

    def select_mission_item(self, number: int) -> CommandResult:
        """DO_SET_MISSION_CURRENT."""
        return CommandResult.ACCEPTED if self.mission.select(number) else self.profile.refused_selection

    def land_by_mission(self) -> CommandResult:
        """DO_LAND_START: continue with the mission's item of that command."""
        number = self.mission.landing_start()
        return CommandResult.FAILED if number is None else self.start_mission(number)

    def pause(self, paused: bool) -> CommandResult:
        """DO_PAUSE_CONTINUE: hold within a mission, and go on with it."""
        if self.task is not Task.MISSION:
            return CommandResult.DENIED
        self._runner.paused = paused
        return CommandResult.ACCEPTED

    # ------------------------------------------------------------ sticks and targets

    def override_rc_channels(self, values: list[int | None], sender_system: int, now_s: float) -> None:
        """RC_CHANNELS_OVERRIDE (microseconds, 0 releases, None keeps), from a permitted system."""
        if self._may_control_manually(sender_system):
            self.rc_input.override(values, now_s)

    def set_manual_control(self, sticks: Sticks, sender_system: int, now_s: float) -> None:
        """MANUAL_CONTROL, from a permitted system."""
        if self._may_control_manually(sender_system):
            self.rc_input.manual(sticks, now_s)

    def handle_landing_target(self, target: LandingTarget) -> None:
        if self._precision_landing is not None:
            self._precision_landing.update_target(target)

    def _may_control_manually(self, sender_system: int) -> bool:
        own = self.profile.parameter_map.gcs_system_id
        return own is None or sender_system == int(self.parameters.si(own))

    # ------------------------------------------------------------ streamed setpoints

    def stream_fields(self, fields: StreamedMotion, now_s: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED: flown, rejected with a text, or ignored, as the autopilot does."""
        estimate = self.estimate
        heading = yaw_from_quat(estimate.attitude)
        wish = self.profile.read_motion(fields, estimate.position_ned_m, estimate.attitude, heading)
        if isinstance(wish, MotionSetpoint):
            top_speed = self.parameters.si(self.profile.parameter_map.top_speed)
            wish = dataclasses.replace(wish, horizontal_speed_m_s=top_speed)
        self._take(wish, now_s)

    def stream_global(self, fields: StreamedMotion, place: Vector3, now_s: float) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT: as local fields, but the position is a geodetic place."""
        local = self._local(place, fields.frame in OVER_HOME)
        self.stream_fields(dataclasses.replace(fields, is_global=True, position_m=local), now_s)

    def stream_attitude(self, fields: StreamedAttitude, now_s: float) -> None:
        self._take(self.profile.read_attitude(fields), now_s)

    def _take(self, wish: MotionSetpoint | AttitudeSetpoint | SetpointRefusal, now_s: float) -> None:
        if isinstance(wish, SetpointRefusal):
            self.commander.send_text(Severity.CRITICAL, wish.text)
        else:
            self.stream(wish, now_s)

    def stream(self, setpoint: MotionSetpoint | AttitudeSetpoint, now_s: float) -> None:
        """Take a streamed setpoint: stored always, flown in OFFBOARD or GUIDED only."""
        mode, moves = self.commander.mode, isinstance(setpoint, MotionSetpoint)
        if isinstance(setpoint, MotionSetpoint):
            setpoint = dataclasses.replace(setpoint, streamed=True)
        self._setpoint, self._setpoint_s = setpoint, now_s
        self.commander.situation.setpoint_age_s = 0.0
        if mode.by_attitude and moves:
            self.commander.begin(mode.task)
        elif mode.takes_setpoints and (mode.by_attitude or not self._cascade.landed):
            self.commander.begin(Task.SETPOINT)


def _is_place(place: Vector3) -> bool:
    """Latitude, longitude and altitude within their ranges; NaN means the present one."""
    return wrong_place(*(0.0 if isnan(value) else value for value in place)) is None
