"""How far the loop is from oscillating: its margins, from the very controller that flies.

The controller (with the MPC's answer free of constraints, the paper's recursion on the same weights) flies a
linear vehicle: the command is held over a period, reaches the tilt or the thrust after a dead time and at
second order, as identified, and integrates to velocity and place. Into what the vehicle gets, one period's
impulse is added that the controller does not know of. With D the impulse's transform and U that of what the
controller answers, the loop's transfer at the vehicle's input is L = -U / (D + U): observers, prediction
over the delay, gate and all, exactly as they run, sampled at `rate_hz`.

Along one axis, about hovering over a pad at rest. The pad filter's state is taken as true: it is carried by
the measured acceleration, so that a frame's age is no delay of this loop. SI units.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    FloatArray,
    Vector3,
    horizontal_acceleration,
    quat_rotate,
)
from companion.base.messages import (
    PadState,
    Phase,
    PlanStep,
    Reference,
    Setpoint,
    VehicleState,
)
from companion.config import AxisResponse, ControlConfig, VehicleConfig
from companion.control.attitude import attitude_from_acceleration
from companion.control.controller import Controller
from companion.control.setpoints import resolved

STEPS_A_PERIOD: Final = 16
KICK_M_S2: Final = 0.5
BEFORE: Final = 3  # periods before the kick
SETTLING_S: Final = 40.0  # the slowest observer has forgotten by then
SIDEWAYS, DOWN = 0, 2
LOWEST_RAD_S: Final = 0.05
FREQUENCIES: Final = 2000


@dataclass(frozen=True)
class MarginCase:
    """A loop: settings, whose autopilot, the axis, the response, and how far off the assumed one it is.

    `sensor_late_s`: the acceleration is measured so much later than the settings say.
    """

    control: ControlConfig
    vehicle: VehicleConfig
    autopilot_kind: AutopilotKind
    axis: int
    response: AxisResponse
    extra_delay_s: float = 0.0
    gain: float = 1.0
    sensor_late_s: float = 0.0


@dataclass(frozen=True)
class Margins:
    """The loop's margins: of phase, delay, and of gain either way (as factors).

    `crossover_rad_s` is the highest frequency at which the loop's gain is one.
    """

    phase_deg: float
    delay_s: float
    gain_up: float
    gain_down: float
    crossover_rad_s: float


class _Flown:
    """The linear vehicle along one axis: place, velocity, acceleration and its rate; and how it is sensed."""

    def __init__(self, case: MarginCase, period_s: float) -> None:
        step_s = period_s / STEPS_A_PERIOD
        response = self._response = case.response
        w, zeta = response.frequency_rad_s, response.damping
        F = np.zeros((5, 5))
        F[0, 1] = F[1, 2] = F[2, 3] = 1.0
        F[3, 2:5] = -w * w, -2.0 * zeta * w, case.gain * response.gain * w * w
        moved = scipy.linalg.expm(F * step_s)
        self._A, self._B = moved[:4, :4], moved[:4, 4]
        late = round((response.dead_time_s + case.extra_delay_s) / step_s)
        self._step_s, self._integral = step_s, 0.0
        self._line = deque([0.0] * (late + 1), maxlen=late + 1)
        self.state = np.zeros(4)
        self._felt_m_s2 = self._asked = 0.0
        self._shown = deque([0.0], maxlen=1 + round(case.sensor_late_s / step_s))
        self._share = -math.expm1(-step_s / case.control.acceleration_estimate_lag_s)

    @property
    def shown_m_s2(self) -> float:
        """The acceleration as it is measured."""
        return self._shown[0]

    def fly(self, acceleration_m_s2: float, velocity_m_s: float) -> float:
        """One period; returns what the setpoint asked for in it, the velocity that it flies left out."""
        gain, integral = self._response.velocity_gain_1_s, self._response.velocity_integral_1_s2
        asked = acceleration_m_s2 + gain * velocity_m_s
        for _ in range(STEPS_A_PERIOD):
            speed = float(self.state[1])
            self._line.append(asked - gain * speed + self._integral)
            self._integral += integral * (velocity_m_s - speed) * self._step_s
            self.state = self._A @ self.state + self._B * self._line[0]
            self._felt_m_s2 += self._share * (float(self.state[2]) - self._felt_m_s2)
            self._shown.append(self._felt_m_s2)
        self._asked += integral * velocity_m_s * self._step_s * STEPS_A_PERIOD
        return asked + self._asked


def respond(case: MarginCase, kicks_m_s2: FloatArray, *, controller: str = "riccati") -> FloatArray:
    """What the controller commands (n,) while `kicks_m_s2` (n,) are added unknown to it, from rest."""
    control = resolved(case.control, case.autopilot_kind).model_copy(update={"controller": controller})
    flying = Controller(control, case.vehicle, autopilot_kind=case.autopilot_kind)
    period_s = 1.0 / control.rate_hz
    flown = _Flown(case, period_s)
    answers = np.zeros(len(kicks_m_s2))
    for k, kick in enumerate(kicks_m_s2.tolist()):
        state, pad = _sensed(flown, case.axis, k * period_s)
        answer = flying.step(_hover(k * period_s), state, pad, k * period_s)
        assert answer is not None
        acceleration, velocity = _asked(answer[0], case)
        answers[k] = flown.fly(acceleration + kick, velocity) - kick
    return answers


def loop_transfer(case: MarginCase) -> tuple[FloatArray, NDArray[np.complex128]]:
    """Frequencies (rad/s) up to half the rate, and the loop's transfer there."""
    period_s = 1.0 / case.control.rate_hz
    kicks = np.zeros(round(SETTLING_S / period_s))
    kicks[BEFORE] = KICK_M_S2
    answers = respond(case, kicks)[BEFORE:] / KICK_M_S2
    w = np.geomspace(LOWEST_RAD_S, math.pi / period_s, FREQUENCIES)
    U = np.exp(-1j * np.outer(w * period_s, np.arange(len(answers)))) @ answers
    return w, -U / (1.0 + U)


