"""The faults of `bench_faults`, the phases in which each can happen, and the flights made of them.

Under each seed a fault begins at another moment of its phase.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final, Literal, NamedTuple

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Quantity
from companion.config import merge
from sitl.faults.faults import Fault
from sitl.scenario.as_built import NOTHING_ELSE
from sitl.scenario.scenario import Scenario, load_scenario

StandingBy = Literal["own_take_off", "link_back"]
PhaseName = Literal["start", "search", "approach", "descend", "last_metre", "on_pad"]
PHASES: Final[tuple[PhaseName, ...]] = ("start", "search", "approach", "descend", "last_metre", "on_pad")
IN_AIR: Final[tuple[PhaseName, ...]] = ("search", "approach", "descend", "last_metre")
TO_THE_END: Final[tuple[PhaseName, ...]] = (*IN_AIR, "on_pad")
LOW: Final[tuple[PhaseName, ...]] = ("last_metre", "on_pad")
# whatever happens, the app has given up by then
TIME_LIMIT_S: Final = 220.0

_DELAYS_S: Final = (0.3, 0.8, 1.3, 2.0, 0.0)
_HEIGHTS_M: Final = (0.6, 0.3, 0.15, 0.95, 0.05)
_ON_PAD_DELAYS_S: Final = (0.05, 0.2, 0.4, 0.0, 0.8)


@dataclass(frozen=True, slots=True)
class FaultRowCase:
    """A fault (or several) by the name of its row; `lands`: a landing is possible all the same.

    A fault's own `delay_s` counts from the row's beginning. `changes` are of the scenario: what is wrong from
    the start; `parameters` what the autopilot's are. `signed`: the link is. `stands_by`: so does the app,
    under a pilot who flies this story, and the flight mode that orders a landing is set. `names`: what of a
    quantity has to be in a text where it keeps the vehicle from landing, one of several.
    """

    faults: tuple[dict[str, Any], ...]
    phases: tuple[PhaseName, ...]
    lands: bool = False
    changes: dict[str, Any] = field(default_factory=dict)
    parameters: dict[AutopilotKind, dict[str, float]] = field(default_factory=dict)
    signed: bool = False
    stands_by: StandingBy | None = None
    names: tuple[str, ...] = ()

    @property
    def flown_alone(self) -> bool:
        """Whether its flight has nothing in common with those of other rows."""
        return self.on_disk or bool(self.changes or self.parameters or self.stands_by) or self.signed

    @property
    def on_disk(self) -> bool:
        """Whether its flight is logged on disk; that log has a thread, which no fork takes along."""
        return any(fault["kind"].startswith("disk") for fault in self.faults)


def _case(phases: tuple[PhaseName, ...], *faults: dict[str, Any], lands: bool = False) -> FaultRowCase:
    return FaultRowCase(faults, phases, lands)


def _one(kind: str, phases: tuple[PhaseName, ...] = TO_THE_END, /, **settings: Any) -> FaultRowCase:
    return FaultRowCase(({"kind": kind, **settings},), phases)


def _refused(phases: tuple[PhaseName, ...], *what: str) -> FaultRowCase:
    return FaultRowCase(tuple({"kind": "autopilot_refuses", "what": one} for one in what), phases)


def _from_start(**changes: Any) -> FaultRowCase:
    return FaultRowCase((), ("start",), changes=changes)


def _timed_out(after_s: float, lost_s: float | None = None) -> FaultRowCase:
    """The vehicle's own time-out of setpoints, and a link to it that is lost for so long; None: never."""
    lost = {"kind": "link_blackout", "way": "to_vehicle", "duration_s": lost_s}
    parameters: dict[AutopilotKind, dict[str, float]] = {
        "px4": {"COM_OF_LOSS_T": after_s},
        "ardupilot": {"GUID_TIMEOUT": after_s},
    }
    if lost_s is None:
        return FaultRowCase((), ("start",), parameters=parameters)
    return FaultRowCase((lost,), TO_THE_END, parameters=parameters)


def _built(*names: str, **exactly: Any) -> FaultRowCase:
    """What the builder got wrong, by this much, and in nothing else (`sitl.scenario.as_built`)."""
    changes = {"as_built": {**NOTHING_ELSE, "exactly": exactly}}
    return FaultRowCase((), ("start",), changes=changes, names=names)


