"""The paper's 12-state quadrotor: dynamics, Jacobians, rotor speeds (eqs. 5-11).

Frame: here, and nowhere else, the paper's z-up world: x north, y west, z up; the body's axes forward, left
and up. State (x x' y y' z z' phi phi' theta theta' psi psi') in m, rad and seconds: `STATES` names the
columns. The angles are yaw, pitch, roll about z, y, x; their rates are the angles' own, so that phi' is
exactly the derivative of phi. Eqs. 6 take them for body rates besides, which is true for small angles.

Inputs U1 (N) along the body's up axis, U2, U3, U4 (N m) about its forward, left and up axes; by eq. 5 they
are a matrix times the rotor speeds' squares. The gyroscopic term's sign follows from
    I w' = U - w x (I w + h),   h = (0, 0, -J_TP Omega),   Omega = -W1 + W2 - W3 + W4:
it is +J_TP theta' Omega about x and -J_TP phi' Omega about y; the paper's text has plus in both.

Everything takes one state (12,) or many (N, 12) at once: a horizon is linearised in one sweep.
"""

import math
from pathlib import Path
from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Quaternion, Vector3, euler_from_quat
from companion.config import ConfigError, ModelConfig, VehicleConfig, find_file, load_model

STATES: Final = 12
INPUTS: Final = 4
# columns of the state
X, VX, Y, VY, Z, VZ, PHI, PHI_RATE, THETA, THETA_RATE, PSI, PSI_RATE = range(STATES)
POSITION: Final = [X, Y, Z]
VELOCITY: Final = [VX, VY, VZ]
ANGLES: Final = [PHI, THETA, PSI]
RATES: Final = [PHI_RATE, THETA_RATE, PSI_RATE]
SPIN: Final = np.array([-1.0, 1.0, -1.0, 1.0])
# a rotor that stands has no slope of speed over thrust: there the one at this share of full speed is taken
SLOWEST_SHARE: Final = 0.05


def flipped(v: Vector3) -> Vector3:
    """NED to the paper's axes, FRD to its body's, and back: both pairs differ by half a turn about x."""
    return (v[0], -v[1], -v[2])


def state_from_ned(
    position_ned_m: Vector3, velocity_ned_m_s: Vector3, attitude: Quaternion, rate_body_rad_s: Vector3
) -> FloatArray:
    """The paper's state (12,) of a vehicle given in NED and FRD; its pitch is short of 90 degrees."""
    position, velocity = flipped(position_ned_m), flipped(velocity_ned_m_s)
    phi, theta, psi = flipped(euler_from_quat(attitude))
    p, q, r = flipped(rate_body_rad_s)
    turning = q * math.sin(phi) + r * math.cos(phi)
    rates = (
        p + math.tan(theta) * turning,
        q * math.cos(phi) - r * math.sin(phi),
        turning / math.cos(theta),
    )
    state = np.empty(STATES)
    state[POSITION], state[VELOCITY] = position, velocity
    state[ANGLES], state[RATES] = (phi, theta, psi), rates
    return state


