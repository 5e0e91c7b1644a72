"""Adapts the settings of `control` to the vehicle's response: loop frequency and accelerations.

The weights of `control` fit a response as fast as `QUICK_S`. For a slower response the loop's frequency is
reduced in proportion, so that the loss of phase stays the same. For an oscillating response the loop stays
below the resonance by the square of its peak, since the feedback of velocity and tilt has the same peak.
`margins` computes the remaining margins. SI units.
"""

from typing import Final

from companion.base.messages import AutopilotSetup
from companion.config import AxisResponse, ControlConfig, KindResponse, TrackingConfig, VehicleConfig

# the delay up to which the weights of `control` are used as they are; judged
QUICK_S: Final = 0.14
# an autopilot that does not report its limit may cut anywhere: the least that PX4 accepts (MPC_TILTMAX_AIR)
CAREFUL_TILT_DEG: Final = 20.0
HOVER_DIFFERS: Final = 0.15  # as a share: one of the two is wrong
# the loop's frequency as a share of the ringing's over its peak's square
RINGING_SHARE: Final = 0.3


def fitted(
    config: ControlConfig, response: KindResponse, setup: AutopilotSetup | None = None
) -> ControlConfig:
    """The settings, of one kind of setpoint, for this response; `setup` is what the autopilot itself says.

    Its limits on acceleration and jerk bind velocity setpoints alone; its tilt binds all. A tilt that it was
    asked for and does not report is a careful one.
    """
    unknown_deg = None if setup is None else CAREFUL_TILT_DEG
    setup = setup or AutopilotSetup()
    bounds = {"tilt_deg": unknown_deg if setup.tilt_deg is None else setup.tilt_deg}
    if config.setpoint == "velocity":
        bounds["horizontal_acceleration_m_s2"] = setup.acceleration_m_s2 or response.acceleration_m_s2
        bounds["jerk_m_s3"] = setup.jerk_m_s3 or response.jerk_m_s3
    own = config.limits
    cut = {name: min(getattr(own, name), most) for name, most in bounds.items() if most is not None}
    return config.model_copy(
        update={
            "limits": own.model_copy(update=cut),
            "horizontal": _softened(config.horizontal, response.sideways),
            "vertical": _softened(config.vertical, response.down),
        }
    )


def misfits(config: ControlConfig, vehicle: VehicleConfig, setup: AutopilotSetup) -> list[str]:
    """What of the settings does not fit the autopilot's own, a line each; `config` is the resolved one."""
    found = []
    own = setup.hover_thrust
    if own is not None and not abs(own / vehicle.hover_thrust - 1.0) <= HOVER_DIFFERS:
        found.append(
            f"hover thrust: autopilot {own:.2f}, vehicle '{vehicle.name}' "
            f"{vehicle.hover_thrust:.2f}; by attitude the measured one is used"
        )
    if setup.tilt_deg is None and config.limits.tilt_deg > CAREFUL_TILT_DEG:
        found.append(f"tilt limit: not reported by the autopilot; {CAREFUL_TILT_DEG:.0f} deg assumed")
    if setup.tilt_deg is not None and setup.tilt_deg < config.limits.tilt_deg:
        found.append(
            f"tilt limit: autopilot {setup.tilt_deg:.0f} deg, control.limits.tilt_deg "
            f"{config.limits.tilt_deg:.0f}; the autopilot's is used"
        )
    return found


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