_CAMERA: Final[dict[str, FaultRowCase]] = {
    "frames lost 0.2 s": _case(TO_THE_END, {"kind": "frame_lost", "duration_s": 0.2}, lands=True),
    "frames lost 1 s": _case(TO_THE_END, {"kind": "frame_lost", "duration_s": 1.0}, lands=True),
    "frames lost": _one("frame_lost"),
    "frames black": _one("frame_black"),
    "frames garbage": _one("frame_garbage"),
    "frames stuck": _one("frame_stuck"),
    "pad wrong ids": _one("pad_wrong_ids"),
    "pad covered": _one("pad_covered"),
    "pad twin": _one("pad_twin"),
}
_SENSORS: Final[dict[str, FaultRowCase]] = {
    "IMU lost": _one("imu_lost"),
    "IMU stuck": _one("imu_stuck"),
    "IMU NaN": _one("imu_nan"),
    "IMU saturated": _one("imu_saturated"),
    "IMU turned 20 deg": _one("imu_turned", rotation_body_deg=(20.0, 0.0, 0.0)),
    "IMU mounted 12 deg off": _one("imu_turned", ("start",), rotation_body_deg=(12.0, 0.0, 0.0)),
    "30 uT": _case(TO_THE_END, {"kind": "mag_disturbed"}, lands=True),
    "GPS lost": _case(TO_THE_END, {"kind": "gps_lost"}, lands=True),
    "GPS jumps": _one("gps_jump", position_ned_m=(4.0, -5.0, -14.0)),
    "range spikes": _one("range_spikes", share=0.5),
    "range stuck": _one("range_stuck"),
    "range stuck near": _one("range_stuck", distance_m=0.05),
    "range stuck near, from the start": _one("range_stuck", ("start",), distance_m=0.06),
    "range lost": _one("range_lost"),
    "range other echo": _one("range_other_echo"),
}
_LINK: Final[dict[str, FaultRowCase]] = {
    "link lost 1 s": _case(TO_THE_END, {"kind": "link_blackout", "duration_s": 1.0}, lands=True),
    "link lost 5 s": _one("link_blackout", duration_s=5.0),
    "link lost": _one("link_blackout"),
    "link lost to app": _one("link_blackout", way="to_app"),
    "link lost to vehicle": _one("link_blackout", way="to_vehicle"),
    "link half lost": _one("link_loss"),
    "link 0.5 s late": _one("link_delay"),
    "link to app 0.12 s late": _one("link_delay", ("start", *TO_THE_END), extra_s=0.12, way="to_app"),
    "link to vehicle lost 2 s": _one("link_blackout", LOW, way="to_vehicle", duration_s=2.0),
    # the app's HOLD is never acknowledged, and a failsafe lands before the link is back
    "link lost 4 s, LAND": _case(
        IN_AIR,
        {"kind": "link_blackout", "duration_s": 4.0},
        {"kind": "pilot_mode", "mode": "land", "delay_s": 3.0},
    ),
    "time-out 0.3 s, link lost 0.6 s": _timed_out(0.3, 0.6),
    "time-out 3 s": _timed_out(3.0),
    "second companion": _one("second_companion", ("start", *TO_THE_END)),
    "forged frames": FaultRowCase(
        ({"kind": "forged_frames"},), ("start", "descend"), lands=True, signed=True
    ),
}
_PAD: Final[dict[str, FaultRowCase]] = {
    "pad stops": _one("pad_stops"),
    "pad brakes": _one("pad_brakes"),
    "pad turns back": _one("pad_turns_back"),
    "pad leaves at 6 m/s": _one("pad_leaves"),
    "pad vanishes": _one("pad_vanishes", IN_AIR),
    "pad tilts 15 deg": _one("pad_tilts"),
}
_SOLVER: Final[dict[str, FaultRowCase]] = {
    "MPC infeasible": _one("solver_infeasible"),
    "MPC late": _one("solver_late"),
    "MPC NaN": _one("solver_nan"),
}
_AUTOPILOT: Final[dict[str, FaultRowCase]] = {
    "refuses arm": _refused(("start",), "arm"),
    "refuses take-off": _refused(("start",), "take_off"),
    "refuses offboard": _refused(("start",), "offboard"),
    "refuses disarm": _refused(("start", *LOW), "disarm"),
    "refuses LAND": _refused(("start", *LOW), "land"),
    "refuses disarm, LAND": _refused(("start", *LOW), "disarm", "land"),
    "never disarms": _refused(("start", *LOW), "disarm", "land", "auto_disarm"),
    "pilot: Position": _one("pilot_mode", ("start", *TO_THE_END), mode="position"),
    "pilot: Hold": _one("pilot_mode", ("start", *TO_THE_END), mode="hold"),
    "pilot: Return": _one("pilot_mode", mode="return"),
    "disarms": _case(("on_pad",), {"kind": "autopilot_disarms"}, lands=True),
    "autopilot reboots": _one("autopilot_reboots"),
    "autopilot position lost": _one("autopilot_position_lost"),
    "battery low": _one("battery", remaining_percent=18),
    "battery critical": _one("battery", remaining_percent=6),
    "follow me": _one("follow_me", ("start", "search", "descend")),
}
# the flight mode that orders, which an autopilot enters by itself, too
_ORDERS_BY: Final[dict[AutopilotKind, str]] = {"px4": "LOITER", "ardupilot": "GUIDED"}
_STANDING_BY: Final[dict[str, FaultRowCase]] = {
    "flight mode: own take-off": FaultRowCase((), ("start",), stands_by="own_take_off"),
    "flight mode: link back after our abort": FaultRowCase(
        ({"kind": "link_blackout", "duration_s": 60.0},), ("descend",), stands_by="link_back"
    ),
}
_DISK: Final[dict[str, FaultRowCase]] = {
    "disk full": _one("disk_full"),
    "disk slow": _one("disk_slow"),
}
# twice what `sitl.scenario.as_built` draws, one at a time, and what was flown into the ground
_BUILT: Final[dict[str, FaultRowCase]] = {
    "hover told x0.6": _built(Quantity.HOVER_THRUST, hover_thrust=0.6),
    "hover told x1.7": _built(Quantity.HOVER_THRUST, hover_thrust=1.7),
    "thrust exponent 0.4": _built(Quantity.HOVER_THRUST, thrust_exponent=0.4),
    "thrust exponent 3": _built(Quantity.HOVER_THRUST, thrust_exponent=3.0),
    "mass +40 %": _built(Quantity.HOVER_THRUST, mass=1.4),
    "mass -40 %": _built(Quantity.HOVER_THRUST, mass=0.6),
    "legs 6 cm longer": _built(Quantity.LEG_HEIGHT, leg_height_m=0.06),
    "legs 6 cm shorter": _built(Quantity.LEG_HEIGHT, leg_height_m=-0.06),
    "IMU 20 cm off": _built("IMU", imu_offset_body_m=(0.15, -0.13, 0.0)),
    "camera 4 deg off": _built(Quantity.CAMERA_ROTATION, camera_mount_deg=(4.0, -4.0, 4.0)),
    "focal length +3 %": _built(Quantity.PAD_SCALE, focal_length=1.03),
    "print -3 %": _built(Quantity.PAD_SCALE, pad_print=0.97),
    "print -29 %": _built(Quantity.PAD_SCALE, pad_print=0.71),
    "stamps 40 ms late": _built(Quantity.CAMERA_DELAY, stamp_s=0.04, stamp_jitter_s=0.01),
    "stamps 40 ms early": _built(Quantity.CAMERA_DELAY, stamp_s=-0.04, stamp_jitter_s=0.01),
    "delay to app 80 ms": _built(
        Quantity.LINK_DELAY, Quantity.CAMERA_DELAY, Quantity.IMU_DELAY, delay_to_app_s=0.08
    ),
    "delay to vehicle 80 ms": _built(
        Quantity.LINK_DELAY, Quantity.CAMERA_DELAY, Quantity.IMU_DELAY, delay_to_vehicle_s=0.08
    ),
    "vibration x30": _built("vibration", vibration=30.0),
    "place of other files": _built(Quantity.DECLINATION, Quantity.HEADING, place_deg=(-55.0, -70.0)),
    "steel deck 60 uT": _built(Quantity.HEADING, "magnetic field", deck_field_ned_ut=(20.0, 56.0, 10.0)),
    "yaw reset 30 deg": _built(Quantity.HEADING, yaw_reset_deg=30.0, yaw_reset_s=25.0),
}
_COMPUTER_AND_WIND: Final[dict[str, FaultRowCase]] = {
    "vision 130 ms": _from_start(companion={"compute": {"vision_s": 0.13}}),
    "camera 8 Hz": _from_start(camera={"rate_hz": 8.0}),
    "pad 3 m/s, wind 8 m/s": _from_start(
        pad={"motion": {"speed_m_s": 3.0}},
        wind={"mean_m_s": 8.0, "from_deg": 0.0, "turbulence": "moderate"},
    ),
    "wind 8 m/s": _from_start(wind={"mean_m_s": 8.0, "from_deg": 0.0, "turbulence": "moderate"}),
}
CASES: Final[dict[str, FaultRowCase]] = {
    **_CAMERA,
    **_SENSORS,
    **_LINK,
    **_PAD,
    **_SOLVER,
    **_AUTOPILOT,
    **_STANDING_BY,
    **_DISK,
    **_BUILT,
    **_COMPUTER_AND_WIND,
}


