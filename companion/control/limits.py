"""The limits gate: no setpoint beyond these bounds is sent to the autopilot.

Every setpoint passes through `LimitsGate.apply`, which names each reduction for the log. A setpoint with
any number that is not finite becomes a hold: no velocity, no acceleration, the last heading. A horizontal
velocity that is not part of the setpoint has no bound, unless the vehicle exceeds the bound: then the
velocity is sent after all.

`control.limits.tilt_deg` bounds the tilt of an attitude setpoint by its horizontal acceleration without
vertical acceleration, g tan(tilt), so that one bound on its change (jerk) serves both kinds of setpoint.
The horizontal part of an acceleration has the same bound. Together with a downward acceleration it needs
more tilt, which the MPC's own bounds exclude and this gate does not. The acceleration that an autopilot's
velocity loop adds to a velocity setpoint is not bounded here. NED and FRD, SI units.
"""

import math

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    add,
    horizontal_acceleration,
    norm,
    quat_normalise,
    scale,
    subtract,
    wrap_angle,
)
from companion.base.messages import Setpoint
from companion.config import LimitsConfig
from companion.control.attitude import attitude_from_acceleration

# a pause that is longer counts as this: the command jumps no further, and no more is learnt
LONGEST_STEP_S = 0.2
# rounding alone is not a breach
ROUNDING = 1.0 + 1e-9


def by_tilt_m_s2(limits: LimitsConfig) -> float:
    """The horizontal acceleration (m/s2) of the greatest tilt, without a vertical one."""
    return GRAVITY_M_S2 * math.tan(math.radians(limits.tilt_deg))


def aside_m_s2(limits: LimitsConfig) -> float:
    """The greatest horizontal acceleration (m/s2), by its own bound and by the tilt's."""
    return min(by_tilt_m_s2(limits), limits.horizontal_acceleration_m_s2)


class LimitsGate:
    """Bounds setpoints. Remembers the last one, since some things may change only so fast."""

    def __init__(self, config: LimitsConfig) -> None:
        self.bound_by(config)
        self.reset()

    def bound_by(self, config: LimitsConfig) -> None:
        """Other bounds from now on; what was sent last stays known, and bounds the change."""
        self._config = config
        self._by_tilt_m_s2, self._aside_m_s2 = by_tilt_m_s2(config), aside_m_s2(config)

    def reset(self) -> None:
        """Start again: the next setpoint is bounded in size, and in change from nothing."""
        self._last: Setpoint | None = None
        self._last_by_tilt: Vector3 | None = None

    def apply(
        self, setpoint: Setpoint, now_s: float, *, on_ground: bool = False, pressed_m_s2: float = 0.0
    ) -> tuple[Setpoint, tuple[str, ...]]:
        """The setpoint within all bounds, stamped `now_s`, and the names of the bounds that it broke.

        `on_ground` lifts the least thrust, and the bound on acceleration downwards: there no thrust at all is
        what shows the autopilot that it has landed.
        What presses it down by `pressed_m_s2` may be met beyond the bound on vertical acceleration.

        The stamp never runs backwards. After a `reset` nothing is known to have been sent, and the bounds on
        change (jerk, heading rate) do not apply to the first setpoint.
        """
        broken: list[str] = []
        time_s, step_s = self._time(now_s, broken)
        if not _finite(setpoint):
            broken.append("not_finite")
            setpoint = self._stop(setpoint)
        heading = self._heading(setpoint.heading_rad, step_s, broken)
        limited = Setpoint(
            time_s=time_s,
            velocity_ned_m_s=self._velocity(setpoint.velocity_ned_m_s, broken),
            acceleration_ned_m_s2=self._acceleration(
                setpoint.acceleration_ned_m_s2,
                step_s,
                broken,
                pressed_m_s2=max(0.0, pressed_m_s2),
                on_ground=on_ground,
            ),
            heading_rad=heading,
            heading_rate_rad_s=self._heading_rate(setpoint.heading_rate_rad_s, broken),
            attitude=self._attitude(setpoint.attitude, heading, step_s, broken),
            thrust=self._thrust(setpoint.thrust, on_ground, broken),
            exposure_time_s=setpoint.exposure_time_s,
            holds_horizontal_velocity=setpoint.holds_horizontal_velocity or "horizontal_speed" in broken,
        )
        self._last = limited
        return limited, tuple(broken)

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

    def _acceleration(
        self,
        acceleration: Vector3,
        step_s: float,
        broken: list[str],
        *,
        pressed_m_s2: float,
        on_ground: bool,
    ) -> Vector3:
        x, y = _within(acceleration[0], acceleration[1], self._aside_m_s2, "horizontal_acceleration", broken)
        bound = self._config.vertical_acceleration_m_s2
        most = GRAVITY_M_S2 if on_ground else bound
        z = _between(acceleration[2], -bound - pressed_m_s2, most, "vertical_acceleration", broken)
        last = self._last.acceleration_ned_m_s2 if self._last else None
        return self._slewed((x, y, z), last, step_s, "jerk", broken)

    def _attitude(
        self, attitude: Quaternion | None, heading_rad: float, step_s: float, broken: list[str]
    ) -> Quaternion | None:
        if attitude is None:
            self._last_by_tilt = None
            return None
        x, y = horizontal_acceleration(quat_normalise(attitude))
        x, y = _within(x, y, self._by_tilt_m_s2, "tilt", broken)
        self._last_by_tilt = self._slewed((x, y, 0.0), self._last_by_tilt, step_s, "tilt_rate", broken)
        return attitude_from_acceleration(self._last_by_tilt, heading_rad)

    def _slewed(
        self, wanted: Vector3, last: Vector3 | None, step_s: float, name: str, broken: list[str]
    ) -> Vector3:
        """`wanted`, or as far towards it as the jerk allows; between two allowed vectors all are allowed."""
        if last is None:
            return wanted
        change, most = subtract(wanted, last), self._config.jerk_m_s3 * step_s
        size = norm(change)
        if size <= most * ROUNDING:
            return wanted
        broken.append(name)
        return add(last, scale(change, most / size))

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
