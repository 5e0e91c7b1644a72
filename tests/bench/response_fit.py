"""From what was asked for and what was flown to gain, lag and dead time, and to the frequency response.

The step response is fitted by y = gain / (lag s + 1) exp(-dead time s) u, the sines by least squares of both
sides. Dead time and lag can stand for each other within a few centiseconds: their sum is what counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from companion.geometry import FloatArray
from tests.bench.response_flight import SAMPLE_S, Flown
from tests.bench.response_plan import MEASURED_CYCLES


@dataclass(frozen=True)
class Response:
    """How one kind of setpoint is answered; `sines` are gain and phase (deg, negative: behind) by frequency."""

    gain: float
    lag_s: float
    dead_s: float
    sines: dict[float, tuple[float, float]]


DEAD_S: Final = tuple(0.01 * n for n in range(0, 51))


def response(runs: Sequence[Flown]) -> Response:
    """Of one group."""
    gain, lag_s, dead_s = _first_order([run for run in runs if run.frequency_hz is None])
    sines = {run.frequency_hz: _sine(run) for run in runs if run.frequency_hz is not None}
    return Response(gain, lag_s, dead_s, sines)


def _sine(run: Flown) -> tuple[float, float]:
    """Gain and phase (deg) over the measured cycles."""
    assert run.frequency_hz is not None
    count = round(MEASURED_CYCLES / run.frequency_hz / SAMPLE_S)
    asked, flown = (_phasor(side[-count:], run.frequency_hz) for side in (run.asked, run.flown))
    ratio = flown / asked
    return abs(ratio), math.degrees(math.remainder(np.angle(ratio), 2.0 * math.pi))


def _phasor(values: FloatArray, frequency_hz: float) -> complex:
    """Of a sine on a slow drift."""
    t = SAMPLE_S * np.arange(len(values))
    w = 2.0 * math.pi * frequency_hz
    base = np.column_stack([np.cos(w * t), np.sin(w * t), np.ones_like(t), t])
    cosine, sine, *_ = np.linalg.lstsq(base, values, rcond=None)[0].tolist()
    return complex(cosine, -sine)


def _first_order(runs: Sequence[Flown]) -> tuple[float, float, float]:
    """Gain, lag and dead time (s) with the least squares over all runs."""

    def miss(x: FloatArray) -> float:
        return _fit(runs, max(0.0, float(x[0])), max(0.0, float(x[1])))[1]

    starts = [(lag, dead) for lag in (0.05, 0.2, 0.6) for dead in (0.03, 0.15)]
    fits = [minimize(miss, start, method="Nelder-Mead") for start in starts]
    lag_s, dead_s = (max(0.0, float(value)) for value in min(fits, key=lambda fit: fit.fun).x)
    return _fit(runs, lag_s, dead_s)[0], lag_s, dead_s


def _fit(runs: Sequence[Flown], lag_s: float, dead_s: float) -> tuple[float, float]:
    """The best gain for a lag and a dead time, and the squares that it leaves."""
    models, flown = [], []
    for run in runs:
        shaped = _lagged(_delayed(run.asked, dead_s), lag_s)
        models.append(shaped)
        flown.append(run.flown - run.flown[0])
    model, measured = np.concatenate(models), np.concatenate(flown)
    gain = float(model @ measured / max(1e-12, model @ model))
    return gain, float(np.sum((measured - gain * model) ** 2))


def _delayed(values: FloatArray, dead_s: float) -> FloatArray:
    at = np.arange(len(values)) - dead_s / SAMPLE_S
    delayed: FloatArray = np.interp(at, np.arange(len(values)), values, left=0.0)
    return delayed


def _lagged(values: FloatArray, lag_s: float) -> FloatArray:
    keep = math.exp(-SAMPLE_S / lag_s) if lag_s > 1e-4 else 0.0
    lagged: FloatArray = lfilter([1.0 - keep], [1.0, -keep], values)
    return lagged
