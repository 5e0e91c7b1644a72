"""The gyroscope's errors in a yaw: scale and misalignment as three constants, estimated beside the EKF.

A yaw at r rad/s is measured as (1 + k3) r on the gyroscope's own axis and as k1 r, k2 r on the other two
(body). In a lasting turn this is not noise: it turns the attitude further and further, and back when the
turn reverses. The 31 states include only biases, so k has a separate filter, the separate-bias estimator
(Friedland, IEEE Transactions on Automatic Control 14, 1969). With M, the covariance (3, 3) of k, and V,
that (31, 3) of the state's error with k's, predictions and gains are those of one filter with 34 states:

    predict   G = r dx/d(gyroscope's bias)    P += A V Gᵀ + G Vᵀ Aᵀ + G M Gᵀ    V = A V + G M
    correct   k += (C V)ᵀ S⁻¹ y               V -= K C V                         M -= (C V)ᵀ S⁻¹ C V

Only fixes correct k and M, and k is left out before the first fix. A compass's errors turn with the vehicle
as k's do, so a compass measurement updates the state and V but not k, as in Schmidt's filter. x and P keep
their form. Immutable: each step gives a new one. Rates in rad/s, k as shares of a rate.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import EYE3, FloatArray, Vector3, scale, subtract, vector3
from companion.estimate.vehicle import ekf_model as model

GYRO_SCALE_ERROR: Final = 0.005  # scale and misalignment of a calibrated MEMS gyroscope
_WALK_RTS: Final = 1e-4  # with the temperature


class YawError(NamedTuple):
    """k (3,) with its covariance (3, 3), and the state's with it (31, 3)."""

    share: FloatArray
    covariance: FloatArray
    with_state: FloatArray

    @staticmethod
    def first() -> YawError:
        """Calibrated, and nothing known beyond that."""
        return YawError(np.zeros(3), GYRO_SCALE_ERROR**2 * EYE3, np.zeros((model.STATES, 3)))

    def taken_off(self, rate_body_rad_s: Vector3, yaw_rad_s: float) -> Vector3:
        """A measured rate without what a yaw has added to it."""
        return subtract(rate_body_rad_s, scale(vector3(self.share), yaw_rad_s))

    def predicted(self, A: FloatArray, yaw_rad_s: float, dt_s: float) -> tuple[YawError, FloatArray]:
        """After a step of transition A (19, 25) at a yaw's rate; and G (19, 3), d(state)/dk of the step."""
        G = A[:, model.GYRO_BIAS] * yaw_rad_s
        with_state = self.with_state.copy()
        with_state[: model.MOVING] = A @ self.with_state[: model.COUPLED] + G @ self.covariance
        covariance = self.covariance + _WALK_RTS**2 * dt_s * EYE3
        return YawError(self.share, covariance, with_state), G

    def considered(self, C: FloatArray, K: FloatArray, J: FloatArray) -> YawError:
        """After a measurement with Jacobian C and gain K that teaches nothing of k.

        The quaternion's errors have then been transformed by J (4, 4).
        """
        with_state = self.with_state - K @ (C @ self.with_state)
        with_state[model.QUATERNION] = J @ with_state[model.QUATERNION]
        return YawError(self.share, self.covariance, with_state)

    def learnt(self, innovation: FloatArray, C: FloatArray, inverse: FloatArray) -> YawError:
        """k and its covariance after a measurement; `inverse` is that of the innovation's covariance."""
        seen = C @ self.with_state
        gain = seen.T @ inverse
        covariance = self.covariance - gain @ seen
        return self._replace(
            share=self.share + gain @ innovation, covariance=0.5 * (covariance + covariance.T)
        )

    def without(self, states: slice) -> YawError:
        """These states have been set anew."""
        with_state = self.with_state.copy()
        with_state[states] = 0.0
        return self._replace(with_state=with_state)

    def changed(self, before: YawError, after: YawError, moved: FloatArray) -> YawError:
        """This one, had there been `after` in place of `before` earlier; errors have moved by `moved` since.

        What the difference would have turned the attitude by since then is left out: within the time that a
        fix is late, about 1e-4 rad.
        """
        return YawError(
            self.share + after.share - before.share,
            self.covariance + after.covariance - before.covariance,
            self.with_state + moved @ (after.with_state - before.with_state),
        )
