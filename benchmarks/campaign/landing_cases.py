"""The flights of `bench_landing`: random landings, and the cases that the strongest peer was measured in.

A random landing is drawn from its number alone, so that the 17th is the same flight whoever flies it:
the pad's motion (lines of 0 to 4.2 m/s; circles, figure-8s and random turns of up to 2.5 m/s and 2
m/s2), the mean wind up to 8 m/s with Dryden turbulence of moderate intensity (MIL-F-8785C), the mass off
by up to 10 % from what the app believes, the camera's latency of 40 to 150 ms with jitter. The camera is
fixed to the body and sees 62 x 48 degrees. The app is told where to look for the pad, as in the shipped
scenarios, and nothing else.

As built, each of them is flown by a vehicle about which its builder is wrong (`sitl.scenario.as_built`), the
mass among the rest; those of even numbers with the behaviour of PX4, those of odd ones with ArduPilot's.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from companion.base.autopilot_kind import AutopilotKind
from companion.config import MissionConfig, find_file, merge, read_yaml
from sitl.campaign.manifest import CampaignRun, code_digest, scenario_digest
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.scenario import Scenario

FASTEST_LINE_M_S: Final = 4.2
FASTEST_TURN_M_S: Final = 2.5
MOST_ACCELERATION_M_S2: Final = 2.0
STRONGEST_WIND_M_S: Final = 8.0
PLACE_NED_M: Final = [10.0, 0.0]
MEET: Final = {"point_ned_m": PLACE_NED_M, "time_s": 22.0, "spread_m": 2.0}
PASS: Final = {
    "lateral_error_m": 0.15,
    "vertical_speed_m_s": 0.5,
    "horizontal_speed_m_s": 0.3,
    "tilt_deg": 8.0,
}
PEER_HEIGHT_M: Final = 8.0
TO_TAKE_OFF_S: Final = 20.0
STRAIGHT_M_S: Final = (0.0, 1.0, 2.1, 4.2)


@dataclass(frozen=True, slots=True)
class LandingCase:
    """Flights that are judged together: a scenario for each, with its seed."""

    name: str
    flights: tuple[tuple[dict[str, Any], int], ...]


def random_landings(count: int, first: int = 0) -> LandingCase:
    """Random landings `first` to `first + count - 1`."""
    return LandingCase(
        "random", tuple((_random_landing(number), number) for number in range(first, first + count))
    )


def as_built_landings(count: int, first: int = 0) -> LandingCase:
    """The same, by vehicles that are not what their builders believe."""
    return LandingCase(
        "as_built", tuple((_as_built_landing(number), number) for number in range(first, first + count))
    )


def _as_built_landing(number: int) -> dict[str, Any]:
    believed = _random_landing(number)
    del believed["mass_factor"]
    return {
        **believed,
        "name": f"as_built_{number:03d}",
        "description": f"Random landing {number}, as built.",
        "autopilot": "ardupilot" if number % 2 else "px4",
        "as_built": {},
        # longer than the app's own limit: what it cannot land on it hands back, and says why
        "time_limit_s": MissionConfig().total_timeout_s + TO_TAKE_OFF_S,
    }


def peer_cases(seeds: int) -> tuple[LandingCase, ...]:
    """The cases in which ArduCopter's own precision landing was measured, each under so many seeds."""
    turns: dict[str, dict[str, Any]] = {
        "circle": {"kind": "circle", "speed_m_s": 1.5, "radius_m": 5.0},
        "figure_8": {"kind": "figure_8", "speed_m_s": 2.0, "half_length_m": 8.0},
    }
    cases: list[tuple[str, dict[str, Any], float]] = [
        *((f"line_{v:g}", _line(v), 0.0) for v in STRAIGHT_M_S),
        *((name, motion, 0.0) for name, motion in turns.items()),
        *((f"line_{v:g}_wind_8", _line(v), STRONGEST_WIND_M_S) for v in STRAIGHT_M_S),
    ]
    return tuple(
        LandingCase(name, tuple((_peer_case(name, motion, wind), seed) for seed in range(seeds)))
        for name, motion, wind in cases
    )


def write_flights(case: LandingCase, folder: Path) -> list[CampaignRun]:
    """Write each flight's scenario into a folder; returns the flights."""
    return [run for content, seed in case.flights for run in write_scenario(content, (seed,), folder)]


def write_scenario(
    content: dict[str, Any], seeds: Iterable[int], folder: Path, firmware: FirmwareSpec | None = None
) -> list[CampaignRun]:
    """Write a scenario into a folder, for the command that repeats it; returns its flights."""
    scenario = Scenario.model_validate(content)
    path = folder / f"{scenario.name}.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    identity = f"{code_digest()}-{scenario_digest(str(path), None)}"
    return [
        CampaignRun(scenario.name, str(path), seed, None, scenario.time_limit_s, identity, firmware)
        for seed in seeds
    ]


def _line(speed_m_s: float) -> dict[str, Any]:
    return {"kind": "line", "speed_m_s": speed_m_s} if speed_m_s > 0.0 else {"kind": "static"}


def _peer_case(name: str, motion: dict[str, Any], wind_m_s: float) -> dict[str, Any]:
    return {
        "name": name,
        "description": "A case in which an autopilot's own precision landing was measured.",
        "pad": {"surface_height_m": 0.1, "motion": {**motion, "meet": MEET}},
        "wind": {"mean_m_s": wind_m_s},
        "camera": {"latency_s": 0.1},
        "pass": PASS,
        "companion": {
            "plan": {"mission": {"waypoint_ned_m": PLACE_NED_M, "take_off_height_m": PEER_HEIGHT_M}}
        },
    }