def margins(w: FloatArray, L: NDArray[np.complex128]) -> Margins:
    """Of a loop whose closed form is stable, from its transfer."""
    size, phase = np.abs(L), np.unwrap(np.angle(L))
    unity = np.flatnonzero(np.diff(np.sign(size - 1.0)))
    # lag that is left at each crossing, in (0, 2 pi): what a delay takes; phase may be lost either way
    left = np.mod(phase[unity] + math.pi, 2.0 * math.pi)
    across = np.flatnonzero(np.diff(np.floor((phase + math.pi) / (2.0 * math.pi))))
    up = [1.0 / size[k] for k in across if size[k] < 1.0]
    down = [size[k] for k in across if size[k] >= 1.0]
    return Margins(
        phase_deg=math.degrees(float(np.min(np.minimum(left, 2.0 * math.pi - left), initial=math.pi))),
        delay_s=float(np.min(left / w[unity], initial=math.inf)),
        gain_up=float(min(up, default=math.inf)),
        gain_down=float(min(down, default=math.inf)),
        crossover_rad_s=float(np.max(w[unity], initial=0.0)),
    )


def while_turning(
    w: FloatArray, L: NDArray[np.complex128], turn_rad_s: float, learning_s: float
) -> NDArray[np.complex128]:
    """The same loop over a pad that turns, with what `AdaptiveFeedforward` learns there.

    The plane is one complex number, so a frequency may be negative, against the turn: a loop of real
    numbers is mirrored there, and the margins are those of either `turn_rad_s` or its negative.
    """
    turned: NDArray[np.complex128] = L * (1.0 + 1.0 / (learning_s * 1j * (w - turn_rad_s)))
    return turned


def _hover(now_s: float) -> PlanStep:
    still = np.zeros((1, 3))
    return PlanStep(now_s, Phase.DESCEND, Reference(now_s, "pad", 1.0, still, still, still, 0.0))


def _asked(setpoint: Setpoint, case: MarginCase) -> tuple[float, float]:
    """The acceleration and the velocity along the axis that a setpoint asks for."""
    if setpoint.attitude is None or setpoint.thrust is None:
        return setpoint.acceleration_ned_m_s2[case.axis], setpoint.velocity_ned_m_s[case.axis]
    if case.axis != DOWN:
        return horizontal_acceleration(setpoint.attitude)[case.axis], 0.0
    force_m_s2 = setpoint.thrust / case.vehicle.hover_thrust * GRAVITY_M_S2
    return quat_rotate(setpoint.attitude, (0.0, 0.0, -force_m_s2))[2] + GRAVITY_M_S2, 0.0


def _sensed(flown: _Flown, axis: int, now_s: float) -> tuple[VehicleState, PadState]:
    def along(value: float) -> Vector3:
        return (value, 0.0, 0.0) if axis == SIDEWAYS else (0.0, 0.0, value)

    place, velocity, by_tilt, _ = flown.state.tolist()
    attitude = attitude_from_acceleration(along(by_tilt) if axis == SIDEWAYS else ZERO3, 0.0)
    vehicle = VehicleState(
        time_s=now_s,
        attitude=attitude,
        rate_body_rad_s=ZERO3,
        position_ned_m=along(place),
        velocity_ned_m_s=along(velocity),
        acceleration_ned_m_s2=along(flown.shown_m_s2),
        gyro_bias_rad_s=ZERO3,
        accel_bias_m_s2=ZERO3,
        attitude_std_rad=0.01,
        velocity_std_m_s=0.05,
        position_std_m=0.5,
        aligned=True,
        has_gps=True,
    )
    pad = PadState(
        time_s=now_s,
        relative_position_ned_m=along(-place),
        relative_velocity_ned_m_s=along(-velocity),
        velocity_ned_m_s=ZERO3,
        acceleration_ned_m_s2=ZERO3,
        heading_rad=0.0,
        heading_rate_rad_s=0.0,
        position_std_m=0.01,
        velocity_std_m_s=0.02,
        seen_time_s=now_s,
    )
    return vehicle, pad
