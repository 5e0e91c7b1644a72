"""ArduPilot's precision landing on LANDING_TARGET (AC_PrecLand and ModeLand of 4.6), in its main features.

A constant-velocity filter estimates the target relative to the vehicle in local NED, delayed by PLND_LAG. Its
inputs are the vector to the target in body axes and the changes of the vehicle's velocity. The target's
velocity is fed forward if PLND_OPTIONS allows moving targets, its acceleration never is. The vehicle descends
at LAND_SPEED within PLND_XY_DIST_MAX, at half that or less between 2 and 0.35 m. After a target loss it
waits, then returns to where it last saw the target, at most PLND_RET_MAX times. Parameters are read at boot.
Without a range finder the height over home replaces the measured height. SI units.
"""

import math
from collections import deque
from math import nan

from companion.base.geometry import Vector3, norm, quat_rotate, scale
from sitl.autopilot.control.setpoints import MotionSetpoint
from sitl.autopilot.flight.modes import Severity
from sitl.autopilot.flight.profile import (
    LandingTarget,
    LandingTargetFrame,
    Parameters,
    PrecisionLanding,
    VehicleEstimate,
)

_MAVLINK_TYPE = 1
_MOVING_OPTION = 1
_RAW = 0
_FRESH_S = 2.0
_EARLY_S = 1e-6
_LOOP_S = 0.0025  # the real filter's pace, which its noise is given for
_VELOCITY_VAR = 4.0
_SURPRISING = 3.0
_REJECTS_BEFORE_TAKING = 3
_SLOW_BAND_M = (0.35, 2.0)
_SLOWEST_M_S = 0.10
_ACCEPTABLE_M = 0.15
_BACK_WITHIN_M = 0.5
_VERY_STRICT, _NOT_STRICT = 2, 0


class AxisFilter:
    """Position and velocity of the target relative to the vehicle along one axis."""

    def __init__(self, position_m: float, velocity_m_s: float, position_var: float, velocity_var: float):
        self.position_m = position_m
        self.velocity_m_s = velocity_m_s
        self._pp, self._pv, self._vv = position_var, 0.0, velocity_var

    def predict(self, dt_s: float, own_change_m_s: float, velocity_var: float) -> None:
        """Predict by dt; the vehicle's velocity changes by the given amount, the target's by noise."""
        self.position_m += (self.velocity_m_s - 0.5 * own_change_m_s) * dt_s
        self.velocity_m_s -= own_change_m_s
        self._pp += dt_s * (2.0 * self._pv + dt_s * self._vv)
        self._pv += dt_s * self._vv
        self._vv += velocity_var

    def surprise(self, position_m: float, variance: float) -> float:
        """Normalised innovation squared of a measurement."""
        return (position_m - self.position_m) ** 2 / (self._pp + variance)

    def fuse(self, position_m: float, variance: float) -> None:
        innovation, total = position_m - self.position_m, self._pp + variance
        gain_p, gain_v = self._pp / total, self._pv / total
        self.position_m += gain_p * innovation
        self.velocity_m_s += gain_v * innovation
        self._vv -= gain_v * self._pv
        self._pv -= gain_v * self._pp
        self._pp -= gain_p * self._pp


def direction_from_angles(angles_rad: tuple[float, float]) -> Vector3 | None:
    """Unit vector (FRD) to a target seen by a downward camera; None when it is not below."""
    right, backwards = angles_rad
    if not (abs(right) < 1.5 and abs(backwards) < 1.5):
        return None
    x, y = -math.tan(backwards), math.tan(right)
    length = math.sqrt(x * x + y * y + 1.0)
    return (x / length, y / length, 1.0 / length)


