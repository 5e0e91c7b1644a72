"""The estimators' figures over many flights, and which of their bars hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from tests.bench.state.consistency import Consistency, consistency, nees
from tests.bench.state.costs import Costs
from tests.bench.state.fault_flights import LARGEST_ATTITUDE_DEG, RECOVERY_S, FaultFlight, usual_for
from tests.bench.state.samples import Samples, rms

PAD_SCENARIO: Final = "figure_8"  # the pad velocity's bar is for this one
ATTITUDE_DEG: Final = 1.0
VELOCITY_M_S: Final = 0.15
PAD_VELOCITY_M_S: Final = 0.12
STEP_US: Final = 200.0
SEEN_S: Final = 2.0
COST_BARS: Final = ("EKF: predict + IMU update", "pad filter: predict + sighting")


@dataclass(frozen=True)
class Flight:
    """One flight in the air, and while the pad has been seen for 2 s."""

    scenario: str
    seed: int
    outcome: str
    samples: Samples

    @property
    def air(self) -> Samples:
        """From take-off to touchdown."""
        return self.samples.where(self.samples.airborne)

    @property
    def seen(self) -> Samples:
        """The pad in view for 2 s at least."""
        return self.air.where(self.air.seen_for_s >= SEEN_S)


def pooled(parts: Sequence[Samples], value: Callable[[Samples], FloatArray]) -> float:
    """Root mean square over the samples of several flights."""
    return rms(np.concatenate([value(part) for part in parts]))


# ---------------------------------------------------------------- consistency


def consistencies(flights: Sequence[Flight]) -> dict[str, Consistency]:
    """The NEES of both filters, whole and in parts."""
    air, seen = [flight.air for flight in flights], [flight.seen for flight in flights]
    result = {}
    for name, first, last in (
        ("EKF: rotation", 0, 3),
        ("EKF: velocity", 3, 6),
        ("EKF: rotation, velocity", 0, 6),
        ("EKF: rotation, velocity, position", 0, 9),
    ):
        result[name] = consistency(last - first, [_vehicle_nees(part, first, last) for part in air])
    for name, first, last in (
        ("pad: relative position", 0, 3),
        ("pad: relative velocity", 3, 6),
        ("pad: relative position, velocity", 0, 6),
    ):
        result[name] = consistency(last - first, [_pad_nees(part, first, last) for part in seen])
    return result


def _vehicle_nees(s: Samples, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    errors = np.hstack([s.rotation_rad, s.velocity_m_s, s.position_m])[:, first:last]
    return _since_start(s), nees(errors, s.covariance[:, first:last, first:last])


def _pad_nees(s: Samples, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    errors = np.hstack([s.pad_position_m, s.pad_velocity_m_s])[:, first:last]
    return _since_start(s), nees(errors, s.pad_covariance[:, first:last, first:last])


def _since_start(s: Samples) -> FloatArray:
    return s.time_s - s.time_s[0] if len(s.time_s) else s.time_s


# ---------------------------------------------------------------- bars


def bars(flights: Sequence[Flight], by_scenario: dict[str, dict[str, Consistency]]) -> dict[str, bool]:
    """Which bars hold; each for every scenario by itself."""
    groups = {name: [f for f in flights if f.scenario == name] for name in by_scenario}
    air = {name: [flight.air for flight in own] for name, own in groups.items()}
    seen = [flight.seen for flight in groups.get(PAD_SCENARIO, [])]
    held = {
        "attitude": all(pooled(parts, lambda s: s.attitude_deg) <= ATTITUDE_DEG for parts in air.values()),
        "velocity": all(pooled(parts, lambda s: s.velocity_m_s) <= VELOCITY_M_S for parts in air.values()),
    }
    if seen:
        held["pad velocity"] = pooled(seen, lambda s: s.pad_ned_velocity_m_s) <= PAD_VELOCITY_M_S
    for label, name in (
        ("EKF NEES", "EKF: rotation, velocity"),
        ("EKF NEES with position", "EKF: rotation, velocity, position"),
        ("pad NEES", "pad: relative position, velocity"),
    ):
        held[label] = all(figures[name].holds for figures in by_scenario.values())
    return held


def fault_bars(flights: Sequence[FaultFlight]) -> dict[str, bool]:
    """No divergence, recovery in time and a landing, whatever the fault."""
    faulted = [flight for flight in flights if flight.case.fault is not None]
    recoveries = [max(flight.recovery_s(usual_for(flight, flights)).values()) for flight in faulted]
    return {
        "no divergence": all(f.largest_since_fault()["attitude °"] < LARGEST_ATTITUDE_DEG for f in faulted),
        "recovery": all(time_s <= RECOVERY_S for time_s in recoveries),
        "landings with faults": all(flight.outcome == "landed" for flight in faulted),
    }


def cost_bars(costs: Costs) -> dict[str, bool]:
    """The two steps that have a bar."""
    return {"cost": all(costs.median_us[kind] <= STEP_US for kind in COST_BARS)}
