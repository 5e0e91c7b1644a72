"""The limits gate: no setpoint beyond these bounds is sent to the autopilot.

Every setpoint passes through `LimitsGate.apply`, which names each reduction for the log. A setpoint with
any number that is not finite becomes a hold: no velocity, no acceleration, the last heading. A horizontal
velocity that is not part of the setpoint has no bound, unless the vehicle exceeds the bound: then the
velocity is sent after all.

An attitude setpoint is bounded by the acceleration that it is to make: the attitude, and how its thrust is
scaled, follow from what is left of that, so that what is logged is what is sent. `control.limits.tilt_deg`
bounds its tilt, and one bound (jerk) the change of its acceleration and of g tan(tilt), the horizontal
acceleration that the tilt gives while height is held.

The horizontal part of every acceleration is bounded by g tan(tilt_deg), too. Without an attitude, a downward
acceleration beside it needs more tilt, which the MPC's own bounds exclude and this gate does not. The
acceleration that an autopilot's velocity loop adds to a velocity setpoint is not bounded here. NED and FRD,
SI units.
"""

import math

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    norm,
    scale,
    subtract,
    wrap_angle,
)
from companion.base.messages import Setpoint
from companion.config import LimitsConfig
from companion.control.attitude import attitude_from_acceleration, force_from_acceleration

# a pause that is longer counts as this: the command jumps no further, and no more is learnt
LONGEST_STEP_S = 0.2
# rounding alone is not a breach
ROUNDING = 1.0 + 1e-9