def _random_landing(number: int) -> dict[str, Any]:
    rng = np.random.default_rng((number, 6))
    motion = _random_motion(rng)
    return {
        "name": f"random_{number:03d}",
        "description": f"Random landing {number}.",
        "mass_factor": round(float(rng.uniform(0.9, 1.1)), 3),
        "pad": {
            "surface_height_m": round(float(rng.uniform(0.1, 0.6)), 2),
            "motion": {**motion, "meet": MEET},
        },
        "wind": {"mean_m_s": round(float(rng.uniform(0.0, STRONGEST_WIND_M_S)), 2), "turbulence": "moderate"},
        "camera": {
            "latency_s": round(float(rng.uniform(0.04, 0.15)), 3),
            "latency_jitter_s": round(float(rng.uniform(0.002, 0.015)), 4),
        },
        "pass": PASS,
        "companion": {"plan": {"mission": {"waypoint_ned_m": PLACE_NED_M}}},
    }


def _random_motion(rng: np.random.Generator) -> dict[str, Any]:
    kind = str(rng.choice(["line", "circle", "figure_8", "random_turns"]))
    if kind == "line":
        return _line(round(float(rng.uniform(0.0, FASTEST_LINE_M_S)), 2))
    speed = round(float(rng.uniform(0.5, FASTEST_TURN_M_S)), 2)
    acceleration = float(rng.uniform(0.3, MOST_ACCELERATION_M_S2))
    radius = speed * speed / acceleration
    if kind == "circle":
        return {"kind": kind, "speed_m_s": speed, "radius_m": round(max(1.0, radius), 2)}
    if kind == "figure_8":
        # Bernoulli's lemniscate bends most at its ends: radius a third of its half length
        return {"kind": kind, "speed_m_s": speed, "half_length_m": round(max(2.0, 3.0 * radius), 2)}
    return {
        "kind": kind,
        "speed_m_s": speed,
        "slowest_m_s": round(0.4 * speed, 2),
        "max_turn_rate_deg_s": 60.0,
        "max_acceleration_m_s2": round(acceleration, 2),
    }


# ---------------------------------------------------------------- margins cases
# The flights of `bench_margins`: the app is told something else of the vehicle than what flies.
#
# Five shipped scenarios, each with a response 1.5 times slower and faster than believed, a line that holds
# everything back for 80 ms, frames stamped 20 ms early and late, and a mass off by 20 % either way.

SCENARIOS: Final = ("static", "line", "circle", "figure_8", "heave")
VEHICLE: Final = "x500"
SLOWER: Final = 1.5
HELD_BACK_S: Final = 0.08
STAMPS_OFF_S: Final = 0.02
MASS_OFF: Final = 0.2
BOUNDS: Final = {
    name: PASS[name] for name in ("lateral_error_m", "vertical_speed_m_s", "horizontal_speed_m_s")
}


def margin_cases(autopilot_kind: AutopilotKind, seeds: range, folder: Path) -> tuple[LandingCase, ...]:
    """All of them, with one autopilot's profile; the vehicle's files are left in `folder`."""
    believed = read_yaml(find_file("vehicles", VEHICLE))
    changes: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "as_believed": ({}, {}),
        "slower": (_quicker(believed, SLOWER), {}),
        "faster": (_quicker(believed, 1.0 / SLOWER), {}),
        "held_back": ({}, {"link": {"delay_s": HELD_BACK_S}}),
        "stamps_early": ({"camera_time_offset_s": -STAMPS_OFF_S}, {}),
        "stamps_late": ({"camera_time_offset_s": STAMPS_OFF_S}, {}),
        "light": ({}, {"mass_factor": 1.0 - MASS_OFF}),
        "heavy": ({}, {"mass_factor": 1.0 + MASS_OFF}),
    }
    cases = []
    for name, (vehicle, world) in changes.items():
        path = folder / f"vehicle_{name}.yaml"
        path.write_text(yaml.safe_dump(merge(believed, vehicle), sort_keys=False), encoding="utf-8")
        told = {**world, "autopilot": autopilot_kind, "companion": {"vehicle": str(path)}, "pass": BOUNDS}
        flights = [
            (_scenario(scenario, name, autopilot_kind, told), seed)
            for scenario in SCENARIOS
            for seed in seeds
        ]
        cases.append(LandingCase(f"{autopilot_kind}-{name}", tuple(flights)))
    return tuple(cases)


def _scenario(
    scenario: str, name: str, autopilot_kind: AutopilotKind, told: dict[str, Any]
) -> dict[str, Any]:
    content = merge(read_yaml(find_file("scenarios", scenario)), told)
    return {**content, "name": f"{autopilot_kind}-{name}-{scenario}"}


def _quicker(vehicle: dict[str, Any], factor: float) -> dict[str, Any]:
    """What to believe of a vehicle that shall be slower than believed by this factor."""

    def scaled(part: Any) -> Any:
        if not isinstance(part, dict):
            return part
        changed = {key: scaled(value) for key, value in part.items()}
        if "dead_time_s" in part:
            changed["dead_time_s"] = part["dead_time_s"] / factor
            changed["frequency_rad_s"] = part["frequency_rad_s"] * factor
        return changed

    return {"responses": scaled(vehicle["responses"])}
