"""The estimators' figures over many flights, and which of their bars hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.state.consistency import Consistency, consistency, nees
from benchmarks.state.costs import Costs
from benchmarks.state.fault_flights import LARGEST_ATTITUDE_DEG, RECOVERY_S, FaultFlight, usual_for
from benchmarks.state.samples import Samples, rms
from companion.base.geometry import FloatArray
from companion.sim.trial import Trial

PAD_SCENARIO: Final = "figure_8"  # the bars are for this one, and it flies under more vibration, too
VIBRATION: Final = (1.0, 2.0, 4.0)
ATTITUDE_DEG: Final = {1.0: 1.0, 2.0: 1.2, 4.0: 2.0}  # by the vibration
VELOCITY_M_S: Final = 0.10
PAD_VELOCITY_M_S: Final = 0.10
STEP_US: Final = 100.0
SEEN_S: Final = 2.0
COST_BARS: Final = ("EKF: predict + IMU update", "pad filter: predict + sighting")


@dataclass(frozen=True, slots=True)
class FlightCase:
    """A scenario, under so many times its usual vibration."""

    scenario: str
    vibration: float = 1.0

    @property
    def name(self) -> str:
        """For tables."""
        return self.scenario if self.vibration == 1.0 else f"{self.scenario}, {self.vibration:g} x vibration"

    @property
    def slug(self) -> str:
        """For files."""
        return self.scenario if self.vibration == 1.0 else f"{self.scenario}_x{self.vibration:g}"

    @property
    def attitude_bar_deg(self) -> float | None:
        """None: not judged."""
        return ATTITUDE_DEG.get(self.vibration) if self.scenario == PAD_SCENARIO else None

    def trial(self, seed: int) -> Trial:
        """One flight of it."""
        trial = Trial.load(self.scenario, seed)
        sensors = trial.scenario.sensors.model_copy(update={"vibration_factor": self.vibration})
        return replace(trial, scenario=trial.scenario.model_copy(update={"sensors": sensors}))


def cases_of(scenarios: Sequence[str], vibration: Sequence[float]) -> list[FlightCase]:
    """Each scenario as it is; the one with the bars under every vibration."""
    cases = []
    for scenario in scenarios:
        factors = vibration if scenario == PAD_SCENARIO else (1.0,)
        cases += [FlightCase(scenario, factor) for factor in factors]
    return cases


@dataclass(frozen=True)
class FlightErrors:
    """One flight in the air, and while the pad has been seen for 2 s."""

    case: FlightCase
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


def consistencies(flights: Sequence[FlightErrors]) -> dict[str, Consistency]:
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


def bars(
    flights: Sequence[FlightErrors], by_case: dict[FlightCase, dict[str, Consistency]]
) -> dict[str, bool]:
    """Which bars hold; of figure-8 one by one for each vibration."""
    held: dict[str, bool] = {}
    for case, figures in by_case.items():
        bar_deg = case.attitude_bar_deg
        if bar_deg is None:
            continue
        own = [flight for flight in flights if flight.case == case]
        air, seen = [flight.air for flight in own], [flight.seen for flight in own]
        words = {
            "attitude": pooled(air, lambda s: s.attitude_deg) <= bar_deg,
            "velocity": pooled(air, lambda s: s.velocity_m_s) <= VELOCITY_M_S,
            "pad velocity": pooled(seen, lambda s: s.pad_ned_velocity_m_s) <= PAD_VELOCITY_M_S,
            "EKF NEES": figures["EKF: rotation, velocity"].holds,
            "pad NEES": figures["pad: relative position, velocity"].holds,
        }
        held |= {f"{name} at {case.vibration:g} x": holds for name, holds in words.items()}
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
