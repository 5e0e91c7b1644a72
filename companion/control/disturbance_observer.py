"""The disturbances of the vehicle: what measures each, and at which bandwidth.

- Wind and drag sideways (`WindObserver`): the thrust lies along the up axis, so the accelerometer measures
  them across that axis. This needs no model of the autopilot and closes no loop through it.
- The remaining difference between the command and the acceleration (`SlowDisturbanceObserver`): the
  autopilot's attitude differs from ours, its integrals wind up, thrust differs from the model. This closes a
  loop through the autopilot's lag, so its bandwidth is low; `margins` computes how low.

NED axes, SI units.
"""

import math
from typing import Final

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    between,
    dot,
    horizontal_acceleration,
    norm,
    scale,
    subtract,
)
from companion.base.messages import VehicleState
from companion.control.response.flight_model import advance_axis

# the measured acceleration's bias (of attitude or accelerometer) shows in the velocity, at this bandwidth
BIAS_RAD_S: Final = 0.6
MAXIMUM_BIAS_M_S2: Final = 0.5  # 3 deg of attitude
# a larger surprise is a jump of the estimate (a fix came in), not of the vehicle
LARGEST_VELOCITY_INNOVATION_M_S: Final = 0.3
LARGEST_ACCELERATION_INNOVATION_M_S2: Final = 3.0  # and of the acceleration: a blow


class _Axis:
    """One axis: velocity, the measured acceleration's bias, what the commands alone make (now, and as late
    as it is measured), and what lasts besides."""

    def __init__(self, bandwidth_rad_s: float, velocity: float, made: float, lasting: float) -> None:
        self.bandwidth_rad_s = bandwidth_rad_s
        self.velocity = velocity
        self.made = self.delayed_response = made
        self.bias, self.lasting = 0.0, lasting

    def predict(self, wanted_m_s2: float, duration_s: float, tau_s: float, sensor_lag_s: float) -> None:
        _, gained, self.made = advance_axis((0.0, 0.0, self.made), wanted_m_s2, duration_s, tau_s)
        # over so short a time the mean is enough
        self.delayed_response += _share(duration_s / sensor_lag_s) * (
            gained / duration_s - self.delayed_response
        )

    def correct(
        self, velocity: float, acceleration: float, thrust: float, elapsed_s: float, bound: float
    ) -> None:
        jump = velocity - self.velocity - (acceleration - self.bias) * elapsed_s
        innovation = _clamp(jump, LARGEST_VELOCITY_INNOVATION_M_S)
        # both poles at the bandwidth; a jump is taken over as it is
        self.velocity = velocity - (1.0 - _share(2.0 * BIAS_RAD_S * elapsed_s)) * innovation
        self.bias = _clamp(self.bias - BIAS_RAD_S**2 * elapsed_s * innovation, MAXIMUM_BIAS_M_S2)
        left = thrust - self.bias - self.delayed_response - self.lasting
        fresh = _clamp(left, LARGEST_ACCELERATION_INNOVATION_M_S2)
        self.lasting = _clamp(self.lasting + _share(self.bandwidth_rad_s * elapsed_s) * fresh, bound)


