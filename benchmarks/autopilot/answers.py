"""The figures of one flight by recorded setpoints: how fast, how far over, how long to stop, what was said.

Every figure is a number found by the same code in both records, None where the flight did not show it. A
manoeuvre is a run of one and the same streamed setpoint. Signals are taken along the setpoint, from what they
were in the half second before it; t63 and t90 count from its first frame. NED, SI units, degrees in names.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.autopilot.autopilot_record import ON_GROUND, AutopilotRecord
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray

Figures = dict[str, float | None]
BEFORE_S: Final = 0.5
STOPPED_M_S, SLOW_M_S = 0.05, 0.5
STOPPING_S: Final = 3.0
SETTLED_S: Final = 6.0
CONTACT_M_S: Final = 0.12


@dataclass(frozen=True)
class Manoeuvre:
    """One setpoint, from its first frame to the first of the next; `last_s` is its own last frame."""

    message: Any
    start_s: float
    last_s: float
    end_s: float


def manoeuvres(record: AutopilotRecord) -> list[Manoeuvre]:
    """Runs of equal setpoints, in order."""
    found: list[Manoeuvre] = []
    for time_s, m, _ in record.sent:
        if not m.get_type().startswith("SET_"):
            continue
        if found and _content(found[-1].message) == _content(m):
            found[-1] = Manoeuvre(found[-1].message, found[-1].start_s, time_s, time_s)
            continue
        if found:
            last = found[-1]
            found[-1] = Manoeuvre(last.message, last.start_s, last.last_s, time_s)
        found.append(Manoeuvre(m, time_s, time_s, time_s))
    return found


def _content(m: Any) -> tuple[Any, ...]:
    return (m.get_type(), *(str(v) for k, v in m.to_dict().items() if k != "time_boot_ms"))


def figures(record: AutopilotRecord, autopilot_kind: AutopilotKind) -> Figures:
    """All rows of the table.

    Raises:
        ValueError: the record lacks a manoeuvre.
    """
    runs = manoeuvres(record)
    result: Figures = {}
    parts = (_positions, _velocities, _down, _yaw, _frames, _acceleration, _attitude, _loss, _landing)
    for part in (*parts, _hover):
        result |= part(record, runs)
    return result | _disarming(record, runs, autopilot_kind)


# ---------------------------------------------------------------- one signal


def _cut(table: FloatArray, start_s: float, end_s: float) -> FloatArray:
    return table[(table[:, 0] >= start_s) & (table[:, 0] < end_s)]


def _crossing(times: FloatArray, values: FloatArray, level: float) -> float | None:
    """When a rising signal first reaches a level, between samples."""
    above = np.nonzero(values >= level)[0]
    if len(above) == 0:
        return None
    i = int(above[0])
    if i == 0 or values[i] == values[i - 1]:
        return float(times[i])
    share = (level - values[i - 1]) / (values[i] - values[i - 1])
    return float(times[i - 1] + share * (times[i] - times[i - 1]))


def _step(table: FloatArray, column: int, run: Manoeuvre, to: float, name: str, over: bool = True) -> Figures:
    """t63, t90 and overshoot of one column's way to a value."""
    before = _cut(table, run.start_s - BEFORE_S, run.start_s)
    after = _cut(table, run.start_s, run.end_s)
    start = float(before[:, column].mean())
    way = (after[:, column] - start) / (to - start)
    times = after[:, 0] - run.start_s
    found: Figures = {f"{name}: t63 (s)": _crossing(times, way, 0.63)}
    found[f"{name}: t90 (s)"] = _crossing(times, way, 0.9)
    if over:
        found[f"{name}: overshoot (%)"] = 100.0 * float(way.max() - 1.0)
    return found


def _first(runs: list[Manoeuvre], fits: Callable[[Any], bool], kind: str = "POSITION") -> Manoeuvre:
    """The first manoeuvre of that description.

    Raises:
        ValueError: the recording has none.
    """
    for run in runs:
        if kind in run.message.get_type() and fits(run.message):
            return run
    raise ValueError("a manoeuvre is missing; expected the sequence that the recordings' README gives")


def _after(runs: list[Manoeuvre], run: Manoeuvre) -> Manoeuvre:
    return runs[runs.index(run) + 1]


def _flies_position(m: Any) -> bool:
    return not m.type_mask & 7


def _flies_velocity(m: Any) -> bool:
    return bool(m.type_mask & 7 == 7 and not m.type_mask & 56)


def _northward(speed: float) -> Callable[[Any], bool]:
    return lambda m: bool(_flies_velocity(m) and m.coordinate_frame == 1 and m.vx == speed)


# ---------------------------------------------------------------- the manoeuvres


