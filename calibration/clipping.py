"""Axes of a sensor that read the end of its range. Pure."""

from typing import Final

import numpy as np

from companion.base.geometry import FloatArray

_SIGMAS: Final = 3.0


def clipped_axes(samples: FloatArray, recorded: FloatArray) -> tuple[int, ...]:
    """The axes of samples (n, 3) that read the end of what was recorded (m, 3) too often.

    What is beyond the range of an axis is read as its end, while the others move. That alone is no sign:
    coarse steps repeat values, too. But where noise leaves an axis at the recording's extreme half of the
    time or more, it is less than a third of a step; then an axis of the same noise has one value half of the
    time at least. So the extreme has to come more than twice as often as any value of the other axes.
    """
    ends = (recorded.min(axis=0), recorded.max(axis=0))
    # equal but for the arithmetic of a mounting
    extreme = np.maximum(*(np.isclose(samples, end).sum(axis=0) for end in ends))
    repeated = [_most_repeated(axis) for axis in samples.T]
    usual = np.array([max(repeated[:k] + repeated[k + 1 :]) for k in range(len(repeated))])
    surplus = extreme - 2 * usual
    return tuple(int(axis) for axis in np.flatnonzero(surplus > _SIGMAS * np.sqrt(extreme + 4 * usual)))


def _most_repeated(values: FloatArray) -> int:
    """How often the most frequent of values (n,) comes."""
    ordered = np.sort(values)
    steps = np.flatnonzero(~np.isclose(ordered[1:], ordered[:-1])) + 1
    return int(np.diff(steps, prepend=0, append=len(values)).max(initial=0))
