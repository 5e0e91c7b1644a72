"""A closed loop for the planner alone: a lagging double integrator, a fake autopilot and a pad that moves.

The vehicle follows the reference rows by feed-forward and PD with an acceleration lag of 0.2 s; the
autopilot flies take-off, waypoint, hold and land by itself and answers actions. The EKF's origin is put
aside and above home, so that whoever mixes frames misses the pad by metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from companion.base.geometry import ZERO3, Vector3, add, geodetic_from_ned, quat_from_euler
from companion.base.messages import (
    ActionKind,
    ActionResult,
    AutopilotState,
    CarriedPad,
    LandedState,
    LinkHealth,
    Notice,
    Order,
    PadBeacon,
    PadState,
    Phase,
    PlanStep,
    RangeSample,
    SourceComparison,
    VehicleState,
)
from companion.config import PlanConfig, VehicleConfig
from companion.plan.planner import PlanInputs, Planner
from companion.plan.speed.speed_table import load_table
from tests.unit.plan.pad_paths import Heading, Path, derivative
from tests.unit.plan.plan_autopilot import HOME, PlanAutopilot
from tests.unit.plan.plan_moves import mix, plus, toward

ORIGIN_NED_M = (0.8, -1.1, -2.3)  # the EKF's origin from home
ORIGIN = geodetic_from_ned(ORIGIN_NED_M, HOME)
LEG_M = 0.18
LAG_S = 0.2
STEP_S = 1.0 / 30.0
SUBSTEPS = 4
TABLE = load_table("landing")[0]
VEHICLE = VehicleConfig(
    name="test",
    camera_position_body_m=(0.03, 0.0, 0.08),
    range_position_body_m=(-0.03, 0.0, 0.08),
    leg_height_m=LEG_M,
    acceleration_time_constant_s=LAG_S,
    hover_thrust=0.5,
)


# ---------------------------------------------------------------- the loop


@dataclass
class PlanFlight:
    """What a run brought."""

    phases: list[tuple[float, Phase]] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    steps: list[PlanStep] = field(default_factory=list)
    heights_m: list[float] = field(default_factory=list)
    touch_s: float | None = None
    touch_lateral_m: float = math.nan
    touch_down_m_s: float = math.nan
    touch_across_m_s: float = math.nan
    end_s: float = 0.0

    @property
    def phase(self) -> Phase:
        return self.phases[-1][1] if self.phases else Phase.CONNECT

    def entered(self, phase: Phase) -> float:
        return next(t for t, p in self.phases if p is phase)

    def told(self, kind: str) -> list[str]:
        return [n.text for n in self.notices if n.kind == kind]


class PlanWorld:
    """Vehicle, pad, eyes and autopilot; `fly` runs the planner against them."""

    def __init__(
        self, pad: Path, heading: Heading = lambda _t: 0.4, config: PlanConfig | None = None
    ) -> None:
        self.pad, self.heading = pad, heading
        self.echo_m: float | None = None  # instead of the true one
        self.range_lost = False
        self.autopilot = PlanAutopilot()
        self.config = config or PlanConfig()
        self.planner = Planner(self.config, VEHICLE, 20, 0.1, TABLE)
        self.now_s = 0.0
        self.position: Vector3 = (0.0, 0.0, -LEG_M)
        self.velocity: Vector3 = ZERO3
        self.acceleration: Vector3 = ZERO3
        self.home: Callable[[float], Vector3 | None] = lambda _t: HOME
        self.blind: Callable[[float, float], bool] = lambda _t, _height: False
        self.frame_s = self.vision_s = 0.0  # between two frames, and what each takes
        self.noise_m = 0.0
        self.jolted: Callable[[float], bool] = lambda _t: False  # the IMU feels 4 m/s2 more, upward
        self.blind_drift_m_s = 0.0  # the believed pad falls so fast while unseen
        self.lie_m: Callable[[float], float] = lambda _t: 0.0  # the believed pad lies so much too low
        self.gust: Callable[[float], Vector3] = lambda _t: ZERO3
        self.beacon_after_s: float | None = None
        self.carried_off_m: Vector3 | None = None  # something carries the pad's estimate, and is off by this
        self.carried_std_m = 0.2
        self.vehicle_known, self.stop, self.tilt_rad = True, False, 0.0
        self.estimate_off_m: Vector3 = ZERO3  # the error of our estimate of the vehicle's position
        self.silent_from_s = math.inf  # the link
        self.order: Order | None = None  # given once
        self.camera_problem: str | None = None
        self.comparisons: tuple[SourceComparison, ...] = ()
        self.setup_problem = ""
        self.flight = PlanFlight()
        self.rng = np.random.default_rng(0)
        self._drift = np.zeros(3)
        self._pad_state: PadState | None = None
        self._heard: AutopilotState | None = None
        self._seen_s = -math.inf
        self._frames: list[tuple[float, Vector3, Vector3, Vector3]] = []  # under way
        self._results: list[ActionResult] = []  # some are still to come
        self._beacon: PadBeacon | None = None
        self._asked_s: float | None = None
        self._contact_s: float | None = None
        self.each: Callable[[PlanWorld, PlanStep], None] = lambda _w, _s: None

    def fly(self, seconds: float, until: Callable[[PlanWorld], bool] = lambda w: w.ended) -> PlanFlight:
        end_s = self.now_s + seconds
        while self.now_s < end_s and not until(self):
            self.cycle()
        self.flight.end_s = self.now_s
        return self.flight

    @property
    def ended(self) -> bool:
        return bool(self.flight.phases) and self.flight.phase in {Phase.LANDED, Phase.ABORT}

    def cycle(self) -> PlanStep:
        self._sense()
        inputs = self.inputs()
        self._results = [result for result in self._results if result not in inputs.results]
        self.order = None
        step = self.planner.step(inputs, self.now_s)
        flight = self.flight
        if not flight.phases or flight.phase is not step.phase:
            flight.phases.append((self.now_s, step.phase))
        flight.steps.append(step)
        flight.notices += step.notices
        flight.heights_m.append(self.pad(self.now_s)[2] - self.position[2])
        for action in step.actions:
            if action.kind is ActionKind.REQUEST_PAD_POSITION:
                self._asked_s = self.now_s
            result = self.autopilot.answer(action, self.position, self.now_s)
            if result is not None:
                self._results.append(result)
        self.each(self, step)
        for _ in range(SUBSTEPS):
            self._move(step, STEP_S / SUBSTEPS)
        return step

    def inputs(self) -> PlanInputs:
        return PlanInputs(
            vehicle=self._vehicle() if self.vehicle_known else None,
            pad=self._pad_state,
            autopilot=self._hear(),
            carried=self._carried(),
            beacon=self._beacon,
            range=self._echo(),
            results=tuple(filter(self._has_ended, self._results)),
            stop_requested=self.stop,
            order=self.order,
            camera_problem=self.camera_problem,
            comparisons=self.comparisons,
            setup_problem=self.setup_problem,
            link=LinkHealth(max(0.0, self.now_s - self.silent_from_s), keeps_setpoint_s=1.0),
        )

    # ------------------------------------------------------------ what the planner is told

    def _has_ended(self, result: ActionResult) -> bool:
        """Whether the link has told it: what is to arm the vehicle waits no longer once it is armed."""
        return result.time_s <= self.now_s or (result.kind is ActionKind.ARM and self.autopilot.armed)

    def _vehicle(self) -> VehicleState:
        p = add(self.position, self.estimate_off_m)
        return VehicleState(
            time_s=self.now_s,
            attitude=quat_from_euler(self.tilt_rad, 0.0, 1.2),
            rate_body_rad_s=ZERO3,
            position_ned_m=(p[0] - ORIGIN_NED_M[0], p[1] - ORIGIN_NED_M[1], p[2] - ORIGIN_NED_M[2]),
            velocity_ned_m_s=self.velocity,
            acceleration_ned_m_s2=add(self.acceleration, (0.0, 0.0, -4.0 * self.jolted(self.now_s))),
            gyro_bias_rad_s=ZERO3,
            accel_bias_m_s2=ZERO3,
            attitude_std_rad=0.01,
            velocity_std_m_s=0.05,
            position_std_m=0.5,
            aligned=self.now_s > 1.0,
            has_gps=self.now_s > 1.0,
            origin=ORIGIN,
        )

    def _hear(self) -> AutopilotState:
        """The autopilot's state; while the link is silent, as it was last heard."""
        if self._heard is None or self.now_s <= self.silent_from_s:
            self._heard = self._autopilot()
        return self._heard

    def _autopilot(self) -> AutopilotState:
        a = self.autopilot
        heard = AutopilotState(
            time_s=self.now_s,
            connected=a.connected,
            autopilot_kind="px4" if a.autopilot_kind == "px4" else "ardupilot",
            armed=a.armed,
            mode=a.mode,
            offboard=a.mode in {"OFFBOARD", "GUIDED"},
            ready_to_arm=self.now_s > a.ready_from_s,
            ekf_ready=self.now_s > a.ekf_ready_from_s,
            landed=a.landed,
            attitude=quat_from_euler(self.tilt_rad, 0.0, 1.2),
            attitude_time_s=self.now_s,
            global_position=geodetic_from_ned(self.position, HOME),
            home=self.home(self.now_s),
            battery_share=a.battery_share,
            status_time_s=self.now_s,
            round_trip_s=a.round_trip_s,
            round_trip_time_s=self.now_s,
            twin_time_s=min(self.now_s, a.twin_until_s),
            rival=a.rival,
            rival_time_s=-math.inf if a.rival is None else self.now_s,
        )
        return replace(heard, **dict.fromkeys(a.untold, -math.inf))  # type: ignore[arg-type]

    def _sense(self) -> None:
        pad = self.pad(self.now_s)
        velocity, acceleration = derivative(self.pad, self.now_s)
        height = pad[2] - self.position[2]
        aside = math.hypot(pad[0] - self.position[0], pad[1] - self.position[1])
        seen = height < 12.0 and aside < 0.1 + 0.44 * height and not self.blind(self.now_s, height)
        if seen and self.now_s - (self._frames[-1][0] if self._frames else self._seen_s) >= self.frame_s:
            self._frames.append((self.now_s, pad, velocity, acceleration))
        while self._frames and self.now_s - self._frames[0][0] >= self.vision_s:
            self._last = self._frames.pop(0)
            self._seen_s = self._last[0]
            self._drift += 0.2 * (self.noise_m * self.rng.standard_normal(3) - self._drift)
        if math.isfinite(self._seen_s):
            self._pad_state = self._believed(*self._last)
        after_s = self.beacon_after_s
        if after_s is not None and self._asked_s is not None and self.now_s - self._asked_s >= after_s:
            latitude, longitude, altitude = geodetic_from_ned(pad, HOME)
            self._beacon = PadBeacon(self.now_s, latitude, longitude, altitude, velocity, 1.5)
            self._asked_s = None

    def _carried(self) -> CarriedPad | None:
        off = self.carried_off_m
        if off is None:
            return None
        pad, (velocity, acceleration) = self.pad(self.now_s), derivative(self.pad, self.now_s)
        north, east, down = (p + o - q for p, o, q in zip(pad, off, self.position, strict=True))
        place = (north, east, down)
        return CarriedPad(self.now_s, place, velocity, acceleration, self.carried_std_m, self.now_s)

    def _believed(self, then_s: float, pad: Vector3, velocity: Vector3, acceleration: Vector3) -> PadState:
        """The pad as last seen, led on at its velocity, with the filter's noise."""
        lead_s = self.now_s - then_s
        relative = [p + v * lead_s - q for p, v, q in zip(pad, velocity, self.position, strict=True)]
        relative[2] += self.blind_drift_m_s * lead_s + self.lie_m(self.now_s)
        noisy = [r + n * (1.0 + 0.4 * abs(relative[2])) for r, n in zip(relative, self._drift, strict=True)]
        if lead_s > 0.0:
            velocity = (velocity[0], velocity[1], velocity[2] + self.blind_drift_m_s)
        relative_velocity = [a - b for a, b in zip(velocity, self.velocity, strict=True)]
        variances = (0.005**2 + (0.1 * lead_s) ** 2, 0.02**2)  # of place and velocity
        return PadState(
            time_s=self.now_s,
            relative_position_ned_m=(float(noisy[0]), float(noisy[1]), float(noisy[2])),
            relative_velocity_ned_m_s=(relative_velocity[0], relative_velocity[1], relative_velocity[2]),
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=acceleration,
            heading_rad=self.heading(self.now_s),
            heading_rate_rad_s=0.0,
            position_std_m=0.02,
            velocity_std_m_s=0.02,
            seen_time_s=self._seen_s,
            covariance=tuple(
                tuple((variances[row // 3] if row == column else 0.0) for column in range(6))
                for row in range(6)
            ),
        )

    def _echo(self) -> RangeSample | None:
        height = self.pad(self.now_s)[2] - self.position[2]
        if self.range_lost:
            return None
        if self.echo_m is not None:
            return RangeSample(self.now_s, self.echo_m)
        return RangeSample(self.now_s, height - 0.08) if height < 4.0 else None

    # ------------------------------------------------------------ what flies

    def _move(self, step: PlanStep, dt: float) -> None:
        wanted = self._wanted(step)
        gust = self.gust(self.now_s)
        k = dt / LAG_S
        self.acceleration = mix(self.acceleration, wanted, k)
        total = plus(self.acceleration, gust)
        self.velocity = plus(self.velocity, total, dt)
        self.position = plus(self.position, self.velocity, dt)
        self.now_s += dt
        self._meet_ground(step)

    def _wanted(self, step: PlanStep) -> Vector3:
        mode = self.autopilot.mode
        if not self.autopilot.armed or mode in {"HOLD", "STABILIZE"}:
            return (0.0, 0.0, 2.0)
        if mode in {"OFFBOARD", "GUIDED"} and step.reference is not None:
            return self._tracked(step)
        if mode == "POSCTL":
            return toward(self.position, self.velocity, self.position, 2.0)
        return toward(self.position, self.velocity, self.autopilot.target_ned_m, 4.0)

    def _tracked(self, step: PlanStep) -> Vector3:
        reference = step.reference
        assert reference is not None
        if step.on_ground:
            return (0.0, 0.0, 3.0)
        if reference.origin == "pad":
            assert self._pad_state is not None
            p = self._pad_state
            position = tuple(-x for x in p.relative_position_ned_m)
            velocity = tuple(-x for x in p.relative_velocity_ned_m_s)
            ahead: tuple[float, ...] = p.acceleration_ned_m_s2
        else:
            v = self._vehicle()
            position, velocity, ahead = v.position_ned_m, v.velocity_ned_m_s, ZERO3
        row = 2  # the acceleration asked for now is flown a lag later
        out = [
            float(reference.acceleration_m_s2[row, i])
            + ahead[i]
            + 3.0 * (float(reference.position_m[0, i]) - position[i])
            + 3.0 * (float(reference.velocity_m_s[0, i]) - velocity[i])
            for i in range(3)
        ]
        limit = 4.0
        return (max(-limit, min(limit, out[0])), max(-limit, min(limit, out[1])), max(-3.0, min(3.0, out[2])))

    def _meet_ground(self, step: PlanStep) -> None:
        pad = self.pad(self.now_s)
        aside = math.hypot(self.position[0] - pad[0], self.position[1] - pad[1])
        over = aside < 0.65
        surface = pad[2] if over else 0.0
        if self.position[2] >= surface - LEG_M:
            self._stand(step, pad if over else None, surface)
        else:
            self._contact_s = None
            self.autopilot.landed = LandedState.IN_AIR if self.autopilot.armed else LandedState.ON_GROUND

    def _stand(self, step: PlanStep, pad: Vector3 | None, surface: float) -> None:
        velocity = derivative(self.pad, self.now_s)[0] if pad is not None else ZERO3
        if self._contact_s is None:
            self._contact_s = self.now_s
            if pad is not None and self.flight.touch_s is None:
                self._score(pad, velocity)
        if self.velocity[2] >= velocity[2]:
            self.position = (self.position[0], self.position[1], surface - LEG_M)
            self.velocity = velocity
        pressed = not self.autopilot.armed or step.on_ground or self.autopilot.mode == "LAND"
        if pressed and not self.autopilot.doubts and self.now_s - self._contact_s > 1.0:
            self.autopilot.landed = LandedState.ON_GROUND
            if self.autopilot.mode == "LAND":
                self.autopilot.armed = False

    def _score(self, pad: Vector3, velocity: Vector3) -> None:
        f, v = self.flight, self.velocity
        f.touch_s = self.now_s
        f.touch_lateral_m = math.hypot(self.position[0] - pad[0], self.position[1] - pad[1])
        f.touch_down_m_s = v[2] - velocity[2]
        f.touch_across_m_s = math.hypot(v[0] - velocity[0], v[1] - velocity[1])
