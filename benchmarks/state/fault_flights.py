"""Flights in which a sensor fails, and how far off the estimates go before they are back.

Faults of the inertial half fall on a long way to the waypoint, so that even half a minute is over before the
pad comes into view; those of the pad's half fall on the descent. Each flight is compared with the same one
without the fault: the largest error of that one from the fault's time on is the usual level.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.faults.cases import changed
from benchmarks.state.consistency import recovery_s
from benchmarks.state.samples import Samples
from companion.base.geometry import FloatArray
from companion.sim.trial import Trial

BASE: Final = "figure_8"
LARGEST_ATTITUDE_DEG: Final = 5.0
RECOVERY_S: Final = 2.0
USUAL_MARGIN: Final = 1.25  # two flights differ, fault or not
# the autopilot flies there in about half a minute
FAR: Final[dict[str, Any]] = {
    "pad": {"motion": {"meet": {"point_ned_m": [110.0, 0.0], "time_s": 60.0}}},
    "companion": {"plan": {"mission": {"waypoint_ned_m": [110.0, 0.0]}}},
}
NEAR: Final[dict[str, Any]] = {}


@dataclass(frozen=True)
class FlightFault:
    """One fault on one kind of flight; `pad`: whether the pad's errors are what it is about."""

    name: str
    changes: dict[str, Any]
    fault: dict[str, Any] | None
    pad: bool = False

    @property
    def slug(self) -> str:
        """The name as a file's."""
        return "fault_" + "_".join(re.findall(r"[a-z0-9]+", self.name.lower()))

    @property
    def judged_from_s(self) -> float:
        """When the recovery's time starts to count: the fault's end, or its start when it stays."""
        fault = self.fault or {"start_s": 0.0}
        judged_s: float = fault["start_s"] + fault.get("duration_s", 0.0)
        return judged_s


def _far(name: str, kind: str, start_s: float = 16.0, **settings: Any) -> FlightFault:
    """On the way to the waypoint."""
    return FlightFault(name, FAR, {"kind": kind, "start_s": start_s, **settings})


def _near(name: str, kind: str, **settings: Any) -> FlightFault:
    """On the descent."""
    return FlightFault(name, NEAR, {"kind": kind, "start_s": 16.0, **settings}, pad=True)


CASES: Final = (
    FlightFault("none, far", FAR, None),
    _far("GPS gone for 30 s", "gps_lost", 12.0, duration_s=30.0),
    _far("30 µT for 5 s", "mag_disturbed", duration_s=5.0, field_body_ut=[0.0, 30.0, 0.0]),
    _far("gyro bias step of 2 °/s", "gyro_bias_step"),
    _far("accelerometer clips for 5 s", "accel_clips", duration_s=5.0),
    _far("4 x vibration for 3 s", "vibration", duration_s=3.0, factor=4.0),
    _far("10 x vibration for 3 s", "vibration", duration_s=3.0, factor=10.0),
    FlightFault("none, near", NEAR, None, pad=True),
    _near("10 x vibration for 3 s, near", "vibration", duration_s=3.0, factor=10.0),
    _near("range spikes, 30 % of the echoes", "range_spikes", share=0.3),
    _near("every 10th frame 250 ms late", "frame_late", duration_s=5.0),
)


@dataclass(frozen=True)
class FaultFlight:
    """One flight's errors, from take-off to touchdown."""

    case: FlightFault
    seed: int
    outcome: str
    samples: Samples

    def errors(self) -> dict[str, FloatArray]:
        """What is watched, (n,) each, in the air; the pad's once it has been in view for 2 s."""
        air = self.samples.where(self.samples.airborne)
        found = {
            "attitude °": air.attitude_deg,
            "velocity m/s": np.linalg.norm(air.velocity_m_s, axis=1),
        }
        if self.case.pad:
            seen = air.seen_for_s >= 2.0
            position = np.linalg.norm(air.pad_position_m, axis=1)
            velocity = np.linalg.norm(air.pad_velocity_m_s, axis=1)
            found["pad m"] = np.where(seen, position, 0.0)
            found["pad m/s"] = np.where(seen, velocity, 0.0)
        return found

    def largest(self, since_s: float) -> dict[str, float]:
        """The largest of each error from a time on."""
        after = self.times_s >= since_s
        return {name: float(np.max(values[after], initial=0.0)) for name, values in self.errors().items()}

    def largest_since_fault(self) -> dict[str, float]:
        """The largest of each error from the fault's start (without one: from take-off) to touchdown."""
        return self.largest(0.0 if self.case.fault is None else self.case.fault["start_s"])

    def recovery_s(self, usual: FaultFlight) -> dict[str, float]:
        """Time (s) until each error is back at what it usually is at that stage of the flight."""
        assert self.case.fault is not None
        levels = usual.largest(self.case.fault["start_s"])
        return {
            name: recovery_s(self.times_s, values, USUAL_MARGIN * levels[name], self.case.judged_from_s)
            for name, values in self.errors().items()
        }

    @property
    def times_s(self) -> FloatArray:
        """(n,) of the errors."""
        times: FloatArray = self.samples.time_s[self.samples.airborne]
        return times


def trial_of(case: FlightFault, seed: int) -> Trial:
    """The base scenario with the case's changes and fault."""
    base = Trial.load(BASE, seed)
    faults = {} if case.fault is None else {"faults": [case.fault]}
    return Trial(base.path, changed(base.scenario, {**case.changes, **faults}), seed)


def usual_for(flight: FaultFlight, flights: Sequence[FaultFlight]) -> FaultFlight:
    """The same flight without the fault."""
    return next(
        other
        for other in flights
        if other.case.fault is None
        and other.seed == flight.seed
        and other.case.changes == flight.case.changes
    )
