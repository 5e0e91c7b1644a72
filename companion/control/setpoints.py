"""Converts the MPC's answer to setpoints: acceleration with velocity, or attitude with thrust.

Velocity setpoints. The autopilot flies a = a_ff + K (v_sp - v) + its own integral, with the lag tau. The
app sends the velocity that it predicts for the time at which the setpoint takes effect, and the MPC's
acceleration as a_ff. The autopilot's loop then adds nothing while the prediction holds, and damps
deviations from it.

A lasting disturbance is compensated by an offset of v_sp and not of a_ff. Its usual cause, a biased
velocity estimate, is then cancelled at its origin, and wind passes to the autopilot's integral, which an
offset of a_ff would wind up without end. Fast changes stay in a_ff: an error of the assumed K scales the
effect of an offset of v_sp, which closes a loop that has to be slow.

NED and FRD, SI units.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, add, norm, subtract, wrap_angle
from companion.base.messages import PadState, Reference, Setpoint
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.attitude import (
    attitude_from_acceleration,
    force_from_acceleration,
    thrust_from_acceleration,
)
from companion.control.response.flight_model import advance

GROUND_THRUST: Final = 0.0  # on the ground: ArduPilot has landed at none alone
# With it and `ground_descent_m_s` PX4's velocity loop (MPC_Z_VEL_P_ACC 4) asks for 9 m/s2 down: its least
# thrust. A horizontal velocity loop beside it would turn the least error into a large tilt of what is left.
GROUND_PRESS_M_S2: Final = 5.0
HEADING_RATE_SMOOTHING_S: Final = 0.4  # a dozen sightings at 30 Hz; judged
# A reference that waits over the pad moves by less.
_SINKS_M_S: Final = 0.05
# Blind it goes down nearly as firmly as the final descent ever does: what it does not see adds up.
_BLIND_SINK_M_S: Final = 0.3


class Heading(NamedTuple):
    """Where to look (rad) and how fast that turns (rad/s)."""

    heading_rad: float
    rate_rad_s: float = 0.0

    @staticmethod
    def at(heading_rad: float) -> Heading:
        """Not turning; to the north where it is no number."""
        return Heading(heading_rad if math.isfinite(heading_rad) else 0.0)

    def after(self, elapsed_s: float, wanted_rad: float, most_rad_s: float) -> Heading:
        """Turned towards the wanted heading, the shorter way and no faster than allowed."""
        if elapsed_s <= 0.0 or not math.isfinite(wanted_rad):
            return self
        most = most_rad_s * elapsed_s
        change = max(-most, min(most, wrap_angle(wanted_rad - self.heading_rad)))
        # the estimate of the pad's heading is noisy: its slope is of use only when smoothed
        share = -math.expm1(-elapsed_s / HEADING_RATE_SMOOTHING_S)
        rate_rad_s = self.rate_rad_s + share * (change / elapsed_s - self.rate_rad_s)
        return Heading(wrap_angle(self.heading_rad + change), rate_rad_s)


def resolved(config: ControlConfig, autopilot_kind: AutopilotKind) -> ControlConfig:
    """Settings in which the kind of setpoint is the one that this autopilot answers quickest."""
    kind = config.setpoint
    if kind == "auto" and config.controller == "pid":
        kind = "velocity"  # its gains are tuned for the autopilot's velocity loop below it
    elif kind in ("auto", "acceleration"):
        kind = PROFILES[autopilot_kind].setpoint
    return config.model_copy(update={"setpoint": kind})


def velocity_setpoint(
    now_s: float,
    config: ControlConfig,
    *,
    motion: Motion,
    input_ned_m_s2: Vector3,
    disturbance_ned_m_s2: Vector3,
    lasting_ned_m_s2: Vector3,
    lags_s: Vector3,
    gains_1_s: Vector3,
    heading: Heading,
) -> Setpoint:
    """Velocity and acceleration under which the autopilot wants `input_ned_m_s2` at `motion`."""
    total = add(input_ned_m_s2, disturbance_ned_m_s2)
    ahead = advance(motion, total, config.velocity_lookahead_s, lags_s).velocity_m_s
    holds = config.setpoint != "acceleration"
    (x, y, z), (kx, ky, kz) = lasting_ned_m_s2, gains_1_s
    most = config.maximum_velocity_correction_m_s
    correction = (_share(-x, kx, most), _share(-y, ky, most), _share(-z, kz, most))
    gained = (kx * correction[0], ky * correction[1], kz * correction[2])
    return Setpoint(
        time_s=now_s,
        velocity_ned_m_s=add(ahead, correction),
        acceleration_ned_m_s2=subtract(input_ned_m_s2, gained),
        heading_rad=heading.heading_rad,
        heading_rate_rad_s=heading.rate_rad_s,
        holds_horizontal_velocity=holds,
    )


def attitude_setpoint(
    now_s: float, velocity_ned_m_s: Vector3, input_ned_m_s2: Vector3, hover_thrust: float, heading: Heading
) -> Setpoint:
    """Attitude and thrust that make `input_ned_m_s2`; the velocity goes along for the log."""
    return Setpoint(
        time_s=now_s,
        velocity_ned_m_s=velocity_ned_m_s,
        acceleration_ned_m_s2=input_ned_m_s2,
        heading_rad=heading.heading_rad,
        heading_rate_rad_s=heading.rate_rad_s,
        attitude=attitude_from_acceleration(input_ned_m_s2, heading.heading_rad),
        thrust=thrust_from_acceleration(input_ned_m_s2, hover_thrust),
    )


def tilt_compensation(flown_m_s2: Vector3, asked_m_s2: Vector3, most_rad: float) -> float:
    """By how much to scale the thrust because the tilt is not yet the one asked for.

    The upward force was divided by the cosine of the tilt asked for; while the vehicle still has the tilt of
    `flown_m_s2` (m/s2, NED; what its thrust makes) that is too little when the tilt decreases, and too much
    when it grows. Neither tilt counts for more than `most_rad`: of an upset or falling vehicle the
    acceleration says nothing. ArduPilot divides by the cosine of the tilt that it flies: for it, zero.
    """
    least = math.cos(most_rad)
    return max(least, _upward_share(asked_m_s2)) / max(least, _upward_share(flown_m_s2))


def boosted(setpoint: Setpoint, boost: float) -> Setpoint:
    """A setpoint whose thrust is scaled by `boost`: its own, or the one its acceleration asks for."""
    x, y, z = setpoint.acceleration_ned_m_s2
    return replace(
        setpoint,
        acceleration_ned_m_s2=(x, y, GRAVITY_M_S2 - (GRAVITY_M_S2 - z) * boost),
        thrust=None if setpoint.thrust is None else setpoint.thrust * boost,
    )


def ground_setpoint(now_s: float, config: ControlConfig, pad: PadState | None, heading: Heading) -> Setpoint:
    """Rest on the pad: press down, so that the autopilot takes the thrust away, and do not tilt.

    Where the autopilot skips its horizontal velocity loop in the air it skips it here, too: that integral
    is from when it last held against the wind, and would tilt a standing vehicle over its feet. Then nearly
    all of the thrust may go at once: feet that carry half of the weight slide in a wind.
    """
    along, holds = pad.velocity_ned_m_s if pad else ZERO3, config.setpoint != "acceleration"
    if config.setpoint == "attitude":
        return Setpoint(
            time_s=now_s,
            velocity_ned_m_s=along,
            heading_rad=heading.heading_rad,
            attitude=attitude_from_acceleration(ZERO3, heading.heading_rad),
            thrust=GROUND_THRUST,
        )
    return Setpoint(
        time_s=now_s,
        velocity_ned_m_s=(along[0], along[1], config.ground_descent_m_s),
        acceleration_ned_m_s2=(0.0, 0.0, config.ground_acceleration_m_s2 if holds else GROUND_PRESS_M_S2),
        heading_rad=heading.heading_rad,
        holds_horizontal_velocity=holds,
    )


def stop_setpoint(now_s: float, heading: Heading) -> Setpoint:
    """Stand still, for when there is no plan that holds: no velocity, by the autopilot's own loops.

    An autopilot that is sent attitudes else gets it too: level at hover thrust keeps speed and sink, and the
    wind adds to them.
    """
    return Setpoint(time_s=now_s, heading_rad=heading.heading_rad)


def blind_setpoint(
    now_s: float,
    config: ControlConfig,
    velocity_ned_m_s: Vector3,
    acceleration_ned_m_s2: Vector3,
    wind_ned_m_s2: Vector3,
    heading: Heading,
) -> Setpoint:
    """Fly a velocity, and a horizontal acceleration, by the autopilot's own loops: they feel what we do not.

    So does an autopilot that is sent attitudes else. A horizontal velocity loop that our accelerations have
    passed by stays passed by, since its integral is from another wind: it tilts against the wind instead.
    """
    passed_by = config.setpoint == "acceleration"
    north, east, _ = subtract(acceleration_ned_m_s2, wind_ned_m_s2 if passed_by else ZERO3)
    return Setpoint(
        now_s,
        velocity_ned_m_s=velocity_ned_m_s,
        acceleration_ned_m_s2=(north, east, 0.0),
        heading_rad=heading.heading_rad,
        heading_rate_rad_s=heading.rate_rad_s,
        holds_horizontal_velocity=not passed_by,
    )


def blind_sink_m_s(reference: Reference, pad: PadState | None) -> float | None:
    """How fast it goes down (m/s, NED), as the reference does or faster; None where that does not sink.

    It counts from the pad, which may rise: less than nothing is a climb.
    """
    sink_m_s = float(reference.velocity_m_s[0, 2])
    if sink_m_s <= _SINKS_M_S:
        return None
    pad_m_s = pad.velocity_ned_m_s[2] if pad is not None and reference.origin == "pad" else 0.0
    return max(sink_m_s, _BLIND_SINK_M_S) + pad_m_s


def _upward_share(acceleration_m_s2: Vector3) -> float:
    """Cosine of the tilt that makes an acceleration."""
    force = force_from_acceleration(acceleration_m_s2)
    return -force[2] / norm(force)


def _share(acceleration_m_s2: float, gain_1_s: float, most_m_s: float) -> float:
    """The velocity offset (m/s) that the autopilot's loop turns into an acceleration, within a bound."""
    return max(-most_m_s, min(most_m_s, acceleration_m_s2 / gain_1_s)) if gain_1_s > 0.0 else 0.0
