"""Closed loop for the control tests: a vehicle under an autopilot, a pad that moves, and the controller.

The plant differs from the controller's model on purpose: other lag, other gains, an integral, biased velocity
estimates, wind. It is written from the description of autopilots, not from the controller's code.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    FloatArray,
    Vector3,
    add,
    quat_conjugate,
    quat_rotate,
    scale,
    side_force,
    subtract,
)
from companion.base.messages import (
    ControlReport,
    PadState,
    Phase,
    PlanStep,
    Reference,
    Setpoint,
    VehicleState,
)
from companion.config import ControlConfig, VehicleConfig
from companion.control.controller import Controller
from tests.unit.control.control_vehicles import (
    AttitudeAutopilot,
    PointMass,
    SwayingAutopilot,
    VelocityAutopilot,
)

PHYSICS_STEP_S = 0.004
LINK_DELAY_S = 0.04
HORIZON_ROWS = 24
ROW_STEP_S = 0.1

Motion3 = tuple[Vector3, Vector3, Vector3]
PadMotion = Callable[[float], Motion3]
Wind = Callable[[float], Vector3]


def vehicle_config(**changes: float) -> VehicleConfig:
    """An airframe like the shipped one."""
    values: dict[str, object] = {
        "name": "test",
        "camera_position_body_m": (0.03, 0.0, 0.08),
        "range_position_body_m": (-0.03, 0.0, 0.08),
        "leg_height_m": 0.18,
        "acceleration_time_constant_s": 0.11,
        "thrust_time_constant_s": 0.04,
        "hover_thrust": 0.5,
    }
    return VehicleConfig.model_validate(values | changes)


# ---------------------------------------------------------------- pads


def still(_time_s: float) -> Motion3:
    """A pad that does not move."""
    return ZERO3, ZERO3, ZERO3


def line(time_s: float) -> Motion3:
    """1 m/s to the north-east."""
    velocity = (math.sqrt(0.5), math.sqrt(0.5), 0.0)
    return scale(velocity, time_s), velocity, ZERO3


def circle(time_s: float) -> Motion3:
    """1.5 m/s on a circle of 5 m."""
    radius, w = 5.0, 0.3
    c, s = math.cos(w * time_s), math.sin(w * time_s)
    return (
        (radius * s, radius * (1.0 - c), 0.0),
        (radius * w * c, radius * w * s, 0.0),
        (-radius * w * w * s, radius * w * w * c, 0.0),
    )


def figure_eight(time_s: float) -> Motion3:
    """A figure of eight, 10 m by 5 m, 2 m/s where it is fastest."""
    a, b = 5.0, 2.5
    w = 2.0 / math.hypot(a, 2.0 * b)
    x, y = w * time_s, 2.0 * w * time_s
    return (
        (a * math.sin(x), b * math.sin(y), 0.0),
        (a * w * math.cos(x), 2.0 * b * w * math.cos(y), 0.0),
        (-a * w * w * math.sin(x), -4.0 * b * w * w * math.sin(y), 0.0),
    )


def heave(time_s: float) -> Motion3:
    """A pad that goes up and down by 0.2 m every 5 s."""
    h, w = 0.2, math.tau / 5.0
    return (
        (0.0, 0.0, h * math.sin(w * time_s)),
        (0.0, 0.0, h * w * math.cos(w * time_s)),
        (0.0, 0.0, -h * w * w * math.sin(w * time_s)),
    )


# ---------------------------------------------------------------- plans


def min_jerk_offset(start: Vector3, goal: Vector3, duration_s: float) -> Callable[[float], Motion3]:
    """Rest to rest along a quintic, then rest at the goal."""
    change = subtract(goal, start)

    def at(time_s: float) -> Motion3:
        t = min(max(time_s / duration_s, 0.0), 1.0)
        s = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
        ds = 30.0 * t * t * (1.0 - t) ** 2 / duration_s
        dds = 60.0 * t * (1.0 - 3.0 * t + 2.0 * t * t) / duration_s**2
        return add(start, scale(change, s)), scale(change, ds), scale(change, dds)

    return at


def reference_rows(
    now_s: float,
    motion: Callable[[float], Motion3],
    *,
    origin: str = "pad",
    heading_rad: float = 0.0,
    minimum_height_m: float | None = None,
) -> Reference:
    """A reference that follows `motion`."""
    rows = [motion(now_s + k * ROW_STEP_S) for k in range(HORIZON_ROWS)]
    position, velocity, acceleration = (np.array([row[i] for row in rows]) for i in range(3))
    return Reference(
        now_s,
        "pad" if origin == "pad" else "local",
        ROW_STEP_S,
        position,
        velocity,
        acceleration,
        heading_rad,
        minimum_height_m,
    )


# ---------------------------------------------------------------- the loop


@dataclass
class ControlFlight:
    """What happened: one row a control step."""

    time_s: list[float] = field(default_factory=list)
    offset_m: list[Vector3] = field(default_factory=list)
    wanted_m: list[Vector3] = field(default_factory=list)
    relative_velocity_m_s: list[Vector3] = field(default_factory=list)
    setpoints: list[Setpoint] = field(default_factory=list)
    reports: list[ControlReport] = field(default_factory=list)
    acceleration_m_s2: list[Vector3] = field(default_factory=list)

    def error_m(self, after_s: float) -> FloatArray:
        """Offset minus reference (n, 3) from a time on."""
        keep = np.array(self.time_s) >= after_s
        error: FloatArray = (np.array(self.offset_m) - np.array(self.wanted_m))[keep]
        return error

    def lateral_error_m(self, after_s: float) -> float:
        """Greatest horizontal error from a time on."""
        return float(np.hypot(*self.error_m(after_s)[:, :2].T).max())


@dataclass
class Loop:
    """Flies `controller` on `autopilot` over `pad` along `offset` (the vehicle minus the pad)."""

    controller: Controller
    autopilot: VelocityAutopilot | AttitudeAutopilot | SwayingAutopilot
    pad: PadMotion
    offset: Callable[[float], Motion3]
    wind: Wind = lambda _t: ZERO3
    control_period_s: float = 1.0 / 30.0
    velocity_bias: Vector3 = (0.03, -0.02, 0.01)
    acceleration_bias: Vector3 = (0.08, -0.05, 0.05)
    noise: float = 1.0
    minimum_height_m: float | None = None
    seed: int = 1
    link_delay_s: float = LINK_DELAY_S
    # what is told of the acceleration: its low-pass filter, and its age besides
    sensor_lag_s: float = 0.0
    sensor_delay_s: float = 0.0
    # how old the pad's estimate is by then, at least and at most; in between at random
    pad_age_s: tuple[float, float] = (0.0, 0.0)

    def fly(self, duration_s: float) -> ControlFlight:
        rng = np.random.default_rng(self.seed)
        start = self.offset(0.0)[0]
        pad = self.pad(0.0)
        vehicle = PointMass(add(pad[0], start), pad[1])
        self._seen: deque[tuple[float, Vector3, Vector3, Motion3]] = deque(maxlen=64)
        length = 1 + round(self.sensor_delay_s / PHYSICS_STEP_S)
        self._shown: deque[Vector3] = deque([ZERO3], maxlen=length)
        self._pushed: deque[Vector3] = deque([ZERO3], maxlen=length)
        flight, pending = ControlFlight(), deque[tuple[float, Setpoint]]()
        current = self._resting(vehicle)
        steps, control_s = round(duration_s / PHYSICS_STEP_S), 0.0
        for i in range(steps):
            now_s = i * PHYSICS_STEP_S
            if now_s >= control_s - 1e-9:
                control_s += self.control_period_s
                setpoint = self._control(vehicle, now_s, rng, flight)
                pending.append((now_s + self.link_delay_s, setpoint))
            while pending and pending[0][0] <= now_s:
                current = pending.popleft()[1]
            force = self.autopilot.force(vehicle, current, now_s, PHYSICS_STEP_S)
            vehicle.move(force, self.wind(now_s), PHYSICS_STEP_S)
            self._sense(vehicle)
        return flight

    def _sense(self, vehicle: PointMass) -> None:
        share = PHYSICS_STEP_S / (PHYSICS_STEP_S + self.sensor_lag_s)
        felt = subtract(add(vehicle.acceleration, self.acceleration_bias), (0.0, 0.0, GRAVITY_M_S2))
        pushed = side_force(vehicle.attitude, quat_rotate(quat_conjugate(vehicle.attitude), felt))
        for shown, value in ((self._shown, vehicle.acceleration), (self._pushed, pushed)):
            shown.append(add(shown[-1], scale(subtract(value, shown[-1]), share)))

    def _resting(self, vehicle: PointMass) -> Setpoint:
        if isinstance(self.autopilot, AttitudeAutopilot):
            return Setpoint(0.0, attitude=IDENTITY, thrust=0.5)
        return Setpoint(0.0, velocity_ned_m_s=vehicle.velocity)

    def _control(
        self, vehicle: PointMass, now_s: float, rng: np.random.Generator, flight: ControlFlight
    ) -> Setpoint:
        pad = self.pad(now_s)
        noise = rng.normal(0.0, self.noise, 9)
        velocity = add(add(vehicle.velocity, self.velocity_bias), tuple(0.01 * noise[:3]))
        state = VehicleState(
            time_s=now_s,
            attitude=vehicle.attitude,
            rate_body_rad_s=ZERO3,
            position_ned_m=add(vehicle.position, (0.4, -0.3, 0.2)),
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=add(add(self._shown[0], self.acceleration_bias), tuple(0.06 * noise[6:9])),
            gyro_bias_rad_s=ZERO3,
            accel_bias_m_s2=ZERO3,
            attitude_std_rad=0.01,
            velocity_std_m_s=0.05,
            position_std_m=0.5,
            aligned=True,
            has_gps=True,
            side_force_ned_m_s2=add(self._pushed[0], (0.06 * float(noise[6]), 0.06 * float(noise[7]), 0.0)),
        )
        self._seen.append((now_s, vehicle.position, vehicle.velocity, pad))
        age_s = float(rng.uniform(*self.pad_age_s)) if self.pad_age_s[1] else 0.0
        seen_s, place, speed, pad_then = next(
            (seen for seen in reversed(self._seen) if seen[0] <= now_s - age_s + 1e-9), self._seen[0]
        )
        relative_velocity = add(subtract(pad_then[1], speed), tuple(0.01 * noise[3:6]))
        pad_state = PadState(
            time_s=seen_s,
            relative_position_ned_m=add(subtract(pad_then[0], place), tuple(0.003 * noise[6:9])),
            relative_velocity_ned_m_s=relative_velocity,
            velocity_ned_m_s=add(add(speed, self.velocity_bias), relative_velocity),
            acceleration_ned_m_s2=pad_then[2],
            heading_rad=0.0,
            heading_rate_rad_s=0.0,
            position_std_m=0.01,
            velocity_std_m_s=0.02,
            seen_time_s=seen_s - 0.05,
        )
        reference = reference_rows(now_s, self.offset, minimum_height_m=self.minimum_height_m)
        answer = self.controller.step(PlanStep(now_s, Phase.DESCEND, reference), state, pad_state, now_s)
        assert answer is not None
        setpoint, report = answer
        flight.time_s.append(now_s)
        flight.offset_m.append(subtract(vehicle.position, pad[0]))
        flight.wanted_m.append(self.offset(now_s)[0])
        flight.relative_velocity_m_s.append(subtract(vehicle.velocity, pad[1]))
        flight.setpoints.append(setpoint)
        flight.reports.append(report)
        flight.acceleration_m_s2.append(vehicle.acceleration)
        return setpoint


def controller(stopwatch: Callable[[], float] | None = None, **changes: object) -> Controller:
    """A controller with the default settings, changed as asked."""
    return Controller(ControlConfig.model_validate(changes), vehicle_config(), stopwatch)