class QuadrotorModel:
    """One airframe's eqs. 5-11. Holds parameters only."""

    def __init__(self, model: ModelConfig) -> None:
        self.config = model
        self.mass_kg = model.mass_kg
        self.inertia_kg_m2 = np.array(model.inertia_kg_m2)
        ix, iy, iz = model.inertia_kg_m2
        self._coupling = ((iy - iz) / ix, (iz - ix) / iy, (ix - iy) / iz)
        self._gyro = (model.rotor_inertia_kg_m2 / ix, -model.rotor_inertia_kg_m2 / iy)
        self.mixing = mixing_matrix(model)
        self._unmixing: FloatArray = np.linalg.inv(self.mixing).astype(np.float64)
        self.hover = np.array([model.mass_kg * GRAVITY_M_S2, 0.0, 0.0, 0.0])
        self.full_rotor_thrust_n = model.thrust_coefficient_n_s2 * model.max_rotor_speed_rad_s**2
        # rotor thrusts (4) = thrusts_from_inputs @ U
        self.thrusts_from_inputs: FloatArray = model.thrust_coefficient_n_s2 * self._unmixing

    # ------------------------------------------------------------ eq. 5

    def rotor_speeds(self, inputs: FloatArray) -> FloatArray:
        """Rotor speeds (..., 4) rad/s that give U (..., 4), each within 0 and the fastest."""
        squares = inputs @ self._unmixing.T
        speeds: FloatArray = np.sqrt(np.clip(squares, 0.0, self.config.max_rotor_speed_rad_s**2))
        return speeds

    def inputs(self, rotor_speeds: FloatArray) -> FloatArray:
        """U (..., 4) of rotor speeds (..., 4) rad/s (eq. 5)."""
        found: FloatArray = rotor_speeds**2 @ self.mixing.T
        return found

    # ------------------------------------------------------------ eqs. 6-8

    def derivative(self, state: FloatArray, inputs: FloatArray) -> FloatArray:
        """F(X, U) of eqs. 7 and 8: (..., 12) for states (..., 12) and inputs (..., 4)."""
        phi, theta, psi = state[..., PHI], state[..., THETA], state[..., PSI]
        p, q, r = state[..., PHI_RATE], state[..., THETA_RATE], state[..., PSI_RATE]
        sf, cf, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
        sp, cp = np.sin(psi), np.cos(psi)
        lift = inputs[..., 0] / self.mass_kg
        omega = self.rotor_speeds(inputs) @ SPIN
        ix, iy, iz = self.inertia_kg_m2
        jx, jy, jz = self._coupling
        hx, hy = self._gyro
        slope = np.empty((*np.broadcast_shapes(state.shape[:-1], inputs.shape[:-1]), STATES))
        slope[..., POSITION] = state[..., VELOCITY]
        slope[..., ANGLES] = state[..., RATES]
        slope[..., VX] = (sp * sf + cp * st * cf) * lift
        slope[..., VY] = (-cp * sf + sp * st * cf) * lift
        slope[..., VZ] = ct * cf * lift - GRAVITY_M_S2
        slope[..., PHI_RATE] = jx * q * r + hx * q * omega + inputs[..., 1] / ix
        slope[..., THETA_RATE] = jy * p * r + hy * p * omega + inputs[..., 2] / iy
        slope[..., PSI_RATE] = jz * p * q + inputs[..., 3] / iz
        return slope

    # ------------------------------------------------------------ eqs. 9-11

    def jacobians(self, state: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A = dF/dX (..., 12, 12) and B = dF/dU (..., 12, 4) at states (..., 12) and inputs (..., 4)."""
        shape = state.shape[:-1]
        A, B = np.zeros((*shape, STATES, STATES)), np.zeros((*shape, STATES, INPUTS))
        A[..., POSITION, VELOCITY] = 1.0
        A[..., ANGLES, RATES] = 1.0
        self._translation(A, B, state, inputs[..., 0] / self.mass_kg)
        self._rotation(A, B, state, inputs)
        return A, B

    def _translation(self, A: FloatArray, B: FloatArray, state: FloatArray, lift: FloatArray) -> None:
        phi, theta, psi = state[..., PHI], state[..., THETA], state[..., PSI]
        sf, cf, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
        sp, cp = np.sin(psi), np.cos(psi)
        x, y, z = sp * sf + cp * st * cf, -cp * sf + sp * st * cf, ct * cf
        A[..., VX, PHI] = (sp * cf - cp * st * sf) * lift
        A[..., VX, THETA] = cp * ct * cf * lift
        A[..., VX, PSI] = -y * lift
        A[..., VY, PHI] = (-cp * cf - sp * st * sf) * lift
        A[..., VY, THETA] = sp * ct * cf * lift
        A[..., VY, PSI] = x * lift
        A[..., VZ, PHI] = -ct * sf * lift
        A[..., VZ, THETA] = -st * cf * lift
        for row, along in ((VX, x), (VY, y), (VZ, z)):
            B[..., row, 0] = along / self.mass_kg

    def _rotation(self, A: FloatArray, B: FloatArray, state: FloatArray, inputs: FloatArray) -> None:
        p, q, r = state[..., PHI_RATE], state[..., THETA_RATE], state[..., PSI_RATE]
        jx, jy, jz = self._coupling
        hx, hy = self._gyro
        speeds = self.rotor_speeds(inputs)
        omega = speeds @ SPIN
        A[..., PHI_RATE, THETA_RATE] = jx * r + hx * omega
        A[..., PHI_RATE, PSI_RATE] = jx * q
        A[..., THETA_RATE, PHI_RATE] = jy * r + hy * omega
        A[..., THETA_RATE, PSI_RATE] = jy * p
        A[..., PSI_RATE, PHI_RATE] = jz * q
        A[..., PSI_RATE, THETA_RATE] = jz * p
        slowest = SLOWEST_SHARE * self.config.max_rotor_speed_rad_s
        # Omega's own slope over U, through the root of each rotor's speed
        bend = (0.5 * SPIN / np.maximum(speeds, slowest)) @ self._unmixing
        B[..., PHI_RATE, :] = hx * q[..., None] * bend
        B[..., THETA_RATE, :] = hy * p[..., None] * bend
        for row, column, inertia in zip(RATES, (1, 2, 3), self.inertia_kg_m2, strict=True):
            B[..., row, column] += 1.0 / inertia

    # ------------------------------------------------------------ steps

    def advance(self, state: FloatArray, inputs: FloatArray, step_s: float) -> FloatArray:
        """The states (..., 12) a step later under held inputs: one classical Runge-Kutta step."""
        a = self.derivative(state, inputs)
        b = self.derivative(state + 0.5 * step_s * a, inputs)
        c = self.derivative(state + 0.5 * step_s * b, inputs)
        d = self.derivative(state + step_s * c, inputs)
        after: FloatArray = state + (step_s / 6.0) * (a + 2.0 * (b + c) + d)
        return after

    def linearise(
        self, state: FloatArray, inputs: FloatArray, step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """A (..., 12, 12) and B (..., 12, 4) of one step under held inputs about a point.

        The matrix exponential's series to the fourth order: from a torque to a position it is four integrals,
        so that no shorter one has every entry.
        """
        A, B = self.jacobians(state, inputs)
        h, eye = step_s, np.eye(STATES)
        series = eye + A * (h / 4.0)
        series = eye + A @ series * (h / 3.0)
        series = eye + A @ series * (h / 2.0)
        return eye + h * (A @ series), h * (series @ B)


def load_quadrotor(vehicle: str | Path) -> QuadrotorModel:
    """The model of a vehicle given by name (in configs/vehicles) or path.

    Raises:
        ConfigError: the file cannot be read, or has no `model`.
    """
    path = find_file("vehicles", vehicle)
    config = load_model(VehicleConfig, path).model
    if config is None:
        raise ConfigError(f"{path}: model: expected the 12-state model's parameters, found none")
    return QuadrotorModel(config)


def mixing_matrix(model: ModelConfig) -> FloatArray:
    """Eq. 5 as a matrix (4, 4): U = mixing @ squares of the rotor speeds (rad²/s²).

    A "plus" gives the paper's rows. In an "x" the same ring is turned by 45 degrees, and every rotor has its
    share in both roll and pitch.
    """
    first = 0.0 if model.layout == "plus" else math.pi / 4.0
    around = first + 0.5 * math.pi * np.arange(4)
    forward, left = model.arm_length_m * np.cos(around), -model.arm_length_m * np.sin(around)
    b, d = model.thrust_coefficient_n_s2, model.torque_coefficient_n_m_s2
    return np.array([np.full(4, b), b * left, -b * forward, d * SPIN])


def structure() -> tuple[FloatArray, FloatArray]:
    """Which entries of a step's A (12, 12) and B (12, 4) can differ from zero, whatever the point."""
    A, B = np.eye(STATES, dtype=bool), np.zeros((STATES, INPUTS), dtype=bool)
    A[POSITION, VELOCITY] = A[ANGLES, RATES] = True
    for row in VELOCITY:
        A[row, ANGLES] = True
        B[row, 0] = True
    for row in RATES:
        A[row, RATES] = True
        B[row, 1:] = True
    B[RATES, 0] = True
    reach = np.linalg.matrix_power(A.astype(np.float64), 4)
    return reach, reach @ B


# ---------------------------------------------------------------- mixer
# U1..U4 to what each motor is commanded: eq. 5 backwards, within what the rotors can do.
#
# When a rotor would go beyond its range the thrust of all is shifted, since tilt matters more than height
# and yaw. The motors' lag is made up for in part: a command that is further off than the thrust wanted brings
# it there sooner.

Four = tuple[float, float, float, float]


class ThrustMixer:
    """One airframe's mixer; keeps what its motors are taken to give now.

    `flown`: U (4,) that they are taken to give on the mean over the period that the last command begins.
    """

    def __init__(self, model: QuadrotorModel, period_s: float, lead: float) -> None:
        """`lead`: 0 passes the thrust wanted on, 1 would have the motors there within a period."""
        self._shares_from_inputs = model.thrusts_from_inputs / model.full_rotor_thrust_n
        tau_s = model.config.motor_time_constant_s
        self._left = math.exp(-period_s / tau_s)
        self._mean_left = tau_s / period_s * (1.0 - self._left)
        self._inputs_from_shares = np.linalg.inv(self._shares_from_inputs)
        self.flown: FloatArray = model.hover.copy()
        self._gain = 1.0 + lead * (1.0 / (1.0 - self._left) - 1.0)
        self._flown: FloatArray = self._shares_from_inputs @ model.hover

    def step(self, inputs: FloatArray) -> Four:
        """Share of full thrust (0..1) to command of each motor for U (4,)."""
        wanted = _within_range(self._shares_from_inputs @ inputs)
        command = np.clip(self._flown + self._gain * (wanted - self._flown), 0.0, 1.0)
        behind = self._flown - command
        self.flown = self._inputs_from_shares @ (command + self._mean_left * behind)
        self._flown = command + self._left * behind
        a, b, c, d = command.tolist()
        return (a, b, c, d)


def _within_range(shares: FloatArray) -> FloatArray:
    low, high = float(shares.min()), float(shares.max())
    if high - low <= 1.0:
        shares = shares - max(high - 1.0, 0.0) - min(low, 0.0)
    clipped: FloatArray = np.clip(shares, 0.0, 1.0)
    return clipped
