"""The MPC's optimum without its inequalities, which is exact if no constraint binds.

Solves eq. 39 under eq. 38: P z + q + A'y = 0, A z = b, by a factorisation that is made once.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from companion.base.geometry import FloatArray


class FreeOptimum:
    """The minimum of 1/2 z'Pz + q'z with A z = b, for fixed P and A."""

    def __init__(self, P_upper: sparse.csc_matrix, A: sparse.csc_matrix) -> None:
        """`P_upper` (n, n) is P's upper triangle; `A` (m, n)."""
        self.P = P_upper + sparse.triu(P_upper, k=1).T
        self._factors = splu(sparse.bmat([[self.P, A.T], [A, None]], format="csc"))
        self._n = self.P.shape[0]

    def solve(self, q: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """z (n,) and the multipliers y (m,)."""
        answer = self._factors.solve(np.concatenate([-q, b]))
        return answer[: self._n], answer[self._n :]
