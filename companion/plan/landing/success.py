"""The probability that the contact, when it comes, lies within the limits: it commits and breaks off by that.

At contact the vehicle follows the pad as well as it has done over the last seconds: gusts, a pad that
accelerates (its acceleration times the lag) and a deck that heaves are all in the errors to the reference
that it has made meanwhile. What it is off by right now goes on as it is until the vehicle responds, and
fades as a critically damped second order does; what is forgotten of it comes anew from those errors. Shaken
at random, such an order's time constant is the root of the offset's mean square by the speed's: both are in
those errors, and an autopilot that wanders slowly is known by them.

A swing goes on as it is for a part of its period: from the mean, by the tilt and its rate at the swing's own
frequency. NED, m, s, rad.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import subtract
from companion.base.messages import PadState, VehicleState
from companion.base.motion import Motion
from companion.config import TouchdownConfig
from companion.plan.debounce import StepClock
from companion.plan.inputs import LONGEST_CYCLE_S
from companion.plan.landing.contact import RESPONDS_S, UNSEEN_S
from companion.plan.landing.contact_filter import SINK_TAU_S
from companion.plan.landing.levelling import FASTEST_DRIFT, LEARNS_S, NORMAL, TiltPrediction
from companion.plan.trajectory.reference_generator import ReferenceGenerator

# a pad that swings less, root mean square, hardly tilts by 5 deg, and our own error swings by as much as 0.6
_SWINGS_RAD: Final = math.radians(2.0)
# a swing of several periods at once is known for about so long
_SWING_KNOWN_S: Final = 4.0
_TINY: Final = 1e-9


class SuccessEstimate:
    """How closely the vehicle follows the pad, and what that makes of a contact; `note` every cycle."""

    def __init__(self, config: TouchdownConfig) -> None:
        """Nothing is known: the errors may be as large as the limits."""
        self._config, self._clock, self.tilt = config, StepClock(), TiltPrediction()
        self._fastest_m_s = FASTEST_DRIFT * config.lateral_speed_m_s
        spare_m_s = config.fastest_contact_m_s - config.contact_speed_m_s
        # mean squares on an axis: of the offset (m²), of the speed over the pad and of the sink (m²/s²)
        self._errors = config.break_off_lateral_m**2, self._fastest_m_s**2, spare_m_s**2

    def note(
        self,
        sight: PadState | None,
        vehicle: VehicleState | None,
        generator: ReferenceGenerator,
        now_s: float,
    ) -> None:
        """Take in the tilt, and how far it is off the reference, while that is in the pad's frame."""
        if vehicle is not None:
            self.tilt.note(vehicle, sight, now_s)
        share = -math.expm1(-min(LONGEST_CYCLE_S, self._clock.step_s(now_s)) / LEARNS_S)
        by_pad = generator.active and generator.origin == "pad"
        if not by_pad or sight is None or sight.unseen_s > UNSEEN_S:
            return
        actual, reference = sight.vehicle_from_pad, generator.at(now_s)
        x, y, _ = subtract(actual.position_m, reference.position_m)
        vx, vy, vz = subtract(actual.velocity_m_s, reference.velocity_m_s)
        offset, speed, sink = self._errors
        offset += share * (0.5 * (x * x + y * y) - offset)
        speed += share * (0.5 * (vx * vx + vy * vy) - speed)
        self._errors = offset, speed, sink + share * (vz * vz - sink)

    @property
    def sink_std_m_s(self) -> float:
        """By how much the sink has been off the one asked for."""
        return math.sqrt(self._errors[2])

    def factors(
        self,
        sight: PadState,
        reference: Motion,
        ahead_s: float,
        *,
        sink_m_s: float,
        contact: Motion,
        drift: tuple[float, float],
        slack: float,
    ) -> dict[str, float]:
        """The probabilities of a contact so much later that is within each limit, by what it limits.

        `sink_m_s` is planned for it, `contact` how the reference itself touches, `drift` the standard
        deviations (m/s, m) of what a level vehicle drifts by until then; `slack` widens the limit aside.
        """
        c = self._config
        offset, speed, sink = self._errors
        as_it_is_s, fades_s = min(ahead_s, RESPONDS_S), max(0.0, ahead_s - RESPONDS_S)
        # not faster than the loop itself: gusts that begin now show in the speed first
        tau_s = max(SINK_TAU_S, math.sqrt(offset / (speed + _TINY)))
        fades = fades_s / tau_s
        fade, kept, sink_kept = math.exp(-fades), _kept(fades), _kept(fades_s / SINK_TAU_S)
        actual = sight.vehicle_from_pad
        x, y, _ = subtract(actual.position_m, reference.position_m)
        vx, vy, _ = subtract(actual.velocity_m_s, reference.velocity_m_s)
        vz = sight.relative_velocity_ned_m_s[2]
        x, y = x + as_it_is_s * vx, y + as_it_is_s * vy
        axes = zip((x, y), (vx, vy), contact.position_m, contact.velocity_m_s, strict=False)
        ends = [
            (p + kept * e + fade * fades_s * v, s + fade * ((1.0 - fades) * v - fades / tau_s * e))
            for e, v, p, s in axes
        ]
        aside_m, slip_m_s = (math.hypot(*axis) for axis in zip(*ends, strict=True))

        def std(learnt: float, estimated: float, kept: float) -> float:
            return math.sqrt((1.0 - kept * kept) * learnt + (kept * estimated) ** 2)

        offset_std_m = std(offset, sight.lateral_std_m(as_it_is_s), kept)
        axis_std_m_s = sight.velocity_std_m_s / math.sqrt(3.0)
        speed_std_m_s, sink_std_m_s = std(speed, axis_std_m_s, kept), std(sink, axis_std_m_s, sink_kept)
        spare_m_s = c.fastest_contact_m_s - sink_m_s - sink_kept * (-vz - sink_m_s)
        return {
            "lateral offset": _within(slack * c.break_off_lateral_m, aside_m, offset_std_m, drift[1]),
            "lateral speed": _within(self._fastest_m_s, slip_m_s, speed_std_m_s, drift[0]),
            "sink": NORMAL.cdf(spare_m_s / (sink_std_m_s + _TINY)),
            "pad tilt": _pad_level(sight, ahead_s, math.radians(c.contact_deck_tilt_deg)),
        }


