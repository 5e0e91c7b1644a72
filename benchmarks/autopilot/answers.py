"""The figures of one flight by recorded setpoints: how fast, how far over, how long to stop, what was said.

Every figure is a number found by the same code in both records, None where the flight did not show it. A
manoeuvre is a run of one and the same streamed setpoint. Signals are taken along the setpoint, from what they
were in the half second before it; t63 and t90 count from its first frame. NED, SI units, degrees in names.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.autopilot.autopilot_record import ON_GROUND, AutopilotRecord, Stamped, decoder, record_of
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray
from sitl.autopilot.control.estimator import ESTIMATORS, EstimatorName
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.pad.paths import Meeting, StaticMotion
from sitl.run.simulation import PHYSICS_STEP_S
from sitl.scenario.scenario import PadSettings, Scenario, magnetic_field_ned_ut
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.world.world import World

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


# ---------------------------------------------------------------- what was said
# Answers to commands, modes and landed states of two flights by the same client, side by side.
#
# Modes are told by the heartbeat, once a second, so a change counts as the same within a little more than
# that.

SET_MESSAGE_INTERVAL: Final = 511
HEARTBEAT_S: Final = 1.2
RESULTS: Final = ("accepted", "temporarily rejected", "denied", "unsupported", "failed")
STATES: Final = {0: "?", 1: "on ground", 2: "in air", 3: "take-off", 4: "landing"}
# said in flight, of what a client may wait for
TEXTS: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "ardupilot": ("Arming motors", "Disarming motors"),
    "px4": (),
}


@dataclass(frozen=True)
class Saying:
    """One row of words."""

    name: str
    recorded: str
    ours: str
    holds: bool


def sayings(autopilot_kind: AutopilotKind, recorded: AutopilotRecord, ours: AutopilotRecord) -> list[Saying]:
    """All rows of words."""
    rows = _answers(recorded, ours) + _modes(recorded, ours)
    states = (_states(recorded), _states(ours))
    rows.append(Saying("landed states", *states, holds=states[0] == states[1]))
    for text in TEXTS[autopilot_kind]:
        theirs, our = (_says(record, text) for record in (recorded, ours))
        rows.append(Saying(f'text "{text}"', theirs, our, holds=theirs == our))
    return rows


def _answers(recorded: AutopilotRecord, ours: AutopilotRecord) -> list[Saying]:
    """What became of each command; requests for streams in one row, told apart by their answers."""
    rows, streams = [], [0, 0]
    for index, (theirs, our) in enumerate(zip(_acks(recorded), _acks(ours), strict=False)):
        if theirs[0] == SET_MESSAGE_INTERVAL:
            streams[0] += 1
            streams[1] += theirs == our
            continue
        words = tuple(RESULTS[result] for _, result in (theirs, our))
        name = f"answer {index + 1}, to command {theirs[0]}"
        rows.append(Saying(name, words[0], words[1], holds=theirs == our))
    same = f"{streams[1]} the same"
    return [Saying("answers to stream requests", f"{streams[0]}", same, streams[0] == streams[1]), *rows]


def _acks(record: AutopilotRecord) -> list[tuple[int, int]]:
    """The answers in order; one given twice in a row (PX4 does) counts once for each command sent."""
    asked = [s for s in record.sent if s.message.get_type() == "COMMAND_LONG"]
    answers: list[tuple[int, int]] = []
    for i, sent in enumerate(asked):
        until = asked[i + 1].time_s + 0.02 if i + 1 < len(asked) else sent.time_s + 2.0
        heard = [s.what for s in record.heard("ack", sent.time_s, until) if s.what[0] == sent.message.command]
        answers.append(heard[0] if heard else (sent.message.command, 4))
    return answers


def _modes(recorded: AutopilotRecord, ours: AutopilotRecord) -> list[Saying]:
    end_s = _disarmed_s(recorded)
    theirs, our = _mode_changes(recorded, end_s), _mode_changes(ours, end_s + HEARTBEAT_S)
    rows = []
    for index, (time_s, mode) in enumerate(theirs):
        match = our[index] if index < len(our) else None
        said = "-" if match is None else f"{match[1]:#x} at {match[0]:.1f} s"
        same = match is not None and match[1] == mode and abs(match[0] - time_s) <= HEARTBEAT_S
        rows.append(Saying(f"mode change {index + 1}", f"{mode:#x} at {time_s:.1f} s", said, same))
    return rows


def _client_s(record: AutopilotRecord) -> float:
    """When the client began to stream setpoints."""
    return next(s.time_s for s in record.sent if s.message.get_type() == "SET_POSITION_TARGET_LOCAL_NED")


def _disarmed_s(record: AutopilotRecord) -> float:
    """When the motors had stopped after the flight, as told by the heartbeat."""
    stopped = [s.time_s for s in record.heard("armed", _client_s(record) + 60.0) if not s.what]
    return stopped[0] if stopped else float(record.motion[-1, 0])


def _mode_changes(record: AutopilotRecord, end_s: float) -> list[tuple[float, Any]]:
    """After the client's first setpoints, before the end."""
    return [(s.time_s, s.what) for s in record.heard("mode", _client_s(record) + 5.0, end_s)]