class FaultRun(NamedTuple):
    """One flight: what fails, when, in which scenario under which seed, and whose behaviour flies."""

    fault: str
    phase: PhaseName
    scenario: str
    seed: int
    autopilot: AutopilotKind = "px4"


@dataclass(frozen=True, slots=True)
class FaultRow:
    """A flight that was flown: by which state of the code, and how it ended.

    `began` is False when the flight was over before the fault. `said` is the app's last text, `ended_s` when
    the app ended.
    """

    fault: str
    phase: PhaseName
    scenario: str
    seed: int
    autopilot: AutopilotKind
    code: str
    began: bool
    outcome: str
    unsafe: str
    ended_s: float
    said: str

    @property
    def run(self) -> FaultRun:
        """What was flown."""
        return FaultRun(self.fault, self.phase, self.scenario, self.seed, self.autopilot)


def all_runs(
    faults: Sequence[str],
    phases: Sequence[str],
    scenarios: Sequence[str],
    seeds: int,
    autopilots: Sequence[AutopilotKind] = ("px4",),
) -> Iterator[FaultRun]:
    """Every fault in every phase in which it can happen; the first seed of all before the second."""
    for seed in range(seeds):
        for scenario in scenarios:
            for autopilot in autopilots:
                for name in faults:
                    for phase in CASES[name].phases:
                        if phase in phases:
                            yield FaultRun(name, phase, scenario, seed, autopilot)


