"""How pads may move: the models that the pad filter's two banks hold.

On each axis the state is (p, v, a, j): position and velocity relative to the vehicle, the pad's own
acceleration and its rate. Horizontal, both axes of each state side by side; a' = -a / tau + white jerk, and j
plays no part, for

    steady     small and short-lived: constant velocity
    manoeuvre  large, fading in a second or two: constant acceleration

and besides

    turn       turning with the course: a' = -a / tau + omega x a + j, j' = -j / tau_j + omega x j; both last
    sway       waves, as below: horizontal motion of a pad at sea

That a turn is written as jerk = omega x a, rather than as a = omega x v, keeps it free of the pad's absolute
velocity, hence of GPS: only the turn rate, a scalar, has to be known. Its j is what the acceleration changes
by beyond turning: where a bend begins or ends. Without it the acceleration is known 0.2 to 0.5 s late there.

Vertical:

    still      small and short-lived
    waves      a'' = -w0^2 a - 2 zeta w0 a' + white noise, for each period of a sea

Each is x' = A x + noise of density W, to which the noise of the vehicle's measured acceleration comes, by its
density of the moment. Over short times F = exp(A t) and Q are power series of t, whose coefficients never
change; over longer ones they are doubled: F(2t) = F F, Q(2t) = F Q F' + Q. NED, SI units.
"""

from __future__ import annotations

import cmath
import math
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import FloatArray
from companion.base.motion import COURSE_M_S
from companion.config import PadFilterConfig

STEADY_ACCELERATION_STD_M_S2: Final = 0.15  # a pad that drives straight on: bumps, and the horizon's error
STEADY_TIME_CONSTANT_S: Final = 1.0  # of those bumps; judged
MANOEUVRE_TIME_CONSTANT_S: Final = 1.5  # one that speeds up or brakes does so for so long
TURN_TIME_CONSTANT_S: Final = 20.0  # one that turns
TURN_ACCELERATION_STD_M_S2: Final = 0.8  # as of 4 m/s on a circle of 20 m; judged
TURN_JERK_M_S3_RTHZ: Final = 0.05  # bumps, besides the jerk that lasts
TURN_JERK_TIME_CONSTANT_S: Final = 3.0  # a bend begins, and ends, within so long
SWAY_DAMPING: Final = 0.2  # how far real periods stray from the models'
WAVE_DAMPING: Final = 0.12  # the same of waves, of whose periods there are several; judged
REST_ACCELERATION_STD_M_S2: Final = 0.05  # vertically, of a pad that rides no waves

# how far a pad's heading and its course may turn apart, and how fast courses turn at all
HEADING_IS_COURSE_RAD_S: Final = 0.1
STRAIGHT_ON_RAD_S: Final = 0.5  # see above
HORIZONTAL: Final = ("steady", "manoeuvre", "turn", "sway")
TURN: Final = HORIZONTAL.index("turn")
# with poles of some 1/s, ten terms at a tenth of a second leave 1e-12
SHORT_S: Final = 0.1
TERMS: Final = 10  # see above

_EXPONENTS: Final = np.arange(float(TERMS))
# where, in a flat (8, 8), the complex factors of acceleration and jerk stand, as blocks that multiply by them
_TURNED: Final = np.array(
    [
        8 * (row + down) + column + along
        for row, column in ((0, 4), (2, 4), (4, 4), (0, 6), (2, 6), (4, 6), (6, 6))
        for down in (0, 1)
        for along in (0, 1)
    ]
)


class Turn(NamedTuple):
    """The rate (rad/s, clockwise) at which the pad's course turns, its variance, its acceleration (m/s²)."""

    rate_rad_s: float = 0.0
    variance: float = 0.0
    acceleration_m_s2: float = 0.0


def course_turn(
    velocity_m_s: tuple[float, float],
    acceleration_m_s2: tuple[float, float],
    acceleration_variance: float,
    heading_rate_rad_s: float,
    heading_rate_variance: float,
) -> Turn:
    """How the course turns, by three weighted estimates: v x a, the heading's rate, and straight on.

    Args:
        velocity_m_s: of the pad over ground, north and east. An error dv of it makes one of about
            |omega dv / v|, which is why GPS may contribute here.
        acceleration_m_s2: of the pad, north and east.
        acceleration_variance: of either component, (m/s²)².
        heading_rate_rad_s: of the pad.
        heading_rate_variance: its variance, (rad/s)².
    """
    (vn, ve), (an, ae) = velocity_m_s, acceleration_m_s2
    speed_squared = vn * vn + ve * ve + COURSE_M_S**2
    by_course = 1.0 / max(acceleration_variance / speed_squared, 1e-4)
    by_heading = 1.0 / (heading_rate_variance + HEADING_IS_COURSE_RAD_S**2)
    variance = 1.0 / (by_course + by_heading + 1.0 / STRAIGHT_ON_RAD_S**2)
    rate = by_course * (vn * ae - ve * an) / speed_squared + by_heading * heading_rate_rad_s
    return Turn(variance * rate, variance, math.hypot(an, ae))