class ArdupilotPrecisionLanding(PrecisionLanding):
    """Precision landing between two boots."""

    def __init__(self, parameters: Parameters) -> None:
        super().__init__()
        self._moves = bool(int(parameters["PLND_OPTIONS"]) & _MOVING_OPTION)
        self._raw = int(parameters["PLND_EST_TYPE"]) == _RAW
        self._noise_m_s2 = parameters["PLND_ACC_P_NSE"]
        self._lag_s = parameters["PLND_LAG"]
        self._furthest_m = parameters["PLND_XY_DIST_MAX"]
        self._strict = int(parameters["PLND_STRICT"])
        self._most_retries = int(parameters["PLND_RET_MAX"])
        self._timeout_s = parameters["PLND_TIMEOUT"]
        self._lowest_retry_m = parameters["PLND_ALT_MIN"]
        self._estimates: deque[VehicleEstimate] = deque()
        self._then: VehicleEstimate | None = None
        self._axes: tuple[AxisFilter, AxisFilter] | None = None
        self._rejected = 0
        self._below_m = 0.0
        self.begin(required=False)

    def begin(self, *, required: bool) -> None:
        self._found = False
        self._retries = 0
        self._last_seen_at: Vector3 | None = None
        self._retrying = False

    # ------------------------------------------------------------ the target

    def watch(self, estimate: VehicleEstimate, dt_s: float) -> None:
        """Predict, and fuse a new measurement, at the time of PLND_LAG ago."""
        self._estimates.append(estimate)
        before, then = self._then, self._estimates[0]
        while (
            len(self._estimates) > 1 and self._estimates[1].now_s <= estimate.now_s - self._lag_s + _EARLY_S
        ):
            self._estimates.popleft()
            then = self._estimates[0]
        self._then = then
        if estimate.now_s - self._seen_s > _FRESH_S:
            self._axes = None
        if self._axes is not None and before is not None:
            noise = self._noise_m_s2 * self._noise_m_s2 * _LOOP_S * dt_s
            for index, axis in enumerate(self._axes):
                change = then.velocity_ned_m_s[index] - before.velocity_ned_m_s[index]
                axis.predict(then.now_s - before.now_s, change, noise)
        if self._pending is not None:
            target, self._pending = self._pending, None
            self._fuse(target, estimate, then)

    def _fuse(self, target: LandingTarget, estimate: VehicleEstimate, then: VehicleEstimate) -> None:
        body = self._vector(target, then.height_m)
        if body is None:
            return
        away = quat_rotate(then.attitude, body)
        if away[2] <= 0.0:
            return
        variance = (away[2] * 0.01 + 0.02) ** 2
        self._below_m, self._seen_s = away[2], estimate.now_s
        self._last_seen_at = estimate.position_ned_m
        if self._axes is None or self._raw:
            (north, east, _), (vn, ve, _) = away, then.velocity_ned_m_s
            self._axes = (
                AxisFilter(north, -vn, variance, _VELOCITY_VAR),
                AxisFilter(east, -ve, variance, _VELOCITY_VAR),
            )
            return
        pairs = list(zip(self._axes, away, strict=False))
        surprising = max(axis.surprise(measured, variance) for axis, measured in pairs) > _SURPRISING
        if surprising and self._rejected < _REJECTS_BEFORE_TAKING:
            self._rejected += 1
            return
        self._rejected = 0
        for axis, measured in pairs:
            axis.fuse(measured, variance)

    def _now(
        self, axes: tuple[AxisFilter, AxisFilter], estimate: VehicleEstimate, dt_s: float
    ) -> tuple[Vector3, Vector3]:
        """Position and velocity of the target now in local NED, from the state of PLND_LAG ago."""
        then = self._estimates[0]
        place, speed = [], []
        for index, axis in enumerate(axes):
            own = sum(later.velocity_ned_m_s[index] for later in list(self._estimates)[1:]) * dt_s
            speed.append(axis.velocity_m_s + then.velocity_ned_m_s[index])
            moved = speed[index] * (estimate.now_s - then.now_s)
            place.append(estimate.position_ned_m[index] + axis.position_m + moved - own)
        return (place[0], place[1], nan), (speed[0], speed[1], nan)

    def _vector(self, target: LandingTarget, height_m: float) -> Vector3 | None:
        """The target from the vehicle in body axes (m)."""
        if target.position_m is None:
            unit = direction_from_angles(target.angles_rad)
        elif target.frame != LandingTargetFrame.BODY_FRD:
            self._report_frame(Severity.INFO, "Plnd: Frame not supported")
            return None
        else:
            length = norm(target.position_m)
            unit = scale(target.position_m, 1.0 / length) if length > 0.01 else None
        if unit is None or unit[2] <= 0.0:
            return None
        distance = target.distance_m if target.distance_m > 0.0 else max(height_m, 0.0) / unit[2]
        return scale(unit, distance)

    # ------------------------------------------------------------ the landing

    def fly(self, estimate: VehicleEstimate, dt_s: float) -> MotionSetpoint | None:
        """Descend over the target. After a target loss: wait, retry, and finally give up."""
        if self._axes is None or estimate.now_s - self._seen_s > _FRESH_S:
            return self._without(estimate)
        if not self._found:
            self.texts.append((Severity.INFO, "PrecLand: Target Found"))
        self._found, self._retrying = True, False
        (north, east, _), velocity = self._now(self._axes, estimate, dt_s)
        speed = velocity[:2] if self._moves and not self._raw else (0.0, 0.0)
        error = math.hypot(north - estimate.position_ned_m[0], east - estimate.position_ned_m[1])
        return MotionSetpoint((north, east, nan), (*speed, self._sink(error, estimate.landing_speed_m_s)))

    def _sink(self, error_m: float, landing_speed_m_s: float) -> float:
        if error_m > self._furthest_m > 0.0:
            return 0.0
        low, high = _SLOW_BAND_M
        if not low < self._below_m < high:
            return landing_speed_m_s
        half = 0.5 * landing_speed_m_s
        return max(_SLOWEST_M_S, half - error_m * half / _ACCEPTABLE_M)

    def _without(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        lost = self._found and estimate.height_m > self._lowest_retry_m
        if not self._found or not lost or self._strict == _NOT_STRICT:
            return self._give_up(estimate) if self._strict == _VERY_STRICT else None
        waiting = estimate.now_s - self._seen_s < _FRESH_S + self._timeout_s
        if waiting or self._last_seen_at is None:
            return MotionSetpoint(velocity_ned_m_s=(0.0, 0.0, 0.0))
        if not self._retrying:
            if self._retries >= self._most_retries:
                return self._give_up(estimate)
            self._retries += 1
            self._retrying = True
            self.texts.append((Severity.INFO, "PrecLand: Retrying"))
        if math.dist(self._last_seen_at, estimate.position_ned_m) < _BACK_WITHIN_M:
            # arrived, no target: wait once more
            self._retrying, self._seen_s = False, estimate.now_s - _FRESH_S
        return MotionSetpoint(self._last_seen_at)

    def _give_up(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        """Land at the present position, or hover if PLND_STRICT is 2."""
        return MotionSetpoint(velocity_ned_m_s=(0.0, 0.0, 0.0)) if self._strict == _VERY_STRICT else None


def precision_landing(parameters: Parameters) -> ArdupilotPrecisionLanding | None:
    enabled = parameters["PLND_ENABLED"] >= 1.0 and int(parameters["PLND_TYPE"]) == _MAVLINK_TYPE
    return ArdupilotPrecisionLanding(parameters) if enabled else None