def _positions(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    far = _first(runs, lambda m: _flies_position(m) and m.x == 5.0)
    near = _first(runs, lambda m: _flies_position(m) and m.x == 5.0 and m.y > 0.0)
    found = _step(record.motion, 1, far, 5.0, "position 5 m")
    moving = _cut(record.motion, far.start_s, far.end_s)
    found["position 5 m: top speed (m/s)"] = float(np.hypot(moving[:, 4], moving[:, 5]).max())
    return found | _step(record.motion, 2, near, near.message.y, "position 0.3 m")


def _velocities(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    found: Figures = {}
    for speed in (0.5, 2.0):
        run = _first(runs, _northward(speed))
        name = f"velocity {speed:g} m/s"
        found |= _step(record.motion, 4, run, speed, name, over=False)
        stopping = _after(runs, run)
        after = _cut(record.motion, stopping.start_s, stopping.end_s)
        stopped = _crossing(after[:, 0] - stopping.start_s, -after[:, 4], -STOPPED_M_S)
        found[f"{name}: stop to {STOPPED_M_S} m/s (s)"] = stopped
        braking = _cut(after, stopping.start_s, stopping.start_s + STOPPING_S)
        found[f"{name}: stopping distance (m)"] = float(braking[:, 1].max() - braking[0, 1])
    return found


def _down(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    run = _first(runs, lambda m: _flies_velocity(m) and m.vz == 0.5)
    return _step(record.motion, 6, run, 0.5, "down 0.5 m/s")


def _yaw(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    run = _first(runs, lambda m: _flies_velocity(m) and m.yaw > 1.0)
    return _step(record.attitude, 3, run, run.message.yaw, "yaw 90 deg")


def _frames(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    """The last two seconds of four: how fast to the right of north, the nose pointing east, and how deep."""
    found: Figures = {}
    for number, name in ((8, "BODY_NED"), (9, "BODY_OFFSET_NED")):
        run = next(run for run in runs if getattr(run.message, "coordinate_frame", 0) == number)
        late = _cut(record.motion, run.end_s - 2.0, run.end_s)
        found[f"{name}: speed along the nose (m/s)"] = float(late[:, 5].mean())
        found[f"{name}: sink (m/s)"] = float(late[:, 6].mean())
    return found


def _acceleration(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    run = _first(runs, lambda m: m.type_mask & 0x1C0 == 0 and m.afx == 1.0)
    found: Figures = {}
    for after_s in (1.0, 2.0):
        moment = _cut(record.motion, run.start_s + after_s - 0.1, run.start_s + after_s + 0.1)
        found[f"acceleration 1 m/s2: speed after {after_s:g} s (m/s)"] = float(moment[:, 4].mean())
    moving = _cut(record.motion, run.start_s, run.end_s + 1.0)
    found["acceleration 1 m/s2: speed gained (m/s)"] = float(moving[:, 4].max())
    return found


def _attitude(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    forward = _first(runs, lambda m: m.q[2] < -0.05, "ATTITUDE")
    back = _after(runs, forward)
    to = math.radians(-8.0)
    found = _step(record.attitude, 2, forward, to, "pitch -8 deg", over=False)
    for name, run in (("-8", forward), ("+8", back)):
        # the speed goes on with the tilt that is still being turned round
        gained = _cut(record.motion, run.start_s, run.end_s + 0.2)[:, 4]
        change = gained.max() - gained[0] if name == "-8" else gained.max() - gained[-1]
        found[f"pitch {name} deg: speed {'gained' if name == '-8' else 'lost'} (m/s)"] = float(change)
    return found


def _loss(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    run = _first(runs, _northward(1.0))
    flown = _cut(record.motion, run.last_s - 1.0, run.last_s)[:, 4].mean()
    after = _cut(record.motion, run.last_s, run.end_s)
    times, slowing = after[:, 0] - run.last_s, -after[:, 4]
    late = _cut(record.motion, run.last_s + 4.0, run.last_s + 8.0)
    return {
        "setpoints stop: begins to slow down (s)": _crossing(times, slowing, -0.85 * float(flown)),
        "setpoints stop: below 0.5 m/s (s)": _crossing(times, slowing, -SLOW_M_S),
        "setpoints stop: sink (m/s)": float(late[:, 6].mean()),
    }


def _landing(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    fast = _first(runs, lambda m: _flies_velocity(m) and abs(m.vz - 0.7) < 1e-3)
    slow = _after(runs, fast)
    sinking = _cut(record.motion, fast.start_s + 2.0, fast.start_s + 8.0)
    found: Figures = {"descent 0.7 m/s: flown (m/s)": float(sinking[:, 6].mean())}
    final = _cut(record.motion, slow.start_s, slow.end_s)
    contact_s = _crossing(final[:, 0], -final[:, 6], -CONTACT_M_S)
    landed = _landed_s(record, slow)
    found["touchdown: landed_state after contact (s)"] = (
        None if landed is None or contact_s is None else landed - contact_s
    )
    return found


def _landed_s(record: AutopilotRecord, slow: Manoeuvre) -> float | None:
    words = [said for said in record.heard("landed", slow.start_s) if said.what == ON_GROUND]
    return words[0].time_s if words else None


def _disarming(record: AutopilotRecord, runs: list[Manoeuvre], autopilot_kind: AutopilotKind) -> Figures:
    """PX4 disarms by itself once it has landed, ArduCopter when it is told to land."""
    off = [said.time_s for said in record.heard("armed", runs[-1].start_s) if not said.what]
    if autopilot_kind == "px4":
        name, since = "landed_state", _landed_s(record, runs[-1])
    else:
        told = [s.time_s for s in record.sent if s.message.get_type() == "COMMAND_LONG"]
        name, since = "LAND", told[-1]
    value = off[0] - since if off and since is not None else None
    return {f"touchdown: {name} to disarmed (s)": value}


def _hover(record: AutopilotRecord, runs: list[Manoeuvre]) -> Figures:
    """How far place and velocity wander while places are held, each axis about its setpoint."""
    away, speeds = [], []
    for run in runs[1:]:  # the first one climbs
        m = run.message
        if "POSITION" in m.get_type() and _flies_position(m) and run.end_s - run.start_s > SETTLED_S + 1.0:
            held = _cut(record.motion, run.start_s + SETTLED_S, run.end_s)
            away.append(held[:, 1:4] - (m.x, m.y, m.z))
            speeds.append(held[:, 4:7])
    place, speed = np.concatenate(away), np.concatenate(speeds)
    return {
        "hover: place from setpoint, sideways, rms (m)": _rms(place[:, :2]),
        "hover: height from setpoint, rms (m)": _rms(place[:, 2:]),
        "hover: velocity, sideways, rms (m/s)": _rms(speed[:, :2]),
        "hover: velocity, vertical, rms (m/s)": _rms(speed[:, 2:]),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))
