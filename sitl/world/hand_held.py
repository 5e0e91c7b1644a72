"""A world for hand motion: the vehicle is carried over the pad, its rotors stand still.

The same truth as `sitl.world.world` for sensors, camera and autopilot, from a path instead of from forces.
Position, velocity, attitude and rate are those of the path; specific force and angular acceleration are the
means over a step, as those of a flight are: Δv/Δt less gravity in body axes half-way, and Δω/Δt.
NED, FRD, SI.

Hand motion of the vehicle: smooth paths of six degrees of freedom, for calibrations and checks.

A path gives six coordinates and their rates by time (s): forward, right and down (m) of the reference point
from the middle of the pad's surface, along axes along the person's viewing direction, then roll, pitch and
yaw (rad; yaw, then pitch, then roll) against the same axes. All are twice continuously differentiable, so
that specific force and rate have no jumps. Euler angles may run on without bounds: only the rates of the
angles are converted to body rates, never back, so nose up is no singularity.

Hands tremble: a slow sway of the arms below 1 Hz and physiological tremor of 6 to 11 Hz (R. J. Elble and
W. C. Koller, Tremor, 1990), of some millimetres and a few tenths of a degree.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import Vector3, add, quat_from_euler, rotate_yaw
from sitl.scenario.scenario import Scenario
from sitl.vehicle import HandMotion
from sitl.vehicle.quadrotor import QuadrotorState, RotorValues, packed
from sitl.world.world import Effects, World

Six = tuple[float, float, float, float, float, float]
# a coordinate's waves: amplitude (m or rad), frequency (rad/s), phase (rad)
Waves = tuple[tuple[float, float, float], ...]
_NOWHERE: Final[Six] = (0.0,) * 6
_LENGTH, _ANGLE = (0, 1, 2), (3, 4, 5)


class PoseAndRate(NamedTuple):
    """Six coordinates (m, rad) and their rates (m/s, rad/s)."""

    place: Six
    rate: Six


HandPath = Callable[[float], PoseAndRate]


class CarriedMotion(NamedTuple):
    """The intended motion and the tremor of a hand.

    `round_s` is how long the moves take that end where they begin, at rest; infinite for those that go on.
    """

    moves: HandPath
    shake: HandPath
    round_s: float = math.inf


class PoseWaypoint(NamedTuple):
    """A pose that is held for a while, after a move to it."""

    place: Six
    hold_s: float
    move_s: float = 2.0


def arrivals_s(stations: Sequence[PoseWaypoint]) -> list[float]:
    begins = [0.0]
    for before, after in pairwise(stations):
        begins.append(begins[-1] + before.hold_s + after.move_s)
    return begins


def rests(stations: Sequence[PoseWaypoint]) -> HandPath:
    """Minimum-jerk moves from rest to rest; the first move is none, the last rest has no end.

    Minimum jerk is how a human arm reaches (T. Flash and N. Hogan, 1985): 10 τ³ - 15 τ⁴ + 6 τ⁵.
    """
    begins = arrivals_s(stations)

    def at(time_s: float) -> PoseAndRate:
        # the first station that is still to be reached, if there is one
        upcoming = next((k for k, begin in enumerate(begins) if begin > time_s), len(begins))
        last = stations[max(0, upcoming - 1)].place
        if upcoming in (0, len(begins)):
            return PoseAndRate(last, _NOWHERE)
        target, _, move_s = stations[upcoming]
        tau = (time_s - begins[upcoming]) / move_s + 1.0
        if tau <= 0.0:
            return PoseAndRate(last, _NOWHERE)
        share = tau**3 * (10.0 + tau * (6.0 * tau - 15.0))
        speed = 30.0 * (tau * (1.0 - tau)) ** 2 / move_s
        gaps = [b - a for a, b in zip(last, target, strict=True)]
        return PoseAndRate(
            _six(a + share * gap for a, gap in zip(last, gaps, strict=True)),
            _six(speed * gap for gap in gaps),
        )

    return at


def swung(middle: Six, waves: Sequence[Waves]) -> HandPath:
    """Sums of sines about a middle."""

    def at(time_s: float) -> PoseAndRate:
        place, rate = list(middle), [0.0] * 6
        for axis, own in enumerate(waves):
            for amplitude, frequency, phase in own:
                angle = frequency * time_s + phase
                place[axis] += amplitude * math.sin(angle)
                rate[axis] += amplitude * frequency * math.cos(angle)
        return PoseAndRate(_six(place), _six(rate))

    return at


def added(*helds: PoseAndRate) -> PoseAndRate:
    return PoseAndRate(
        _six(map(sum, zip(*(held.place for held in helds), strict=True))),
        _six(map(sum, zip(*(held.rate for held in helds), strict=True))),
    )


def _six(values: Iterable[float]) -> Six:
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)


# ---------------------------------------------------------------- tremor


def tremor(rng: np.random.Generator) -> HandPath:
    """Sway and physiological tremor."""
    waves = []
    for axis in range(6):
        slow, fast = (0.004, 0.00012) if axis in _LENGTH else (math.radians(0.35), math.radians(0.04))
        waves.append(
            (_wave(rng, slow, 0.15, 0.6), _wave(rng, slow / 3.0, 0.6, 1.2), _wave(rng, fast, 6.0, 11.0))
        )
    return swung(_NOWHERE, waves)


def _wave(
    rng: np.random.Generator, amplitude: float, least_hz: float, most_hz: float
) -> tuple[float, float, float]:
    """One sine of about that amplitude, of a frequency between two."""
    return (
        amplitude * float(rng.uniform(0.7, 1.3)),
        math.tau * float(rng.uniform(least_hz, most_hz)),
        float(rng.uniform(0.0, math.tau)),
    )


# ---------------------------------------------------------------- the motions


def _still(standing_m: float, rng: np.random.Generator) -> CarriedMotion:
    """Standing on the pad, which does not tremble."""
    return CarriedMotion(
        rests([PoseWaypoint((0.0, 0.0, -standing_m, 0.0, 0.0, 0.0), math.inf)]), swung(_NOWHERE, ())
    )


def _tumble(standing_m: float, rng: np.random.Generator) -> CarriedMotion:
    """Turned about slowly until every side has been everywhere: no two of the three periods go together."""
    waves: list[Waves] = [()] * 3
    for turn_deg, period_s in ((200.0, 13.0), (105.0, 31.0), (190.0, 21.0)):
        frequency_hz = 1.0 / period_s
        waves.append((_wave(rng, math.radians(turn_deg), 0.9 * frequency_hz, 1.1 * frequency_hz),))
    return CarriedMotion(swung((0.0, 0.0, -1.1, 0.0, 0.0, 0.0), waves), tremor(rng))


# roll and pitch (deg) with each of the six sides down
FACES: Final[tuple[tuple[float, float], ...]] = (
    (0.0, 0.0),
    (180.0, 0.0),
    (90.0, 0.0),
    (-90.0, 0.0),
    (0.0, 90.0),
    (0.0, -90.0),
)


FACE_ROUNDS: Final = 10


def _faces(standing_m: float, rng: np.random.Generator) -> CarriedMotion:
    """Laid down on each of its six sides, level first, the others in any order, none quite straight.

    Repeated, so that an observer may start at any time.
    """
    order = [0, *(int(k) + 1 for k in rng.permutation(len(FACES) - 1))]
    stations = []
    for side in order * FACE_ROUNDS:
        roll, pitch = np.radians(FACES[side]) + np.radians(3.0) * rng.uniform(-1.0, 1.0, 2)
        yaw = float(rng.uniform(-0.5, 0.5))
        stations.append(
            PoseWaypoint((0.0, 0.0, -0.8, float(roll), float(pitch), yaw), 5.0, float(rng.uniform(2.0, 3.0)))
        )
    return CarriedMotion(rests(stations), swung(_NOWHERE, ()))


def _sway(standing_m: float, rng: np.random.Generator) -> CarriedMotion:
    """Swung about over the pad, quickly and slowly, with all six coordinates, the pad mostly in view."""
    waves = []
    for axis, (slow, quick) in enumerate(
        ((0.14, 0.03), (0.14, 0.03), (0.22, 0.03), (0.13, 0.07), (0.13, 0.07), (0.5, 0.12))
    ):
        top_hz = 1.1 if axis in _ANGLE else 0.8
        waves.append((_wave(rng, slow, 0.10, 0.25), _wave(rng, quick, 0.5, top_hz)))
    height_m = float(rng.uniform(1.1, 1.4))
    return CarriedMotion(swung((0.0, 0.0, -height_m, 0.0, 0.0, 0.0), waves), tremor(rng))


HOLD_S: Final = 4.0


def _over_pad(standing_m: float, rng: np.random.Generator) -> CarriedMotion:
    """The moves of `companion check --pad`, one after another, each from the middle and back."""
    low, high = -float(rng.uniform(0.5, 0.6)), -float(rng.uniform(0.95, 1.1))
    turn, tilt = (math.radians(float(rng.uniform(*span))) for span in ((35.0, 55.0), (14.0, 20.0)))
    aside = float(rng.uniform(0.18, 0.26))
    middle = (0.0, 0.0, high, 0.0, 0.0, 0.0)
    moved = [
        (0.0, aside, high, 0.0, 0.0, 0.0),
        (aside, 0.0, high, 0.0, 0.0, 0.0),
        (0.0, 0.0, high, 0.0, 0.0, turn),
        (0.0, 0.0, high, tilt, 0.0, 0.0),
        (0.0, 0.0, high, 0.0, tilt, 0.0),
    ]
    # long enough at first for the check to find an autopilot and to request the first move
    stations = [PoseWaypoint((0.0, 0.0, low, 0.0, 0.0, 0.0), 10.0), PoseWaypoint(middle, HOLD_S)]
    for place in moved:
        stations += [PoseWaypoint(place, HOLD_S, 1.5), PoseWaypoint(middle, HOLD_S, 1.5)]
    stations.append(PoseWaypoint((0.0, 0.0, low, 0.0, 0.0, 0.0), math.inf))
    return CarriedMotion(rests(stations), tremor(rng), arrivals_s(stations)[-1])


# by the height (m) of the reference point when the vehicle stands, and the draws of tremor, sizes and speeds
_MOTIONS: Final[dict[HandMotion, Callable[[float, np.random.Generator], CarriedMotion]]] = {
    "still": _still,
    "tumble": _tumble,
    "faces": _faces,
    "sway": _sway,
    "over-pad": _over_pad,
}


HAND_STREAM: Final = 14  # of the random draws; the world has its own
# the state at time 0 is that after a step
FIRST_STEP_S: Final = 0.0025


class HandHeldWorld(World):
    """A scenario's world under one seed, with the vehicle carried by hand from time 0 on.

    The person stays where the pad is at that time, with a random heading. Motor commands have no effect.
    With `waits`, finite motions stay at their start until `begin`.
    """

    def __init__(self, scenario: Scenario, seed: int, motion: HandMotion, *, waits: bool = False) -> None:
        """Build it.

        Raises:
            ConfigError: the scenario names an airframe or a pad that cannot be read.
        """
        super().__init__(scenario, seed)
        rng = np.random.default_rng((seed, HAND_STREAM))
        self._carrying = _MOTIONS[motion](self.landed_reference_height_m, rng)
        self._begun_s = math.inf if waits and math.isfinite(self._carrying.round_s) else 0.0
        self._origin_ned_m = self.pad_state.position_ned_m
        self._heading_rad = float(rng.uniform(-math.pi, math.pi))
        self.place(self._felt(self._carried(-FIRST_STEP_S), 0.0, FIRST_STEP_S))

    def begin(self) -> None:
        """Start a waiting motion, or restart one that has ended."""
        if self._begun_s == math.inf or self.time_s > self._begun_s + self._carrying.round_s:
            self._begun_s = self.time_s

    def step(self, motor_commands: RotorValues, dt_s: float) -> None:
        self._wind_blows(Effects(()), dt_s)
        self._advance(self._felt(self.state, self.time_s + dt_s, dt_s), dt_s)

    def _felt(self, before: QuadrotorState, time_s: float, dt_s: float) -> QuadrotorState:
        """The state at a time, with the mean accelerations since the one dt before."""
        now = self._carried(time_s)
        moving = now.velocity_ned_m_s + now.attitude + now.rate_body_rad_s
        return packed(before, now.position_ned_m, moving, now.thrust_share, dt_s)

    def _carried(self, time_s: float) -> QuadrotorState:
        """The state of the path at a time."""
        (forward, right, down, roll, pitch, yaw), rate = self._held(time_s)
        offset = rotate_yaw((forward, right, down), self._heading_rad)
        return QuadrotorState(
            position_ned_m=add(self._origin_ned_m, offset),
            velocity_ned_m_s=rotate_yaw(rate[:3], self._heading_rad),
            attitude=quat_from_euler(roll, pitch, self._heading_rad + yaw),
            rate_body_rad_s=body_rate(roll, pitch, rate[3:]),
        )

    def _held(self, time_s: float) -> PoseAndRate:
        """Pose and rates relative to the middle of the pad; tremor included also while waiting."""
        moves = self._carrying.moves(time_s - self._begun_s)
        return added(moves, self._carrying.shake(time_s))


def body_rate(roll_rad: float, pitch_rad: float, euler_rate_rad_s: Vector3) -> Vector3:
    """The body's rate (FRD) from the rates of roll, pitch and yaw; right at every pitch."""
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    roll, pitch, yaw = euler_rate_rad_s
    return (roll - sp * yaw, cr * pitch + sr * cp * yaw, cr * cp * yaw - sr * pitch)