class SlowDisturbanceObserver:
    """What lasts between the acceleration commanded and the one that the thrust makes."""

    def __init__(
        self, lags_s: Vector3, sensor_lag_s: float, maximum_m_s2: float, bandwidths_rad_s: Vector3
    ) -> None:
        """`lags_s` from command to acceleration; `bandwidths_rad_s`: how fast what lasts is trusted."""
        self._lags_s, self._sensor_lag_s = lags_s, sensor_lag_s
        self._maximum_m_s2 = maximum_m_s2
        self._bandwidths_rad_s = bandwidths_rad_s
        self.start(ZERO3, ZERO3)

    def start(
        self, velocity_ned_m_s: Vector3, made_ned_m_s2: Vector3, lasting_ned_m_s2: Vector3 = ZERO3
    ) -> None:
        """Start again from what the thrust makes by now, all as commanded, and an estimate of what lasts."""
        x, y, z = map(_Axis, self._bandwidths_rad_s, velocity_ned_m_s, made_ned_m_s2, lasting_ned_m_s2)
        self._axes = (x, y, z)
        self._free_down_m_s2 = z.lasting  # when nothing but air was under the feet

    @property
    def lasting_ned_m_s2(self) -> Vector3:
        """What lasts (m/s2, NED), each axis within the bound."""
        x, y, z = self._axes
        return (x.lasting, y.lasting, z.lasting)

    @property
    def bias_ned_m_s2(self) -> Vector3:
        """The measured acceleration's bias (m/s2, NED)."""
        x, y, z = self._axes
        return (x.bias, y.bias, z.bias)

    @property
    def made_ned_m_s2(self) -> Vector3:
        """What the commands alone make by now (m/s2, NED), by the model."""
        x, y, z = self._axes
        return (x.made, y.made, z.made)

    def predict(self, wanted_ned_m_s2: Vector3, duration_s: float) -> None:
        """Carry what the commands make on; `wanted_ned_m_s2` is in effect meanwhile."""
        if duration_s > 0.0:
            for axis, wanted, lag_s in zip(self._axes, wanted_ned_m_s2, self._lags_s, strict=True):
                axis.predict(wanted, duration_s, lag_s, self._sensor_lag_s)

    def correct(
        self,
        velocity: Vector3,
        acceleration: Vector3,
        thrust: Vector3,
        elapsed_s: float,
        *,
        feet_near: bool = False,
        may_stand: bool = False,
    ) -> None:
        """Take in measured velocity, acceleration and what the thrust made, as late as the acceleration.

        A measurement that is not finite is passed over. With `feet_near` it is not that of free air, and of a
        vehicle that `may_stand` no further lift is learnt.
        """
        before_m_s2 = self._axes[2].lasting
        if all(map(math.isfinite, (*velocity, *acceleration, *thrust))):
            for axis, v, a, f in zip(self._axes, velocity, acceleration, thrust, strict=True):
                axis.correct(v, a, f, elapsed_s, self._maximum_m_s2)
        down = self._axes[2]
        if may_stand:
            # a downdraught that was known may end: that it holds up less is no surface
            down.lasting = max(down.lasting, min(0.0, before_m_s2))
        if not feet_near:
            self._free_down_m_s2 = down.lasting

    def leave_surface(self) -> None:
        """Forget the lift that was learnt near a surface: it is gone with it."""
        down = self._axes[2]
        down.lasting = max(down.lasting, min(0.0, self._free_down_m_s2))

    def keep(self, velocity_ned_m_s: Vector3) -> None:
        """Keep what lasts: whether the commands are flown is not known."""
        if all(map(math.isfinite, velocity_ned_m_s)):
            for axis, velocity in zip(self._axes, velocity_ned_m_s, strict=True):
                axis.velocity = velocity

    @property
    def delayed_response_down_m_s2(self) -> float:
        """What the commands alone make along down (m/s2), as late as the acceleration is measured."""
        return self._axes[2].delayed_response

    def scale_thrust(self, factor: float) -> None:
        """The thrust that makes it all is worth so much more than was believed."""
        for axis, gravity in zip(self._axes, (0.0, 0.0, GRAVITY_M_S2), strict=True):
            axis.made = gravity + factor * (axis.made - gravity)
            axis.delayed_response = gravity + factor * (axis.delayed_response - gravity)


