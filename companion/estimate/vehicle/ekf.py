"""The vehicle's 31-state extended Kalman filter (Table 5, eq. 17): IMU, magnetometer, GPS, orientation.

Asynchronous: each input predicts to its own time and updates. The filter can be reset to any earlier
snapshot, which `gating.Timeline` uses for a late fix. NED and FRD, SI units, µT.

Between two steps of the IMU the state is constant: a fix is compared with the state extrapolated to its own
time.

The paper's 31 states keep their form. What else is estimated of the vehicle's sensors are states, too, each
in a filter of its own: scale and misalignment of the gyroscope in a yaw (3, `yaw_error`, correlated with the
31), the IMU's place with the air's force (6, `lever_arm`), the delay of the magnetometer (1, `field_mean`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.base.geometry import (
    EYE3,
    GRAVITY_M_S2,
    FloatArray,
    Quaternion,
    Vector3,
    euler_from_quat,
    matrix_from_quat,
    norm,
    quat_conjugate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    vector3,
)
from companion.config import EkfConfig
from companion.estimate.gating import Gate, normalised_innovation_squared
from companion.estimate.motion import misled_velocity_m_s
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf_inputs import (
    UNKNOWN_RAD,
    AttitudeStep,
    EkfInput,
    GpsStep,
    ImuStep,
    SecondAttitudeStep,
)
from companion.estimate.vehicle.ekf_start import MOVING_SPEED_M_S, InitialState
from companion.estimate.vehicle.ekf_state import FIXES, EkfSnapshot, EkfState
from companion.estimate.vehicle.fix_watch import LastFix
from companion.estimate.vehicle.gyro_bias_check import STRIDE_S, BiasStep
from companion.estimate.vehicle.imu_noise import StepNoise
from companion.estimate.vehicle.yaw_error import YawError

MAG_REFUSED_S: Final = 20.0  # magnetometer refused for so long: the heading's uncertainty grows
WRONG_HEADING_RAD: Final = math.radians(30.0)  # by so much
GPS_TIME_ERROR_S: Final = 0.05  # of a fix's time: a quarter of the interval at 5 Hz
# no fix for so long, or none that fits: the state has no GPS, and starts again from the next
GPS_TIMEOUT_S: Final = 2.0

STEP_STD_RAD_S: Final = math.radians(0.3)  # of a bias that a second gyroscope shows
SUSPECTED_BIAS_RAD_S: Final = math.radians(1.5)  # a step is of some 2 deg/s (decision 40)
SUSPECTED_TURN_RAD: Final = math.radians(2.0)  # by the time that fixes show it
LARGEST_CARRIED: Final = 0.02  # of a quaternion's component, by a late fix: 2 deg


class VehicleEkf(EkfState):
    """What each input does to the state."""

    def __init__(self, config: EkfConfig, antenna_body_m: Vector3, start: InitialState) -> None:
        super().__init__(config, start)
        self._antenna_body_m = antenna_body_m
        self._mag_gate_noise = config.mag_noise_ut**2 * EYE3

    def apply(self, time_s: float, item: EkfInput) -> None:
        """Take the input in: a step of the IMU moves the state to its time, a fix corrects it."""
        self._moved = model.EYE
        if isinstance(item, GpsStep):
            self._take_gps(time_s, item)
        elif isinstance(item, BiasStep):
            self._take_bias_step(item)
        elif isinstance(item, AttitudeStep):
            self._take_anchor(item)
        elif isinstance(item, SecondAttitudeStep):
            self._take_second(item)
        else:
            u = item.rate_body_rad_s, item.specific_force_body_m_s2
            self.predict(time_s, u, item.samples, self._shown_by_fixes(item.noise), item.span_s)
            self._take_measured(item)

    def _shown_by_fixes(self, noise: StepNoise) -> StepNoise:
        """Vibration says how much the force's mean may be off; fixes show whether it is.

        What they have shown lasts without them; at least it is off by what vibration usually leaves, as far
        as their velocities have shown that it does.
        """
        shown = min(noise.force_error_m_s2, self.fix_watch.force_error_m_s2)
        if self.time_s - self.gps_time_s > GPS_TIMEOUT_S:
            shown = max(shown, self.fix_watch.drift.share * noise.usual_force_error_m_s2)
        return noise._replace(force_error_m_s2=shown)

    def carried(
        self, base: EkfSnapshot, later: Sequence[EkfSnapshot], time_s: float, item: EkfInput
    ) -> list[EkfSnapshot] | None:
        """The states after a late fix and after all that is newer, from those without it.

        What the fix changes at its time moves on as errors do: x by a product of Jacobians, P on both sides.
        The gains of the newer inputs stay as they were, a little larger than they would have been: P is that
        of the estimate so made. None for a first fix, for one that turns the attitude by more than the
        Jacobians hold, while the attitude is suspect (the gains change), and when something newer has reset
        states or is a fix itself.
        """
        if not isinstance(item, GpsStep) or not base.has_position:
            return None
        if any(past.fix_watch != base.fix_watch for past in later):
            return None
        self.restore(base)
        self.apply(time_s, item)
        dx, dP = self.x - base.x, self.P - base.P
        if self.fix_watch.suspect(self.time_s) or np.abs(dx[model.QUATERNION]).max() > LARGEST_CARRIED:
            return None
        fixed = {kind: gate for kind, gate in self.gates.items() if kind in FIXES}
        after, since = [self.snapshot()], model.EYE
        for past in later:
            if (moved := past.moved) is None:
                return None
            since = moved @ since
            yaw_error = past.yaw_error.changed(base.yaw_error, after[0].yaw_error, since)
            after.append(self._changed(past, since @ dx, since @ dP @ since.T, yaw_error, fixed))
        return after

    def _changed(
        self,
        past: EkfSnapshot,
        dx: FloatArray,
        dP: FloatArray,
        yaw_error: YawError,
        gates: dict[str, Gate],
    ) -> EkfSnapshot:
        """A state that is newer than a late fix, with what has come of the fix's correction."""
        x = past.x + dx
        attitude = quat_normalise(model.quaternion_of(x))
        x[model.ATTITUDE] = (*attitude, *euler_from_quat(attitude))
        return past._replace(
            x=x,
            P=past.P + dP,
            gates={**past.gates, **gates},
            has_position=self.has_position,
            gps_time_s=self.gps_time_s,
            fix_watch=self.fix_watch,
            yaw_error=yaw_error,
        )

    # ------------------------------------------------------------ measurements

    def _take_measured(self, step: ImuStep) -> None:
        """What is known at the step's end. The samples themselves have driven the state: they are no
        measurement of it."""
        if step.field_body_ut is not None:
            self._take_field(step.field_body_ut)
        if step.attitude is not None:
            self._take_attitude(step.attitude, step.tilt_noise_rad, step.heading_noise_rad)
            if not self.has_position:
                self._take_zero(model.VELOCITY, self._config.unaided_speed_m_s)
        if step.still:
            self._take_zero(model.RATE, 0.002)
        if step.at_rest:
            self._take_zero(model.VELOCITY, 0.05)

    def _take_attitude(self, attitude: Quaternion, tilt_noise_rad: float, heading_noise_rad: float) -> None:
        expected = self.x[model.QUATERNION]
        measured, own = np.array(attitude), self.attitude
        if measured @ expected < 0.0:
            measured = -measured
        rotation = model.diagonal(tilt_noise_rad**2, tilt_noise_rad**2, heading_noise_rad**2)
        # a pre-filter's heading is the field's, which counts by itself; of one that is refused it tells
        # nothing either. While fixes hold the heading, a compass that keeps to one side is its own matter,
        # which the pre-filter cannot judge: a steel deck turns it so, within size and dip
        by_field = self.gates.get("mag", Gate()).accepted > 0
        counted_already = model.diagonal(0.0, 0.0, UNKNOWN_RAD**2 if by_field else 0.0)
        unjudged = model.diagonal(0.0, 0.0, UNKNOWN_RAD**2 if by_field and self._fixes_fit else 0.0)
        apart = rotation_vector_from_quat(quat_multiply(attitude, quat_conjugate(own)))
        root = np.linalg.cholesky(self.rotation_covariance() + rotation + unjudged)
        # along the quaternion's length there is nothing to learn: any noise that keeps R regular
        length = 1e-2 * (expected[:, None] * expected)
        gate_noise = model.attitude_covariance(own, rotation) + length
        R = model.attitude_covariance(own, rotation + counted_already) + length
        if self._update("orientation", measured - expected, model.EYE[model.QUATERNION], R, gate_noise):
            self.watch = self.watch.after(self.time_s, vector3(np.linalg.solve(root, apart)))
            self._handle_inconsistency(attitude, rotation, apart)
        elif self.gates["orientation"].shut_out(self.time_s, self._config.orientation_timeout_s):
            self._restart_attitude(attitude, rotation)

    @property
    def _fixes_fit(self) -> bool:
        return self.time_s - self.gps_time_s < GPS_TIMEOUT_S

    def _handle_inconsistency(self, attitude: Quaternion, rotation: FloatArray, apart: Vector3) -> None:
        """Doubt our attitude when the pre-filter's keeps to one side of it; then start again from that.

        Fixes that fit know the tilt better, the heading only where the velocity changes: while they come that
        alone is doubted, unless they refute the other (a steel deck turns a compass, within size and dip),
        and nothing started again.
        """
        if not self.watch.misfits:
            return
        if (fixes_fit := self._fixes_fit) and self.fix_watch.refutes(apart[2]):
            self.watch = self.watch.renewed()
            return
        if not self.watch.doubted_lately:
            self.watch = self.watch.renewed()._replace(doubted_s=self.time_s)
            tilt = 0.0 if fixes_fit else apart[0] ** 2 + apart[1] ** 2
            self._inflate_rotation(np.diag((tilt, tilt, apart[2] ** 2)))
        elif not fixes_fit:
            self._restart_attitude(attitude, rotation)

    def _restart_attitude(self, attitude: Quaternion, rotation: FloatArray) -> None:
        """Take the pre-filter's attitude; what has led away from it may be the gyroscope's bias."""
        self._start_attitude(attitude, rotation)
        self._suspect_bias()
        self.watch = self.watch.renewed()._replace(restarted_s=self.time_s)

    def _take_field(self, field_body_ut: Vector3) -> None:
        """Take the field (body, µT); one that turns where the gyroscope shows no turn counts little.

        What the state's covariance does not explain of the innovation is a disturbance. Its direction is
        unknown: a third of the square is its variance on an axis (covariance matching, Mehra, IEEE
        Transactions on Automatic Control 17, 1972).
        """
        expected, C = model.mag_model(self.x)
        innovation, east = np.array(field_body_ut) - expected, self._magnetic_east()
        x, y, z = (C @ self.P @ C.T).diagonal().tolist()
        explained = x + y + z
        disturbance_ut2 = max(float(innovation @ innovation) - explained, 0.0) / len(innovation)
        self._update("mag", innovation, C, self._mag_noise(east, disturbance_ut2), self._mag_gate_noise)
        gate = self.gates["mag"]
        if gate.shut_out(self.time_s, MAG_REFUSED_S):
            # a field that fits in size and dip for so long is right, and the heading wrong
            if not (self.fix_watch.refutes(WRONG_HEADING_RAD) and self.fix_watch.refutes(-WRONG_HEADING_RAD)):
                self._inflate_rotation(np.diag((0.0, 0.0, WRONG_HEADING_RAD**2)))
            self.gates = {**self.gates, "mag": gate.opened()}

    def _magnetic_east(self) -> FloatArray:
        """Unit vector (3,) in body axes, horizontal and square to the field: along it the heading shows."""
        north, east, _ = self.x[model.FIELD].tolist()
        size = math.hypot(north, east)
        return np.array(quat_rotate_inverse(self.attitude, (-east / size, north / size, 0.0)))

    def _mag_noise(self, east: FloatArray, disturbance_ut2: float) -> FloatArray:
        """R (3, 3) in µT² under a disturbance of this variance an axis; `east` (3,) is in body axes.

        A disturbance stays for its correlation time T: of f samples a second each has 2 T f times its
        variance, as white noise that errs as much over longer times (a Gauss-Markov process does).
        Indoors and near iron size and dip err by more than the tilt: a field shows the heading alone. All of
        it is noise in its own vertical plane, which gives none.
        """
        config = self._config
        alike = 2.0 * config.mag_wander_s * config.mag_rate_hz
        across = config.mag_noise_ut**2 + alike * disturbance_ut2
        field = self.x[model.FIELD]
        along = max(float(field @ field), across)
        return along * EYE3 - (along - across) * (east[:, None] * east)

    def _suspect_bias(self, for_s: float = 0.0) -> None:
        """The gyroscope's bias may have stepped. If it is known how long ago, the attitude has turned by as
        much as that makes since then, and what shows one of the two shows the other.
        """
        q, G = self.attitude, np.zeros((model.STATES, 3))
        turned = -for_s * model.quaternion_jacobian(q) @ matrix_from_quat(q)
        G[model.ATTITUDE] = np.vstack((turned, model.euler_jacobian(q) @ turned))
        G[model.GYRO_BIAS] = EYE3
        self.P = self.P + SUSPECTED_BIAS_RAD_S**2 * (G @ G.T)

    def _take_anchor(self, step: AttitudeStep) -> None:
        """Turn the attitude; what was measured with the wrong one has gone into the velocity."""
        tilt, heading = step.tilt_std_rad**2, step.heading_std_rad**2
        attitude = quat_normalise(quat_multiply(step.turn, self.attitude))
        self._start_attitude(attitude, np.diag((tilt, tilt, heading)))
        self._widen(model.VELOCITY, misled_velocity_m_s(rotation_vector_from_quat(step.turn)))

    def _take_second(self, step: SecondAttitudeStep) -> None:
        """Another attitude; all of it is refused when its heading or its horizon cannot be."""
        C = np.zeros((3, model.STATES))
        C[:, model.QUATERNION] = model.rotation_from_quaternion(self.attitude)
        R = np.diag((step.tilt_std_rad**2, step.tilt_std_rad**2, step.heading_std_rad**2))
        self._update("second_attitude", np.array(step.turn_rad), C, R, R)

    def _take_zero(self, states: slice, std: float) -> None:
        self._update("still", -self.x[states], model.EYE[states], std**2 * EYE3, None)

    def _take_gps(self, time_s: float, fix: GpsStep) -> None:
        later_s = time_s - self.time_s
        if not self.has_position:
            self._start_from(time_s, fix, keep_speed=False)
            return
        expected, C = model.gps_velocity_model(self.x, self._antenna_body_m, later_s)
        predicted = vector3(expected)
        # a fix whose time is off is off by what the vehicle's velocity has changed meanwhile
        lag = GPS_TIME_ERROR_S * self.x[model.ACCELERATION]
        R = np.diag(np.square(fix.velocity_std_m_s)) + np.outer(lag, lag)
        innovation = np.array(fix.velocity_ned_m_s) - expected
        self._watch_fix(innovation, C @ self.P @ C.T + R)
        R *= self.fix_watch.noise_factor
        fits = self._update("gps_velocity", innovation, C, R, R)
        expected, C = model.gps_position_model(self.x, self._antenna_body_m, later_s)
        # the error of a position drifts slowly: so many fixes in a row show no more than one
        alike = max(2.0 * self._config.gps_wander_s / max(time_s - self.gps_time_s, 0.05), 1.0)
        R = np.diag(np.square(fix.position_std_m))
        innovation = np.array(fix.position_ned_m) - expected
        fits &= self._update("gps_position", innovation, C, alike * R, R)
        if fits:
            self.gps_time_s = time_s
            self._watch_heading(time_s, fix, predicted, lag)
        if any(self.gates[kind].shut_out(time_s, GPS_TIMEOUT_S) for kind in FIXES):
            keep_speed = not self.gates["gps_velocity"].refused_in_a_row
            self._start_from(time_s, fix, keep_speed)

    def _watch_fix(self, innovation: FloatArray, S: FloatArray) -> None:
        test = normalised_innovation_squared(innovation, S) / len(innovation)
        self.fix_watch = self.fix_watch.after(vector3(innovation), test)
        gate = self.gates.get("gps_velocity", Gate())
        if self.fix_watch.suspicious(self.time_s, gate.refused_in_a_row):
            self._suspect_bias()
            self._inflate_rotation(SUSPECTED_TURN_RAD**2 * EYE3)
            # what a tilt that has grown so far at that rate has made of the velocity
            for_s = SUSPECTED_TURN_RAD / SUSPECTED_BIAS_RAD_S
            self._widen(model.VELOCITY, 0.5 * GRAVITY_M_S2 * SUSPECTED_TURN_RAD * for_s)
            self.fix_watch = self.fix_watch.suspected(self.time_s)

    def _watch_heading(self, time_s: float, fix: GpsStep, predicted_m_s: Vector3, lag: FloatArray) -> None:
        corrected, _ = model.gps_velocity_model(self.x, self._antenna_body_m, time_s - self.time_s)
        variance = float(np.mean(np.square(fix.velocity_std_m_s[:2]) + np.square(lag[:2])))
        last = LastFix(time_s, fix.velocity_ned_m_s, vector3(corrected))
        self.fix_watch = self.fix_watch.turned(last, predicted_m_s, variance, fix.usual_force_error_m_s2)

    def _take_bias_step(self, step: BiasStep) -> None:
        """Take the bias that a second gyroscope shows; what the old one has turned goes back with it."""
        self._suspect_bias(step.for_s)
        innovation = step.gyro_bias_rad_s - self.x[model.GYRO_BIAS]
        self._correct(innovation, model.EYE[model.GYRO_BIAS], STEP_STD_RAD_S**2 * EYE3)
        self._inflate_rotation((STRIDE_S * norm(vector3(innovation))) ** 2 * EYE3)

    def _start_from(self, time_s: float, fix: GpsStep, keep_speed: bool) -> None:
        """Take position and velocity from the fix alone: at first, or when the old ones proved wrong.

        A component of the velocity that the fix does not contain stays as it is; with keep_speed also one
        that it gives less accurately than the filter.
        """
        speed, own = self.x[model.VELOCITY], np.sqrt(self.P.diagonal()[model.VELOCITY])
        speed_known = np.less(
            fix.velocity_std_m_s, np.minimum(own, MOVING_SPEED_M_S) if keep_speed else MOVING_SPEED_M_S
        )
        place = np.subtract(fix.position_ned_m, quat_rotate(self.attitude, self._antenna_body_m))
        values = np.concatenate((place, np.where(speed_known, fix.velocity_ned_m_s, speed)))
        speed_variance = np.where(
            speed_known, np.square(fix.velocity_std_m_s), self.P.diagonal()[model.VELOCITY]
        )
        variance = np.concatenate((np.square(fix.position_std_m), speed_variance))
        self._set_anew(slice(model.POSITION.start, model.VELOCITY.stop), values, np.diag(variance))
        self.has_position, self.gps_time_s = True, time_s
        fresh = {kind: gate.opened() for kind, gate in self.gates.items() if kind in FIXES}
        self.gates = {**self.gates, **fresh}
