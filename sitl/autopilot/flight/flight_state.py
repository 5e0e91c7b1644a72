"""The parts of one autopilot, its public state, and what a reboot resets.

Its NED frame, height and heading have the errors of `estimator`. SI units.
"""

from __future__ import annotations

import math
from math import inf
from typing import Literal

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import (
    Quaternion,
    Vector3,
    geodetic_from_ned,
    ned_from_geodetic,
    subtract,
)
from companion.base.messages import LandedState
from sitl.autopilot.ardupilot.profile import ARDUPILOT
from sitl.autopilot.control.airframe import Airframe, hover_thrust
from sitl.autopilot.control.cascade import STOPPED, Cascade
from sitl.autopilot.control.estimator import EstimatorErrors, SimulatedEstimator
from sitl.autopilot.control.mixer import Motors
from sitl.autopilot.control.rate_control import RateGains
from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.commander import Commander, Text
from sitl.autopilot.flight.fence import Fence
from sitl.autopilot.flight.manual_control import ManualControl
from sitl.autopilot.flight.mission import MissionRunner
from sitl.autopilot.flight.mission_items import ItemFrame, MissionCommand, MissionItem, MissionStore
from sitl.autopilot.flight.modes import CommandResult, Mode, StickMode, Task
from sitl.autopilot.flight.navigator import Navigator
from sitl.autopilot.flight.parameters import Parameters
from sitl.autopilot.flight.profile import AutopilotProfile, setpoints_stopped
from sitl.autopilot.flight.sticks import RcInput
from sitl.autopilot.px4.profile import PX4
from sitl.vehicle.battery import Battery

RefusedRequest = Literal["arm", "take_off", "offboard", "land", "disarm", "auto_disarm"]
_CEILING, _CIRCLE = 1, 2  # bits of an autopilot's own fences
PROFILES: dict[AutopilotKind, AutopilotProfile] = {"px4": PX4, "ardupilot": ARDUPILOT}


class FlightState:
    """One autopilot on one airframe.

    `home` is latitude (deg), longitude (deg), altitude (m) of the origin of the SITL's NED.
    """

    def __init__(
        self,
        profile: AutopilotKind,
        airframe: Airframe,
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
        self._motors: Motors = STOPPED
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
        self._commander = Commander(self.profile)
        self._navigator = Navigator(self.profile, self.parameters)
        self._cascade = Cascade(self.profile, self._airframe, self._rates)
        self._runner = MissionRunner(
            self.mission, self._navigator, self.parameters, self.profile.parameter_map, self._local
        )
        self._precision_landing = self.profile.precision_landing(self.parameters)
        self._manual_control = ManualControl(self.profile, self.parameters, hover_thrust(self._airframe))
        self._outer_due_s = -inf
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
    def intended_mode_number(self) -> int:
        """CURRENT_MODE's intended_custom_mode: what is flown again once a failsafe that left it is over."""
        return self._commander.intended_mode.custom_mode

    @property
    def task(self) -> Task:
        """What is being flown."""
        return self._commander.task

    @property
    def obeys_setpoints(self) -> bool:
        """It flies a streamed setpoint whose time is not up."""
        now = self._commander.situation
        return self.task is Task.SETPOINT and now.setpoint_age_s <= now.setpoint_timeout_s

    @property
    def aligned(self) -> bool:
        """The estimator knows attitude and position."""
        return self._commander.situation.aligned

    @property
    def home_set(self) -> bool:
        """Home is set, even if the position is not yet known."""
        return self._commander.situation.home_set

    @property
    def ready_to_arm(self) -> bool:
        """What SYS_STATUS reports as the pre-arm check: level, and what the mode needs is there.

        That is a known position, and for PX4's OFFBOARD setpoints that keep coming.
        """
        now, mode = self._commander.situation, self._commander.mode
        needs_position = mode.sticks in (None, StickMode.VELOCITY)
        known = now.aligned if needs_position else now.home_set
        if self.profile.external_needs_setpoints and setpoints_stopped(now):
            return False
        return known and (now.tilt_rad < math.radians(20.0) or not now.landed)

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
    def fence_enabled(self) -> bool:
        """There is a fence, and it is switched on."""
        switch = self.profile.parameter_map.fence_enabled
        present = bool(self.fence.items) or bool(self._own_fences())
        return present and (switch is None or self.parameters.si(switch) != 0.0)

    @property
    def fence_broken(self) -> bool:
        """The vehicle is outside a fence that is switched on."""
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
        bounds = (
            (_CIRCLE, own.fence_radius, math.hypot(north, east)),
            (_CEILING, own.fence_ceiling, -down),
        )
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
        """The RC input."""
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
        speakers = (
            [self.mission.texts]
            if self._precision_landing is None
            else [self.mission.texts, self._precision_landing.texts]
        )
        texts = list(self._commander.texts)
        self._commander.texts.clear()
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
            return self.profile.refused_mode
        self._watch_mission()  # one received since the last step counts already
        return self._commander.change_mode(mode, number)

    def _watch_mission(self) -> None:
        if self._mission_version != self.mission.version:
            self._mission_version = self.mission.version
            now = self._commander.situation
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
        """Home as a mission's item 0."""
        latitude, longitude, altitude = self.geodetic(self.home_ned_m)
        parameters = (0.0, 0.0, 0.0, 0.0)
        return MissionItem(
            MissionCommand.WAYPOINT, ItemFrame.GLOBAL, parameters, latitude, longitude, altitude
        )