class WindObserver:
    """The air's disturbance sideways, wind and drag: the side force that the accelerometer feels. NED, m/s2.

    No attitude of one instant is set against an acceleration of another, so the vehicle's own manoeuvres,
    however late they are measured, are no wind. It is known late, and acted upon later still. What the wind
    does lasts, so its trend carries it on; the drag follows the vehicle's own velocity, which is known: over
    a pad that drives a circle it turns with it, and nothing that smooths would keep up.

    A turbulent wind's force is a random walk from a tenth of a second to some seconds. The sensor's noise
    moves the vehicle hardly less by a longer lag, the walk moves it more: the lag is as long as its own error
    stays half of the noise's, and spares the tilts that noise would ask for in calm air. The walk's density
    is learnt from the difference of two means: its mean square is density (T2 - T1)^2 / (2 (T1 + T2)), and
    the noise's own part in it noise (1 / 2 T1 + 1 / 2 T2 - 2 / (T1 + T2)). The drag (1/s) is learnt from the
    same difference against that of the velocity, walk and noise being its measurement's variance: nothing in
    gusts, to a tenth within a few changes of speed in calm air. None is known at first.
    """

    QUICKEST_S: Final = 0.03  # a cycle at 30 Hz
    SLOWEST_S: Final = 0.3  # a wind is followed at least so quickly; judged
    FIRST_WALK: Final = 0.3  # m2/s5, as on an x500 in 8 m/s of moderate turbulence
    WALK_MEMORY_S: Final = 10.0  # three of the slow mean's times
    TREND_TIMES: Final = 10.0  # the trend is smoothed in proportion
    MEAN_S: Final = 1.0  # of the two means (see above); judged
    SLOW_MEAN_S: Final = 3.0  # see above
    MOST_CHANGE_M_S2: Final = 1.0  # a steeper trend is a gust that is over before
    # 1/s: rotors' and body's is 0.1 to 0.5 on real multirotors, 1.0 in PX4's SIH
    FIRST_DRAG_STD: Final = 0.5

    def __init__(self, sensor_lag_s: float, maximum_m_s2: float) -> None:
        """`sensor_lag_s` is how late the side force is measured."""
        self._lag_s, self._maximum_m_s2 = sensor_lag_s, maximum_m_s2
        self._smoothing_s, self._walk, self._noise = self.QUICKEST_S, self.FIRST_WALK, 0.0
        self.drag_per_s, self._drag_variance = 0.0, self.FIRST_DRAG_STD**2
        self.mean_wind_ned_m_s2 = self._slow_wind_ned_m_s2 = ZERO3
        self._velocity_m_s = self._mean_velocity_m_s = self._slow_velocity_m_s = ZERO3
        self._known = False  # the mean of late, which outlives a start anew
        self.reset()

    def reset(self) -> None:
        """Start again, from the mean of late; without one the first measurement is taken as it is."""
        self._begun = False
        self.thrust_ned_m_s2: Vector3 = ZERO3
        self.late_thrust_ned_m_s2: Vector3 = ZERO3
        self._at_rest_ned_m_s2 = self._without_drag(self.mean_wind_ned_m_s2, self._mean_velocity_m_s)
        self._trend_ned_m_s3: Vector3 = ZERO3

    @property
    def wind_ned_m_s2(self) -> Vector3:
        """The air's part in the acceleration by now, wind and drag."""
        return self._with_drag(self._at_rest_ned_m_s2, self._velocity_m_s)

    def ahead_ned_m_s2(self, ahead_s: float) -> Vector3:
        """The same `ahead_s` from now, by the wind's trend and the vehicle's motion.

        What the wind is late by is added.
        """
        change = scale(self._trend_ned_m_s3, ahead_s + self._lag_s + self._smoothing_s)
        size = norm(change)
        change = scale(change, min(1.0, self.MOST_CHANGE_M_S2 / size) if size > 0.0 else 0.0)
        return self._with_drag(add(self._at_rest_ned_m_s2, change), self._velocity_at(ahead_s))

    def step(self, vehicle: VehicleState, elapsed_s: float) -> None:
        """Take in attitude, velocity, acceleration and side force, the last were `elapsed_s` ago.

        `thrust_ned_m_s2` is then what the tilt makes now, `late_thrust_ned_m_s2` what the thrust made when
        the acceleration was measured, and `wind_ned_m_s2` the air's part, with its mean of late beside it.
        Along down all of the acceleration is thrust.
        """
        (x, y, z), (a, b, _) = vehicle.acceleration_ned_m_s2, vehicle.side_force_ned_m_s2
        north, east, _ = vehicle.velocity_ned_m_s
        if not all(map(math.isfinite, (x, y, z, a, b, north, east, *vehicle.attitude))):
            return
        by_tilt, carried = horizontal_acceleration(vehicle.attitude), 1.0 - z / GRAVITY_M_S2
        self._move_on((north, east, 0.0), elapsed_s)
        self.thrust_ned_m_s2 = (by_tilt[0] * carried, by_tilt[1] * carried, z)
        self.late_thrust_ned_m_s2 = (x - a, y - b, z)
        bound, before = self._maximum_m_s2, self._at_rest_ned_m_s2
        felt = (_clamp(a, bound), _clamp(b, bound), 0.0)
        felt_at_m_s = self._velocity_at(-self._lag_s)
        smoothing = elapsed_s / self._smoothing_s if self._known else math.inf
        self._at_rest_ned_m_s2 = _follow(before, self._without_drag(felt, felt_at_m_s), smoothing)
        self._learn(felt, felt_at_m_s, vehicle.acceleration_density_m2_s3, elapsed_s)
        if elapsed_s > 0.0 and self._begun:
            slope = scale(subtract(self._at_rest_ned_m_s2, before), 1.0 / elapsed_s)
            smoothing = elapsed_s / (self.TREND_TIMES * self._smoothing_s)
            self._trend_ned_m_s3 = _follow(self._trend_ned_m_s3, slope, smoothing)
        self._begun = True

    def _move_on(self, velocity_m_s: Vector3, elapsed_s: float) -> None:
        """Take the velocity; a jump is the estimate's (a fix came in), and no drag comes of it."""
        jump = subtract(velocity_m_s, self._velocity_at(elapsed_s))
        self._velocity_m_s = velocity_m_s
        if self._begun and norm(jump) > LARGEST_VELOCITY_INNOVATION_M_S:
            self._at_rest_ned_m_s2 = self._without_drag(self._at_rest_ned_m_s2, jump)
            self._mean_velocity_m_s = add(self._mean_velocity_m_s, jump)
            self._slow_velocity_m_s = add(self._slow_velocity_m_s, jump)

    def _velocity_at(self, ahead_s: float) -> Vector3:
        """The vehicle's velocity sideways so long from now (m/s, NED), by tilt and air."""
        (vx, vy, _), (tx, ty, _), (wx, wy, _) = self._velocity_m_s, self.thrust_ned_m_s2, self.wind_ned_m_s2
        return (vx + (tx + wx) * ahead_s, vy + (ty + wy) * ahead_s, 0.0)

    def _with_drag(self, at_rest_m_s2: Vector3, velocity_m_s: Vector3) -> Vector3:
        (x, y, _), (vx, vy, _), drag_per_s = at_rest_m_s2, velocity_m_s, self.drag_per_s
        bound = self._maximum_m_s2
        return (_clamp(x - vx * drag_per_s, bound), _clamp(y - vy * drag_per_s, bound), 0.0)

    def _without_drag(self, moving_m_s2: Vector3, velocity_m_s: Vector3) -> Vector3:
        return add(moving_m_s2, scale(velocity_m_s, self.drag_per_s))

    def _learn(self, felt: Vector3, velocity: Vector3, density_m2_s3: float, elapsed_s: float) -> None:
        """The means, the noise, the walk and the lag that suits them, and the drag.

        A blow passes for noise for a while: it doubles in a second at most.
        """
        mean, slow = (elapsed_s / t if self._known else math.inf for t in (self.MEAN_S, self.SLOW_MEAN_S))
        self.mean_wind_ned_m_s2 = _follow(self.mean_wind_ned_m_s2, felt, mean)
        self._slow_wind_ned_m_s2 = _follow(self._slow_wind_ned_m_s2, felt, slow)
        self._mean_velocity_m_s = _follow(self._mean_velocity_m_s, velocity, mean)
        self._slow_velocity_m_s = _follow(self._slow_velocity_m_s, velocity, slow)
        self._known = True
        least = self.QUICKEST_S**2 * self.FIRST_WALK
        self._noise = min(density_m2_s3, max(self._noise, least) * 2.0**elapsed_s)
        changed = subtract(self._mean_velocity_m_s, self._slow_velocity_m_s)
        left = subtract(self.mean_wind_ned_m_s2, self._slow_wind_ned_m_s2)
        left = self._without_drag(left, changed)
        walk = dot(left, left) - self._noise / 3.0  # both axes'
        self._walk += _share(elapsed_s / self.WALK_MEMORY_S) * (walk - self._walk)
        suits_s = 0.5 * math.sqrt(self._noise / max(self._walk, least))
        self._smoothing_s = min(max(self.QUICKEST_S, suits_s), self.SLOWEST_S)
        # the differences are new after the means' times, half of them each
        news = 2.0 * elapsed_s / (self.MEAN_S + self.SLOW_MEAN_S)
        variance = 0.5 * (max(self._walk, least) + self._noise / 3.0)  # of one axis
        gain = self._drag_variance * news / (variance + self._drag_variance * dot(changed, changed) * news)
        before, learnt_per_s = self.drag_per_s, self.drag_per_s - gain * dot(left, changed)
        self.drag_per_s = min(max(0.0, learnt_per_s), 3.0 * self.FIRST_DRAG_STD)
        self._drag_variance *= 1.0 - gain * dot(changed, changed)
        # the force is the same; what of it is the wind's has changed
        others = scale(self._velocity_m_s, self.drag_per_s - before)
        self._at_rest_ned_m_s2 = add(self._at_rest_ned_m_s2, others)


def _follow(state: Vector3, measured: Vector3, exponent: float) -> Vector3:
    return between(state, measured, _share(exponent))


def _share(exponent: float) -> float:
    """How much of the way a first-order lag goes."""
    return -math.expm1(-exponent)


def _clamp(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