def _says(record: AutopilotRecord, text: str) -> str:
    return "said" if text in {said.what for said in record.heard("text")} else "not said"


def _states(record: AutopilotRecord) -> str:
    states: list[int] = []
    for said in record.heard("landed"):
        if (not states or states[-1] != said.what) and said.what:
            states.append(said.what)
    first = next((i for i, state in enumerate(states) if state == ON_GROUND), 0)
    return ", ".join(STATES[state] for state in states[first:])


# ---------------------------------------------------------------- setpoint flight
# Our vehicle flown by a recorded client: the same bytes at the same times, in virtual time and calm air.
#
# The frames go through the simulated autopilot's MAVLink endpoint, and what leaves it is read as a record is,
# so the whole path is measured: parsing, masks, modes, control, plant, estimator, telemetry.

STEPS_PER_TALK: Final = 2
AFTER_S: Final = 3.0
FAR_M: Final = 99.0  # no rangefinder's echo
AIRFRAMES: Final[dict[AutopilotKind, str]] = {"px4": "sih", "ardupilot": "arducopter_sitl"}
ESTIMATOR_OF: Final[dict[AutopilotKind, EstimatorName]] = {"px4": "sih", "ardupilot": "arducopter_sitl"}


def fly(autopilot_kind: AutopilotKind, recorded: AutopilotRecord, seed: int) -> AutopilotRecord:
    """Fly our vehicle by what was sent in a recording; it boots as long before as the recorded one did."""
    scenario = Scenario(
        name="setpoints",
        description="calm air, the pad far away",
        autopilot=autopilot_kind,
        airframe=AIRFRAMES[autopilot_kind],
        start_heading_deg=0.0,
        pad=PadSettings(motion=StaticMotion(kind="static", meet=Meeting(point_ned_m=(200.0, 200.0)))),
    )
    world = World(scenario, seed)
    errors = ESTIMATORS[ESTIMATOR_OF[autopilot_kind]]
    airframe = world.airframe
    rng = np.random.default_rng((seed, 20))
    autopilot = SimulatedAutopilot(autopilot_kind, airframe.body, rng, scenario.place, errors, airframe.rates)
    sensors = SimulatedAutopilotSensors(
        np.random.default_rng((seed, 21)),
        PHYSICS_STEP_S,
        home=scenario.place,
        field_ned_ut=magnetic_field_ned_ut(scenario.place),
        imu_filter=autopilot.profile.imu_filter,
    )
    endpoint = MavlinkEndpoint(autopilot, sensors)
    lead_s = -recorded.booted_s
    waiting = iter(recorded.sent)
    due = next(waiting, None)
    heard: list[Stamped] = []
    decode = decoder()
    end_s = recorded.sent[-1].time_s + AFTER_S
    steps = 0
    while (now_s := world.time_s - lead_s) < end_s:
        while due is not None and due.time_s <= now_s:
            endpoint.receive(due.frame, world.time_s)
            heard.append(due)
            due = next(waiting, None)
        motors = autopilot.step(world.state, PHYSICS_STEP_S, world.time_s)
        world.step(motors, PHYSICS_STEP_S)
        sensors.step(world.time_s, world.state, 0.25 * sum(motors), lambda: FAR_M)
        steps += 1
        if steps % STEPS_PER_TALK == 0:
            data = endpoint.transmit(world.time_s)
            heard.extend(Stamped(now_s, message, b"") for message in decode(data))
    return record_of(heard, start_s=0.0)