def vertical_names(config: PadFilterConfig) -> tuple[str, ...]:
    """The vertical models, in their order."""
    return ("still", *(f"waves_{period_s:g}s" for period_s in config.wave_periods_s))


class _Kinds(NamedTuple):
    """Models of one axis: A and W (m, 4, 4), and the variances (m,) that acceleration and jerk start with."""

    A: FloatArray
    W: FloatArray
    acceleration_variance: FloatArray
    jerk_variance: FloatArray


class PadModels:
    """All models, the horizontal ones first, for a given turn rate.

    The vertical ones have a second axis, too, on which there is nothing: so all have states of one size.
    """

    def __init__(self, config: PadFilterConfig) -> None:
        across, up = _horizontal(config), _vertical(config)
        self.count = len(across.A) + len(up.A)
        self.groups = (slice(0, len(across.A)), slice(len(across.A), self.count))
        self.acceleration_variance = np.concatenate((across.acceleration_variance, up.acceleration_variance))
        self.jerk_variance = np.concatenate((across.jerk_variance, up.jerk_variance))
        # the last two are what jerk alone gathers in a turn, and noise of the velocity in any model
        alone = np.array([np.diag([0.0, 0.0, 1.0, 0.0]), np.diag([0.0, 1.0, 0.0, 0.0])])
        A = np.concatenate((across.A, up.A, across.A[[TURN, TURN]]))
        self._series = _Series(A, np.concatenate((across.W, up.W, alone)))

    def step(
        self, dt_s: float, turn: Turn, vehicle_density_m2_s3: float, unseen: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """F and Q (m, 8, 8) over dt_s; the density is of the noise of the vehicle's acceleration.

        `unseen` (2, 2) is the covariance of the vehicle's motion as of `MotionHistory.moved`.
        The turn rate's variance acts on the acceleration as jerk: an error that lasts is as harmful as a
        white one of that density after a second. Within a short time Q leaves out that noise turns, too.
        """
        short_s, doublings = _shortened(dt_s)
        one_axis = self._series.at(short_s)
        noise = one_axis[1]
        noise[TURN] += turn.variance * turn.acceleration_m_s2**2 * noise[-2]
        noise += vehicle_density_m2_s3 * noise[-1]
        F, Q = both = np.zeros((2, self.count, 8, 8))
        both[:, :, ::2, ::2] = one_axis[:, :-2]
        F[:, 1::2, 1::2] = one_axis[0, :-2]
        plane, _ = self.groups
        Q[plane, 1::2, 1::2] = noise[plane]
        self._turn(F, short_s, turn.rate_rad_s)
        for _ in range(doublings):
            Q = F @ Q @ F.transpose(0, 2, 1) + Q
            F = F @ F
        if unseen is not None:
            Q[:, 0:4:2, 0:4:2] += unseen
            Q[plane, 1:4:2, 1:4:2] += unseen
        return F, Q

    @staticmethod
    def _turn(F: FloatArray, t: float, turn_rate_rad_s: float) -> None:
        """What acceleration and jerk become: exp(s t) and exp(r t) in the complex plane, and their integrals.

        s = -1/tau + i omega, r = -1/tau_j + i omega; the jerk's share of the acceleration is
        (exp(s t) - exp(r t)) / (s - r), which has no imaginary part: the two turn alike.
        """
        s = complex(-1.0 / TURN_TIME_CONSTANT_S, turn_rate_rad_s)
        r = complex(-1.0 / TURN_JERK_TIME_CONSTANT_S, turn_rate_rad_s)
        apart = 1.0 / (s.real - r.real)
        (a, b, c), (d, e, f) = _integrals(s, t), _integrals(r, t)
        factors = (a, b, c, (a - d) * apart, (b - e) * apart, (c - f) * apart, f)
        F[TURN].put(_TURNED, [part for z in factors for part in (z.real, -z.imag, z.imag, z.real)])


class _Series:
    """exp(A t), and the noise that gathers meanwhile, of several models: coefficients by powers of t.

    From F' = A F and Q' = A Q + Q A' + W, term by term.
    """

    def __init__(self, A: FloatArray, W: FloatArray) -> None:
        F, Q = [np.broadcast_to(np.eye(A.shape[1]), A.shape)], [np.zeros_like(A), W]
        for k in range(1, TERMS):
            F.append(A @ F[-1] / k)
        for k in range(2, TERMS):
            Q.append((A @ Q[-1] + Q[-1] @ A.transpose(0, 2, 1)) / k)
        self._shape = (2, *A.shape)
        self._terms = np.hstack([np.array(terms).reshape(TERMS, -1) for terms in (F, Q)])

    def at(self, t: float) -> FloatArray:
        """F and Q (2, m, n, n) at a short time."""
        return (t**_EXPONENTS @ self._terms).reshape(self._shape)


def _horizontal(config: PadFilterConfig) -> _Kinds:
    """Steady, manoeuvre, turn and sway; the turn without its turning."""
    fades_s = (STEADY_TIME_CONSTANT_S, MANOEUVRE_TIME_CONSTANT_S)
    steady = 2.0 * STEADY_ACCELERATION_STD_M_S2**2 / STEADY_TIME_CONSTANT_S
    jerks = (steady, config.manoeuvre_jerk_m_s3_rthz**2)
    variance = config.sway_acceleration_std_m_s2**2
    w0 = math.tau / config.sway_period_s
    snap = config.turn_snap_m_s4_rthz**2
    kinds = [
        *(_fading(1.0 / fade, q, w0, variance) for q, fade in zip(jerks, fades_s, strict=True)),
        _bending(snap),
        _waving(w0, SWAY_DAMPING, variance),
    ]
    fading = (0.5 * q * fade for q, fade in zip(jerks, fades_s, strict=True))
    jerk_variance = np.full(len(kinds), variance * w0**2)
    jerk_variance[TURN] = 0.5 * snap * TURN_JERK_TIME_CONSTANT_S
    A, W = map(np.array, zip(*kinds, strict=True))
    return _Kinds(A, W, np.array([*fading, TURN_ACCELERATION_STD_M_S2**2, variance]), jerk_variance)


def _vertical(config: PadFilterConfig) -> _Kinds:
    """Still, and waves of each period."""
    rest, variance = REST_ACCELERATION_STD_M_S2**2, config.wave_acceleration_std_m_s2**2
    fade = 1.0 / STEADY_TIME_CONSTANT_S
    rates = [math.tau / period_s for period_s in config.wave_periods_s]
    middle = sum(rates) / len(rates)
    kinds = [_fading(fade, 2.0 * rest * fade, middle, variance)]
    kinds += [_waving(w0, WAVE_DAMPING, variance) for w0 in rates]
    A, W = map(np.array, zip(*kinds, strict=True))
    spread = np.array([rest, *[variance] * len(rates)])
    return _Kinds(A, W, spread, variance * np.square([middle, *rates]))


def _shortened(dt_s: float) -> tuple[float, int]:
    """A short time, and how often to double it."""
    doublings = max(0, math.ceil(math.log2(dt_s / SHORT_S))) if dt_s > SHORT_S else 0
    return math.ldexp(dt_s, -doublings), doublings


def _fading(fade: float, jerk: float, wait: float, wait_variance: float) -> tuple[FloatArray, FloatArray]:
    """A and W (4, 4) of an acceleration that fades at a rate (1/s), driven by white jerk.

    It has no use for j, which waits as waves would have it: at their rate (1/s), with their spread.
    """
    A = np.eye(4, k=1)
    A[2, 2], A[2, 3], A[3, 3] = -fade, 0.0, -wait
    return A, np.diag([0.0, 0.0, jerk, 2.0 * wait_variance * wait**3])


def _bending(snap: float) -> tuple[FloatArray, FloatArray]:
    """A and W (4, 4) of an acceleration whose jerk lasts, driven by white snap; not turning."""
    A = np.eye(4, k=1)
    A[2, 2], A[3, 3] = -1.0 / TURN_TIME_CONSTANT_S, -1.0 / TURN_JERK_TIME_CONSTANT_S
    return A, np.diag([0.0, 0.0, TURN_JERK_M_S3_RTHZ**2, snap])


def _integrals(pole: complex, t: float) -> tuple[complex, complex, complex]:
    """exp(pole t) integrated twice, once, and itself."""
    grown = cmath.exp(pole * t)
    once = (grown - 1.0) / pole
    return (once - t) / pole, once, grown


def _waving(w0: float, damping: float, variance: float) -> tuple[FloatArray, FloatArray]:
    """A and W (4, 4) of an acceleration that oscillates at w0 (rad/s), with this stationary variance."""
    A = np.eye(4, k=1)
    A[3, 2], A[3, 3] = -w0 * w0, -2.0 * damping * w0
    return A, np.diag([0.0, 0.0, 0.0, 4.0 * damping * w0**3 * variance])