def one_each(
    faults: Sequence[str],
    phases: Sequence[str],
    scenarios: Sequence[str],
    seeds: int,
    flights: int,
    autopilots: Sequence[AutopilotKind] = ("px4",),
) -> list[FaultRun]:
    """So many flights of each fault in each phase by each autopilot, of all scenarios and seeds in turn, none
    twice."""
    kinds = [(scenario, seed) for seed in range(seeds) for scenario in scenarios]
    pairs = [(name, phase) for name in faults for phase in CASES[name].phases if phase in phases]
    turns = {(name, phase): 3 * list(CASES).index(name) + 7 * PHASES.index(phase) for name, phase in pairs}
    return [
        FaultRun(name, phase, *kinds[(turns[name, phase] + again) % len(kinds)], autopilot)
        for again in range(min(flights, len(kinds)))
        for autopilot in autopilots
        for name, phase in pairs
    ]


def beginning(phase: PhaseName, seed: int) -> dict[str, Any]:
    """When a fault begins: in a phase, at the moment that the seed gives."""
    if phase == "start":
        return {"start_s": 0.0}
    if phase == "last_metre":
        return {"below_m": _HEIGHTS_M[seed % len(_HEIGHTS_M)]}
    if phase == "on_pad":
        return {"below_m": 0.0, "delay_s": _ON_PAD_DELAYS_S[seed % len(_ON_PAD_DELAYS_S)]}
    return {"phase": phase, "delay_s": _DELAYS_S[seed % len(_DELAYS_S)]}


def faults_of(run: FaultRun) -> list[Fault]:
    """The run's faults, with their beginnings."""
    return list(scenario_of(run).faults)


@cache
def scenario_of(run: FaultRun) -> Scenario:
    """The run's scenario.

    Raises:
        ConfigError: the scenario's file is missing or wrong.
    """
    when = beginning(run.phase, run.seed)
    if run.phase == "start" and run.fault.startswith("pilot"):
        when = {"phase": "take off", "delay_s": 2.0}  # before control is ours
    case = CASES[run.fault]
    since_s = when.get("delay_s", 0.0)
    faults = [
        {**fault, **when, **({"delay_s": since_s + fault["delay_s"]} if "delay_s" in fault else {})}
        for fault in case.faults
    ]
    told: dict[str, Any] = {"autopilot_parameters": case.parameters[run.autopilot]} if case.parameters else {}
    if case.stands_by is not None:
        told["companion"] = {"orders": {"flight_mode": _ORDERS_BY[run.autopilot]}}
    return _with(run.scenario, {**case.changes, **told, "faults": faults, "autopilot": run.autopilot})


def faultless(scenario: str, changes: dict[str, Any] | None = None) -> Scenario:
    """A scenario in which nothing fails, with changes: what its runs have in common.

    Raises:
        ConfigError: the scenario's file is missing or wrong.
    """
    return _with(scenario, {**(changes or {}), "faults": []})


def _with(scenario: str, changes: dict[str, Any]) -> Scenario:
    return changed(load_scenario(scenario), {**changes, "time_limit_s": TIME_LIMIT_S})


def changed(scenario: Scenario, changes: dict[str, Any]) -> Scenario:
    """A scenario with changes."""
    if not changes:
        return scenario
    content = scenario.model_dump(by_alias=True, exclude_unset=True)
    return Scenario.model_validate(merge(content, changes))