class LimitsGate:
    """Bounds setpoints. Remembers the last one, since some things may change only so fast."""

    def __init__(self, config: LimitsConfig) -> None:
        self._config = config
        self._by_tilt_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(config.tilt_deg))
        self.reset()

    def reset(self) -> None:
        """Start again: the next setpoint is bounded in size, and in change from nothing."""
        self._last: Setpoint | None = None
        self._flown = ZERO3  # of the last one's acceleration

    def apply(
        self,
        setpoint: Setpoint,
        now_s: float,
        *,
        on_ground: bool = False,
        pressed_m_s2: float = 0.0,
        share: float = 1.0,
    ) -> tuple[Setpoint, tuple[str, ...]]:
        """The setpoint within all bounds, stamped `now_s`, and the names of the bounds that it broke.

        `on_ground` lifts the least thrust, and the bound on acceleration downwards: there no thrust at all is
        what shows the autopilot that it has landed. What presses it down by `pressed_m_s2` may be met beyond
        the bound on vertical acceleration. `share` scales the thrust of what is flown: for a tilt that lags,
        and for feet that carry the rest. That, and what presses a standing vehicle down, is not flown: the
        bound on change goes by what is.

        The stamp never runs backwards. After a `reset` nothing is known to have been sent, and the bounds on
        change (jerk, heading rate) do not apply to the first setpoint.
        """
        broken: list[str] = []
        time_s, step_s = self._time(now_s, broken)
        if not _finite(setpoint):
            broken.append("not_finite")
            setpoint = self._stop(setpoint)
        heading = self._heading(setpoint.heading_rad, step_s, broken)
        bound = self._config.vertical_acceleration_m_s2
        down = -bound - max(0.0, pressed_m_s2), GRAVITY_M_S2 if on_ground else bound
        flown = self._within_bounds(setpoint, down, broken)
        if not on_ground:
            flown = self._slewed(flown, step_s, broken, by_attitude=setpoint.attitude is not None)
        x, y, z = flown
        z += (1.0 - share) * (GRAVITY_M_S2 - z)
        attitude, thrust = setpoint.attitude, setpoint.thrust
        if attitude is None:
            z = _between(z, *down, "vertical_acceleration", broken)
        else:
            attitude, x, y = attitude_from_acceleration(flown, heading), share * x, share * y
        if thrust is not None:
            asked = force_from_acceleration(setpoint.acceleration_ned_m_s2)
            thrust *= share * norm(force_from_acceleration(flown)) / norm(asked)
        self._flown = ZERO3 if on_ground else flown
        limited = Setpoint(
            time_s=time_s,
            velocity_ned_m_s=self._velocity(setpoint.velocity_ned_m_s, broken),
            acceleration_ned_m_s2=(x, y, z),
            heading_rad=heading,
            heading_rate_rad_s=self._heading_rate(setpoint.heading_rate_rad_s, broken),
            attitude=attitude,
            thrust=self._thrust(thrust, on_ground, broken),
            exposure_time_s=setpoint.exposure_time_s,
            holds_horizontal_velocity=setpoint.holds_horizontal_velocity or "horizontal_speed" in broken,
        )
        self._last = limited
        return limited, tuple(dict.fromkeys(broken))

    def _time(self, now_s: float, broken: list[str]) -> tuple[float, float]:
        if self._last is None:
            return (now_s, LONGEST_STEP_S) if math.isfinite(now_s) else (0.0, LONGEST_STEP_S)
        if not now_s >= self._last.time_s:  # NaN as well
            broken.append("time")
            return self._last.time_s, 0.0
        return now_s, min(now_s - self._last.time_s, LONGEST_STEP_S)

    def _stop(self, setpoint: Setpoint) -> Setpoint:
        heading = self._last.heading_rad if self._last else setpoint.heading_rad
        return Setpoint(time_s=0.0, heading_rad=heading if math.isfinite(heading) else 0.0)

    def _velocity(self, velocity: Vector3, broken: list[str]) -> Vector3:
        x, y = _within(
            velocity[0], velocity[1], self._config.horizontal_speed_m_s, "horizontal_speed", broken
        )
        low, high = -self._config.climb_speed_m_s, self._config.descent_speed_m_s
        return (x, y, _between(velocity[2], low, high, "vertical_speed", broken))

    def _within_bounds(self, setpoint: Setpoint, down: tuple[float, float], broken: list[str]) -> Vector3:
        """The acceleration within the bounds of its size: a convex set, as the bound on tilt is a cone."""
        x, y, z = setpoint.acceleration_ned_m_s2
        z = _between(z, *down, "vertical_acceleration", broken)
        side, name = (
            min(self._config.horizontal_acceleration_m_s2, self._by_tilt_m_s2),
            "horizontal_acceleration",
        )
        if setpoint.attitude is not None:
            by_tilt = self._by_tilt_m_s2 * max(0.0, 1.0 - z / GRAVITY_M_S2)
            side, name = (by_tilt, "tilt") if by_tilt < side else (side, name)
        return (*_within(x, y, side, name, broken), z)

    def _slewed(self, wanted: Vector3, step_s: float, broken: list[str], *, by_attitude: bool) -> Vector3:
        """`wanted`, or as far towards it as the jerk allows; between two allowed vectors all are allowed.

        With `by_attitude` g tan(tilt) changes no faster than that either: on the straight way from a to a + c
        by the share s it changes by s |c + (0, 0, c_z) a / (g - a_z)| g / (g - a_z - s c_z), sideways. What
        tilt an autopilot has that flew by its own loops is not known: the first attitude after it is free.
        """
        if self._last is None or (by_attitude and self._last.attitude is None):
            return wanted
        last, most = self._flown, self._config.jerk_m_s3 * step_s
        change = subtract(wanted, last)
        size = norm(change)
        shares = {"jerk": most / size if size > most * ROUNDING else 1.0}
        if by_attitude:
            upward = GRAVITY_M_S2 - last[2]
            aside = [GRAVITY_M_S2 * (change[k] + last[k] * change[2] / upward) for k in (0, 1)]
            turned, left = math.hypot(*aside), GRAVITY_M_S2 - wanted[2]
            if turned > most * left * ROUNDING:
                shares["tilt_rate"] = most * upward / (turned + most * change[2])
        name = min(shares, key=lambda bound: shares[bound])
        if shares[name] >= 1.0:
            return wanted
        broken.append(name)
        return add(last, scale(change, shares[name]))

    def _heading(self, heading_rad: float, step_s: float, broken: list[str]) -> float:
        if self._last is None:
            return wrap_angle(heading_rad)
        most = math.radians(self._config.heading_rate_deg_s) * step_s
        change = wrap_angle(heading_rad - self._last.heading_rad)
        return wrap_angle(self._last.heading_rad + _between(change, -most, most, "heading", broken))

    def _heading_rate(self, rate_rad_s: float, broken: list[str]) -> float:
        most = math.radians(self._config.heading_rate_deg_s)
        return _between(rate_rad_s, -most, most, "heading_rate", broken)

    def _thrust(self, thrust: float | None, on_ground: bool, broken: list[str]) -> float | None:
        if thrust is None:
            return None
        least = 0.0 if on_ground else self._config.minimum_thrust
        return _between(thrust, least, self._config.maximum_thrust, "thrust", broken)


def _finite(setpoint: Setpoint) -> bool:
    numbers = [
        *setpoint.velocity_ned_m_s,
        *setpoint.acceleration_ned_m_s2,
        setpoint.heading_rad,
        setpoint.heading_rate_rad_s,
    ]
    if setpoint.attitude is not None:
        size = math.sqrt(sum(part * part for part in setpoint.attitude))
        numbers.append(size if size > 1e-6 else math.inf)  # no direction is no number either
    if setpoint.thrust is not None:
        numbers.append(setpoint.thrust)
    return all(map(math.isfinite, numbers))


def _within(x: float, y: float, radius: float, name: str, broken: list[str]) -> tuple[float, float]:
    size = math.hypot(x, y)
    if size <= radius * ROUNDING:
        return (x, y)
    broken.append(name)
    return (x / size * radius, y / size * radius)


def _between(value: float, low: float, high: float, name: str, broken: list[str]) -> float:
    if low - 1e-12 <= value <= high + 1e-12:
        return value
    broken.append(name)
    return min(max(value, low), high)
