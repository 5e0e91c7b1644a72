"""Settings made to fit how the vehicle answers: no quicker than it bears, no more asked than passes.

The weights of `control` are those for a response as quick as `QUICK_S`. For a slower one the loop's own
frequency goes down in proportion, so that the same phase is lost in it. For one that rings it stays as far
below the ringing as the square of its peak says: what is fed back of velocity and of lean peaks there, too.
`margins` tells what is left. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from companion.config import AxisResponse, ControlConfig, KindResponse, TrackingConfig

QUICK_S: Final = 0.14
# the loop's frequency as a share of the ringing's over its peak's square
RINGING_SHARE: Final = 0.3


@dataclass(frozen=True, slots=True)
class AutopilotLimits:
    """What the autopilot lets through sideways, by its parameters; None: nothing known that binds.

    PX4: MPC_ACC_HOR, MPC_JERK_AUTO, MPC_TILTMAX_AIR; ArduPilot: WPNAV_ACCEL, PSC_JERK_XY, ANGLE_MAX.
    """

    acceleration_m_s2: float | None = None
    jerk_m_s3: float | None = None
    tilt_deg: float | None = None


def fitted(
    config: ControlConfig, response: KindResponse, limits: AutopilotLimits | None = None
) -> ControlConfig:
    """The settings for this response; `limits`, as read from the autopilot, go before the response's own."""
    known = limits or AutopilotLimits(response.acceleration_m_s2, response.jerk_m_s3)
    bounds = {
        "horizontal_acceleration_m_s2": known.acceleration_m_s2,
        "jerk_m_s3": known.jerk_m_s3,
        "tilt_deg": known.tilt_deg,
    }
    own = config.limits
    cut = {name: min(getattr(own, name), most) for name, most in bounds.items() if most is not None}
    return config.model_copy(
        update={
            "limits": own.model_copy(update=cut),
            "horizontal": _softened(config.horizontal, response.sideways),
            "vertical": _softened(config.vertical, response.down),
        }
    )


def loop_rad_s(weights: TrackingConfig) -> float:
    """The frequency of the loop that these weights make, were the vehicle quick."""
    return float((weights.effort_m_s2 / weights.position_m) ** 0.5)


def _peak(damping: float) -> float:
    """The greatest gain of a second order."""
    return 1.0 / (2.0 * damping * (1.0 - damping**2) ** 0.5) if damping < 0.5**0.5 else 1.0


def _softened(weights: TrackingConfig, response: AxisResponse) -> TrackingConfig:
    """Weights whose loop is slower by how much slower the response is."""
    bearable_rad_s = RINGING_SHARE * response.frequency_rad_s / (response.gain * _peak(response.damping)) ** 2
    slower = max(1.0, response.delay_s / QUICK_S, loop_rad_s(weights) / bearable_rad_s)
    return weights.model_copy(
        update={
            "position_m": weights.position_m * slower**2,
            "velocity_m_s": weights.velocity_m_s * slower,
        }
    )
