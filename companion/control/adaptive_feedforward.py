"""Adaptive feed-forward of the pad's acceleration (feedback error learning, Kawato 1990).

The loop has a stiffness of only 4 1/s², which its margins require: a tenth of the pad's acceleration not
flown is an error of 5 cm on a circle. Scale errors of accelerometer and thrust, and lags of observers and
estimates, each miss a few hundredths of it. No constant disturbance describes that, since it turns with the
pad. If the pad accelerates by a (a complex number, the horizontal plane), about theta a is missed: the real
part of theta is a scale, the imaginary part a lag. The feedback then supplies theta a in the mean, and this
effort gives theta.

Over a pad that turns at the rate w the loop becomes L (1 + 1 / (T (s - j w))), which
`margins.while_turning` computes. Nothing is learnt over a pad that does not accelerate, and the loop is
unchanged there. NED axes, SI units.
"""

from typing import Final

from companion.base.geometry import Vector3
from companion.config import TrackingConfig
from companion.control.response.fitting import loop_rad_s

# times the loop's own time constant; costs some 6° of phase
LEARNING_TIMES: Final = 8.0
# as a share of the loop's own frequency: a pad that turns faster teaches nothing
FASTEST_TURN_SHARE: Final = 0.6
# three deviations of the estimate of the pad's acceleration: less of it is mostly noise
NOISE_M_S2: Final = 0.3
# a scale off by more, or a lag of more than 0.25 s at 1 rad/s, is something else
LARGEST_SHARE: Final = 0.25
# a larger effort is a way back to the reference, and says nothing
LARGEST_EFFORT_M_S2: Final = 0.7


def learning_s(weights: TrackingConfig) -> float:
    """T of the module's text for the loop that these weights make."""
    return LEARNING_TIMES / loop_rad_s(weights)


class AdaptiveFeedforward:
    """Learns what share of the pad's acceleration has to be commanded on top."""

    def __init__(self, weights: TrackingConfig) -> None:
        """`weights` are the loop's, sideways."""
        self._learning_s = learning_s(weights)
        self._fastest_rad_s = FASTEST_TURN_SHARE * loop_rad_s(weights)
        self.reset()

    def reset(self) -> None:
        """Start again, with the model as it is."""
        self.share = 0j

    def missing_m_s2(self, pad_acceleration_m_s2: Vector3) -> Vector3:
        """What is to be commanded on top (m/s2, NED)."""
        missing = self.share * _plane(pad_acceleration_m_s2)
        return (missing.real, missing.imag, 0.0)

    def learn(
        self,
        effort_m_s2: Vector3,
        pad_velocity_m_s: Vector3,
        pad_acceleration_m_s2: Vector3,
        elapsed_s: float,
    ) -> None:
        """Take in what was commanded off the feed-forward while the pad moved so; NED."""
        effort, v, a = map(_plane, (effort_m_s2, pad_velocity_m_s, pad_acceleration_m_s2))
        turns_fast = abs((v.conjugate() * a).imag) > self._fastest_rad_s * abs(v) ** 2
        if turns_fast or not abs(effort) <= LARGEST_EFFORT_M_S2:
            return
        step = elapsed_s / self._learning_s
        share = self.share + step * effort * a.conjugate() / (abs(a) ** 2 + NOISE_M_S2**2)
        self.share = share * (LARGEST_SHARE / max(abs(share), LARGEST_SHARE))


def _plane(vector: Vector3) -> complex:
    return complex(vector[0], vector[1])
