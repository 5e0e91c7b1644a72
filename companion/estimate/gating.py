"""Innovation tests, and measurements that arrive late or out of order.

A measurement is accepted if its normalised innovation squared is below a chi-square bound. A late one is
fused at its own time: the filter returns to its state before that time, takes the measurement, and then all
newer ones again. So the result is exactly that of a measurement on time. A filter that can propagate its
errors (`carried`) need not take the newer ones again: it propagates the change by the late measurement.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from companion.base.geometry import FloatArray, Vector3, vector3

# 99.9 % points of the chi-square distribution by degrees of freedom (any statistics table)
CHI_SQUARE_999: Final = {1: 10.828, 2: 13.816, 3: 16.266, 4: 18.467}

FEWEST_REFUSED: Final = 3  # in a row, for a filter to be in error


def normalised_innovation_squared(innovation: FloatArray, covariance: FloatArray) -> float:
    """y' S^-1 y of an innovation (m,) with covariance (m, m).

    Raises:
        numpy.linalg.LinAlgError: the covariance is singular.
    """
    return float(innovation @ np.linalg.solve(covariance, innovation))


def passes(y: Vector3, S: tuple[float, ...]) -> bool:
    """Whether an innovation of three axes passes; its covariance by the upper triangle, row by row.

    By Cramer's rule, for a call of a solver costs more than that.
    """
    a, b, c, d, e, f = S
    u, v, w = y
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    squares = p * u * u + (a * f - c * c) * v * v + (a * d - b * b) * w * w
    products = q * u * v + r * u * w + (b * c - a * e) * v * w
    return (squares + 2.0 * products) / (a * p + b * q + c * r) <= CHI_SQUARE_999[3]


def fits(innovation: FloatArray, covariance: FloatArray) -> bool:
    """Whether an innovation (m,) with this covariance (m, m) passes.

    Raises:
        numpy.linalg.LinAlgError: the covariance is singular.
        ZeroDivisionError: the same, of three axes.
    """
    if len(innovation) == 3:
        (a, b, c), (_, d, e), (_, _, f) = covariance.tolist()
        return passes(vector3(innovation), (a, b, c, d, e, f))
    return normalised_innovation_squared(innovation, covariance) <= CHI_SQUARE_999[len(innovation)]


class Gate(NamedTuple):
    """How one kind of measurement has fared; immutable, so that a snapshot may hold it."""

    accepted: int = 0
    refused: int = 0
    refused_in_a_row: int = 0
    refused_since_s: float = 0.0
    refused_last_s: float = 0.0
    longest_pause_s: float = 0.0  # between two of those in a row

    def after(self, passed: bool, time_s: float) -> Gate:
        """The record with one more measurement in it."""
        if passed:
            return Gate(self.accepted + 1, self.refused)
        row = self if self.refused_in_a_row else Gate(refused_since_s=time_s, refused_last_s=time_s)
        return Gate(
            self.accepted,
            self.refused + 1,
            row.refused_in_a_row + 1,
            row.refused_since_s,
            time_s,
            max(row.longest_pause_s, time_s - row.refused_last_s),
        )

    def opened(self) -> Gate:
        """Without those refused in a row: they have been dealt with."""
        return Gate(self.accepted, self.refused)

    def shut_out(self, time_s: float, timeout_s: float) -> bool:
        """Whether all measurements have been refused for so long that the filter must be the one in error.

        While none came none was refused: a pause counts for no more than all but one of the fewest, each of
        which has its share of the time.
        """
        silent_s = max(self.longest_pause_s - timeout_s * (1.0 - 1.0 / FEWEST_REFUSED), 0.0)
        refused_s = time_s - self.refused_since_s - silent_s
        return self.refused_in_a_row >= FEWEST_REFUSED and refused_s >= timeout_s


S = TypeVar("S")
I_contra = TypeVar("I_contra", contravariant=True)
Item = TypeVar("Item")


class Replayable(Protocol[S, I_contra]):
    """A filter whose state can be put back. What `snapshot` returns must never change afterwards."""

    def snapshot(self) -> S:
        """The whole state, counters included."""
        ...

    def restore(self, snapshot: S) -> None:
        """Go back to a snapshot."""
        ...

    def apply(self, time_s: float, item: I_contra) -> None:
        """Predict to time_s and take the item in."""
        ...


# The states after a late input, taken from the first state on, and after each of the newer inputs, of which
# those without it are given. None when they have to be taken again; the filter may be left in any state.
Carried = Callable[[S, Sequence[S], float, Item], list[S] | None]


class Timeline(Generic[S, Item]):
    """The last `span_s` of a filter's inputs with the state after each: late ones are put in their place."""

    def __init__(
        self, target: Replayable[S, Item], span_s: float, carried: Carried[S, Item] | None = None
    ) -> None:
        """`carried`: how the filter carries what a late input changes over newer ones, if it can."""
        self._target, self._span_s, self._carried = target, span_s, carried
        self._first = target.snapshot()
        self._times_s: list[float] = []
        self._items: list[Item] = []
        self._after: list[S] = []

    def add(self, time_s: float, item: Item) -> bool:
        """Take an input at its own time; False when it is older than everything remembered.

        Inputs of the same time are taken in the order of their arrival.
        """
        place = bisect_right(self._times_s, time_s)
        if self._times_s and place == 0:
            return False
        carried = None
        if self._carried is not None and place < len(self._times_s):
            carried = self._carried(self._after[place - 1], self._after[place:], time_s, item)
        self._times_s.insert(place, time_s)
        self._items.insert(place, item)
        if carried is not None:
            self._after[place:] = carried
            self._target.restore(carried[-1])
        else:
            self._take_again(place)
        self._forget()
        return True

    def replace(self, since_s: float, entries: Sequence[tuple[float, Item]]) -> None:
        """In place of all inputs since a time take these, in order, and not older."""
        place = bisect_left(self._times_s, since_s)
        self._times_s[place:] = [time_s for time_s, _ in entries]
        self._items[place:] = [item for _, item in entries]
        self._take_again(place)

    def _take_again(self, place: int) -> None:
        """Take all inputs from a place on."""
        if place < len(self._after):
            self._target.restore(self._after[place - 1] if place else self._first)
        del self._after[place:]
        for when_s, past in zip(self._times_s[place:], self._items[place:], strict=True):
            self._target.apply(when_s, past)
            self._after.append(self._target.snapshot())

    def as_of(self, time_s: float) -> S | None:
        """The state after the last input not newer than time_s; None when nothing that old is remembered."""
        place = bisect_right(self._times_s, time_s)
        return self._after[place - 1] if place else None

    def _forget(self) -> None:
        # the newest entry before the span stays: it is the base for a measurement at the span's start
        old = bisect_right(self._times_s, self._times_s[-1] - self._span_s) - 1
        if old > 0:
            self._first = self._after[old - 1]  # where all that is remembered is taken again
            del self._times_s[:old], self._items[:old], self._after[:old]
