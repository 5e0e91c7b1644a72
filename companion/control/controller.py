"""One step of the control stage: plan and states to one setpoint (the paper's Algorithm 2).

All inputs are transformed to one frame for the tracker: NED axes that do not accelerate, with the origin at
the pad's estimated position (the EKF's origin for local references). The pad's own motion becomes part of
the reference. SI units.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import ZERO3, FloatArray, Vector3, add, scale, subtract, vector3, yaw_from_quat
from companion.base.messages import (
    IMU_PREDICTED_S,
    AutopilotSetup,
    ControlReport,
    LinkHealth,
    PadState,
    Phase,
    PlanStep,
    Reference,
    Setpoint,
    VehicleState,
)
from companion.base.motion import Motion
from companion.config import ControlConfig, VehicleConfig
from companion.control.adaptive_feedforward import AdaptiveFeedforward
from companion.control.limits import LimitsGate
from companion.control.mpc.target import make_target, stop_reference, within_reach
from companion.control.pad_prediction import PadPrediction, origin_at_rest, predict_pad
from companion.control.response.fitting import fitted
from companion.control.response.flight_model import advance, flown_kind, lags
from companion.control.response.plant import Plant
from companion.control.setpoints import (
    Heading,
    attitude_setpoint,
    blind_setpoint,
    blind_sink_m_s,
    boosted,
    ground_setpoint,
    resolved,
    stop_setpoint,
    tilt_compensation,
    velocity_setpoint,
)
from companion.control.solver_health import SolverHealth
from companion.control.thrust_guard import ThrustGuard
from companion.control.tracker import make_tracker
from companion.control.tracking import Target, TrackingSolution, needed_inputs

HEARD: Final = LinkHealth()

# a pause after which what was commanded before no longer says anything
RESTART_AFTER_S = 0.5


@dataclass(frozen=True, slots=True)
class _Start:
    """Where the tracker begins: the motion when the next command takes effect, and its frame's origin.

    `times_s` (N+1,) are the horizon's, of the app's clock.
    """

    times_s: FloatArray
    motion: Motion
    prediction: PadPrediction


class Controller:
    """Tracks the plan's reference.

    When a solve fails, the last plan is flown on, through the gate of limits as all else; after so many in a
    row, or when there is no last plan, the vehicle is stopped (`SolverHealth`) and each step begins anew:
    whatever was learnt or kept may be what went wrong.
    """

    def __init__(
        self,
        config: ControlConfig,
        vehicle: VehicleConfig,
        stopwatch: Callable[[], float] | None = None,
        autopilot_kind: AutopilotKind = "px4",
        setup: AutopilotSetup | None = None,
        measures_thrust: bool = False,
    ) -> None:
        """`autopilot_kind` is that of the autopilot that will obey, `setup` what its parameters say.

        `stopwatch` gives seconds, to bound the solver's. With `measures_thrust` no attitude leaves before
        the thrust that holds the vehicle has been measured in the air, and agrees with what was told.

        In virtual time it does not advance while the solver works: then iterations alone bound it.
        """
        self._own = config = resolved(config, autopilot_kind)  # whatever the autopilot says
        self._response = vehicle.responses.of(autopilot_kind, flown_kind(config))
        self._setup = setup
        self._config = config = fitted(config, self._response, setup)
        self._lags_s = lags(vehicle, config, autopilot_kind)
        self._stopwatch = stopwatch or (lambda: 0.0)
        self._tracker = make_tracker(config, self._lags_s, self._stopwatch)
        self._plant = Plant(config, vehicle, self._lags_s, autopilot_kind, measures_thrust=measures_thrust)
        self.thrust = ThrustGuard(self._plant, vehicle, measures=measures_thrust)
        self._gate = LimitsGate(config.limits)
        self._feedforward = AdaptiveFeedforward(config.horizontal)
        self._heading, self._turns_rad_s = Heading(0.0), math.radians(config.limits.heading_rate_deg_s)
        self._nodes_s: FloatArray = config.step_s * np.arange(config.horizon_steps + 1, dtype=np.float64)
        self._stepped_s: float | None = None
        self._asked_down_m_s2: float | None = None  # while thrust is taken away beside it
        self._flying = self._given_up = False
        self._health = SolverHealth(config.rate_hz)

    def fit(self, setup: AutopilotSetup) -> bool:
        """Keep within what the parameters of the autopilot say by now; returns whether the limits change.

        Then the tracker, which is made for its limits, is made anew, and the step starts again. What was
        learnt of the thrust stays.
        """
        if setup == self._setup:
            return False
        self._setup, before = setup, self._config.limits
        self._config = config = fitted(self._own, self._response, setup)
        if config.limits == before:
            return False
        self._tracker = make_tracker(config, self._lags_s, self._stopwatch)
        self._gate.bound_by(config.limits)
        self._flying = False
        return True

    def step(
        self,
        plan: PlanStep,
        vehicle: VehicleState | None,
        pad: PadState | None,
        now_s: float,
        *,
        obeyed: bool = True,
        link: LinkHealth = HEARD,
    ) -> tuple[Setpoint, ControlReport] | None:
        """The setpoint that leaves at `now_s`; None when the plan has no reference.

        Without an estimate of the vehicle none leaves either, but for the one that presses it onto the pad.
        `vehicle` and `pad` are the estimates carried to about now. A reference in the pad's frame without a
        pad is answered by a stop. While the autopilot does not obey setpoints yet (PX4 wants to receive some
        before it does), each step starts again from how the vehicle moves: what was asked for in vain
        explains nothing, and the take-over is without a jump. An autopilot that is silent may not hear us
        either, or may obey all the same: soon nothing is learnt from what it does, and once it is heard again
        after long, the step starts again too.
        """
        if plan.reference is None:
            self._stepped_s = None
            return None
        if vehicle is None:
            return self._rest(plan.reference, pad, now_s) if plan.on_ground else None
        elapsed_s = self._elapsed(vehicle, now_s)
        self._heading = self._heading.after(elapsed_s, plan.reference.heading_rad, self._turns_rad_s)
        if plan.on_ground:
            return self._rest(plan.reference, pad, now_s)
        heard_again = self._given_up and not link.gave_up_setpoints
        self._given_up = link.gave_up_setpoints
        if not obeyed:
            self._gate.reset()
        if not obeyed or heard_again:
            self._flying = False
        # then it flies on as it did, or with the pad that it sinks onto
        if vehicle.imu_age_s > IMU_PREDICTED_S:
            return self._wait_for_imu(plan, plan.reference, vehicle, pad, now_s, obeyed=obeyed)
        if self._flying and not self._stopped:
            # on the way down the air under the rotors is met like any other until the feet may carry
            sinks = float(plan.reference.velocity_m_s[0, 2]) > 0.0
            self._plant.observe(
                vehicle,
                elapsed_s,
                learns=link.fresh,
                feet_near=plan.feet_near,
                may_stand=plan.feet_near and (plan.unloading > 0.0 or not sinks),
                sinks=sinks,
            )
        else:
            self._begin(vehicle)
        return self._fly(plan, plan.reference, vehicle, pad, now_s, learns=link.fresh, obeyed=obeyed)

    def _elapsed(self, vehicle: VehicleState, now_s: float) -> float:
        """Time (s) since the last step; 0 after a pause, from which all starts again."""
        last_s, self._stepped_s = self._stepped_s, now_s
        if last_s is not None and 0.0 <= now_s - last_s < RESTART_AFTER_S:
            return now_s - last_s
        self._heading = Heading.at(yaw_from_quat(vehicle.attitude))
        self._gate.reset()
        self.thrust.reset()
        self._flying = False
        return 0.0

    def _begin(self, vehicle: VehicleState) -> None:
        self.thrust.begin()
        self._plant.begin(vehicle)
        self._tracker.reset()
        self._feedforward.reset()
        self._health.begin()
        self._asked_down_m_s2 = None
        self._flying = True

    def _wait_for_imu(
        self,
        plan: PlanStep,
        reference: Reference,
        vehicle: VehicleState,
        pad: PadState | None,
        now_s: float,
        *,
        obeyed: bool,
    ) -> tuple[Setpoint, ControlReport]:
        """Until IMU samples come again or the estimate is given up; its motion is unknown meanwhile.

        It keeps its velocity and height. Sinking onto a pad it goes on down, with the pad, which may turn.
        """
        plant, self._flying = self._plant, False
        sink_m_s = blind_sink_m_s(reference, pad) if plan.phase is Phase.TOUCHDOWN else None
        followed = pad if sink_m_s is not None and reference.origin == "pad" else None
        velocity = vehicle.velocity_ned_m_s if followed is None else followed.velocity_ned_m_s
        setpoint = blind_setpoint(
            now_s,
            self._config,
            (*velocity[:2], sink_m_s or 0.0),
            ZERO3 if followed is None else followed.acceleration_ned_m_s2,
            plant.mean_disturbance_ned_m_s2,
            self._heading,
        )
        setpoint, limited = self._gate.apply(_seen(setpoint, reference, pad), now_s)
        return setpoint, ControlReport(
            now_s,
            solved=False,
            iterations=0,
            solve_s=0.0,
            limited=limited,
            hover_thrust=plant.hover.value,
            blind=True,
            obeyed=obeyed,
        )

    def _rest(
        self, reference: Reference, pad: PadState | None, now_s: float
    ) -> tuple[Setpoint, ControlReport]:
        self._flying = False
        setpoint = ground_setpoint(now_s, self._config, pad, self._heading)
        setpoint, limited = self._gate.apply(_seen(setpoint, reference, pad), now_s, on_ground=True)
        return setpoint, ControlReport(now_s, solved=True, iterations=0, solve_s=0.0, limited=limited)

    def _fly(
        self,
        plan: PlanStep,
        reference: Reference,
        vehicle: VehicleState,
        pad: PadState | None,
        now_s: float,
        *,
        learns: bool,
        obeyed: bool,
    ) -> tuple[Setpoint, ControlReport]:
        if reference.origin == "pad" and pad is None:
            reference = stop_reference(now_s, vehicle.position_ned_m, reference.heading_rad)
        start = self._start(vehicle, pad if reference.origin == "pad" else None, now_s)
        planned_m_s = float(reference.velocity_m_s[0, 2] + start.prediction.velocity_m_s[0, 2])
        self.thrust.watch(vehicle.velocity_ned_m_s[2], planned_m_s, now_s)
        target = within_reach(
            make_target(reference, start.times_s, start.prediction, self._plant.hover.value),
            start.motion.position_m,
            self._config.horizontal_reach_m,
            self._config.vertical_reach_m,
        )
        pad_acceleration = vector3(start.prediction.acceleration_m_s2[0].tolist())
        missing = self._feedforward.missing_m_s2(pad_acceleration)
        disturbance = subtract(self._plant.disturbance_ahead_ned_m_s2, missing)
        began_s = self._stopwatch()
        last_input = self._plant.last_input(start.motion)
        if self._asked_down_m_s2 is not None:
            last_input = (*last_input[:2], self._asked_down_m_s2)
        solution = self._tracker.solve(start.motion, target, disturbance, last_input)
        # what is taken away for the feet to carry is none of the tracker's changes: it comes back at once
        self._asked_down_m_s2 = float(solution.inputs_m_s2[0, 2]) if plan.unloading > 0.0 else None
        solve_s = self._stopwatch() - began_s
        self._health.note(solution)
        if learns:
            self._learn(start, target, disturbance, solution)
        setpoint = _seen(self._setpoint(start.motion, solution, now_s), reference, pad)
        boost = self._boost(start.motion, solution)
        setpoint = boosted(setpoint, boost * (1.0 - plan.unloading))
        setpoint, limited = self._gate.apply(setpoint, now_s, pressed_m_s2=disturbance[2])
        self._plant.remember(boosted(setpoint, 1.0 / boost))
        predicted = solution.states[:, :3] - start.prediction.displacement_m[1:]
        return setpoint, ControlReport(
            now_s,
            solution.solved,
            solution.iterations,
            solve_s,
            limited,
            disturbance,
            predicted,
            late=solution.late,
            stopped=self._stopped,
            hover_thrust=self._plant.hover.value,
            cut_s=self._health.cut_s,
            failure=self.thrust.fault or self._health.failure(limited),
            short_of=self._health.short_of,
            obeyed=obeyed,
        )

    def _learn(self, start: _Start, target: Target, disturbance: Vector3, solution: TrackingSolution) -> None:
        """Learn from the feedback what of the pad's acceleration is not flown; not while a bound holds it.

        What is not flown for want of tilt or thrust, or of a vehicle that levels, is no lag and no scale.
        """
        if not solution.solved or solution.short_of or target.horizontal_bound_m_s2 is not None:
            return
        needed = needed_inputs(target, disturbance, self._lags_s, self._config.step_s)[0]
        effort = vector3((solution.inputs_m_s2[0] - needed).tolist())
        velocity = vector3(start.prediction.velocity_m_s[0].tolist())
        acceleration = vector3(start.prediction.acceleration_m_s2[0].tolist())
        self._feedforward.learn(effort, velocity, acceleration, 1.0 / self._config.rate_hz)

    @property
    def _stopped(self) -> bool:
        """Whether no plan is left that is worth flying, or none that thrust could fly."""
        return self._health.stopped or bool(self.thrust.fault)

    def _start(self, vehicle: VehicleState, pad: PadState | None, now_s: float) -> _Start:
        """The motion when the next command takes effect, from the newest estimate and what is under way."""
        effect_s = now_s + self._config.command_delay_s
        times_s: FloatArray = effect_s + self._nodes_s
        acceleration = self._plant.acceleration_ned_m_s2
        if pad is None:
            from_s, prediction = vehicle.time_s, origin_at_rest(len(times_s))
            motion = Motion(vehicle.position_ned_m, vehicle.velocity_ned_m_s, acceleration)
        else:
            from_s, prediction = pad.time_s, predict_pad(pad, times_s)
            # the frame begins where the pad was estimated: the vehicle is at minus its relative position
            velocity = subtract(pad.velocity_ned_m_s, pad.relative_velocity_ned_m_s)
            motion = Motion(scale(pad.relative_position_ned_m, -1.0), velocity, acceleration)
        return _Start(times_s, self._plant.carry(motion, from_s, effect_s), prediction)

    def _setpoint(self, motion: Motion, solution: TrackingSolution, now_s: float) -> Setpoint:
        plant, look = self._plant, self._heading
        if self._stopped:
            return stop_setpoint(now_s, look)
        u = vector3(solution.inputs_m_s2[0].tolist())
        if self._config.setpoint == "attitude":
            return attitude_setpoint(now_s, motion.velocity_m_s, u, plant.hover.value, look)
        return velocity_setpoint(
            now_s,
            self._config,
            motion=motion,
            input_ned_m_s2=u,
            disturbance_ned_m_s2=plant.disturbance_ned_m_s2,
            lasting_ned_m_s2=plant.lasting.lasting_ned_m_s2,
            lags_s=self._lags_s,
            gains_1_s=plant.gains_1_s,
            heading=look,
        )

    def _boost(self, motion: Motion, solution: TrackingSolution) -> float:
        """The thrust missing while the tilt lags; by velocity setpoints the autopilot chooses it."""
        if self._stopped or self._config.setpoint == "velocity":
            return 1.0
        asked, disturbance = vector3(solution.inputs_m_s2[0].tolist()), self._plant.disturbance_ned_m_s2
        period_s = 0.5 / self._config.rate_hz
        thrust = ZERO3
        if not self._plant.raises_thrust:
            flown = advance(motion, add(asked, disturbance), period_s, self._lags_s).acceleration_m_s2
            thrust = subtract(flown, disturbance)
        return tilt_compensation(thrust, asked, math.radians(self._config.limits.tilt_deg))


def _seen(setpoint: Setpoint, reference: Reference, pad: PadState | None) -> Setpoint:
    """Name the exposure by which the setpoint goes, when it goes by the pad."""
    if reference.origin != "pad" or pad is None:
        return setpoint
    return replace(setpoint, exposure_time_s=pad.seen_time_s)