def _kept(fades: float) -> float:
    """What is left of an offset after so many time constants of a critically damped second order."""
    return (1.0 + fades) * math.exp(-fades)


def _within(limit: float, mean: float, std: float, along_std: float) -> float:
    """The probability of a vector of at most so much: by its deviation on an axis and more along its mean."""
    along, across = math.hypot(std, along_std) + _TINY, std + _TINY
    inside = NORMAL.cdf((limit - mean) / along) - NORMAL.cdf((-limit - mean) / along)
    return inside * (2.0 * NORMAL.cdf(limit / across) - 1.0)


def _pad_level(sight: PadState, ahead_s: float, most_rad: float) -> float:
    """The probability of a pad that is level enough by then; one that does not swing is as it is."""
    if sight.tilt_swing_rad < _SWINGS_RAD:
        return 1.0
    tilt_rad, std_rad = tilt_in_rad(sight, ahead_s)
    return _within(most_rad, tilt_rad, 0.0, std_rad)


def tilt_in_rad(sight: PadState, ahead_s: float) -> tuple[float, float]:
    """How far the pad will tilt (rad) so much later, and the standard deviation of that."""
    turned = sight.tilt_frequency_rad_s * ahead_s
    known = math.exp(-0.5 * (ahead_s / _SWING_KNOWN_S) ** 2)
    rate_s = math.sin(turned) / sight.tilt_frequency_rad_s if turned > 0.0 else ahead_s
    axes = zip(sight.tilt_mean_rad, sight.tilt_rad, sight.tilt_rate_rad_s, strict=True)
    tilt_rad = math.hypot(
        *(mean + known * (math.cos(turned) * (tilt - mean) + rate_s * rate) for mean, tilt, rate in axes)
    )
    return tilt_rad, sight.tilt_swing_rad * math.sqrt(1.0 - known * known)
