"""A stand-in for `companion flights`: answers at once, and dies, hangs or fails when the seed says so.

Run as a program it reads requests as the real one does. The result of a seed is a landing `seed` millimetres
off; every one names the process that flew it in `events`.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any, Final

COMMAND: Final = (sys.executable, __file__)
DIES, HANGS, FAULTS, IS_REFUSED, LEAVES, WAITS, MISSES = 901, 902, 903, 904, 905, 906, 907
WAIT_S: Final = 0.2


def answer(seed: int, scenario: str) -> dict[str, Any]:
    """What is answered to a request; a scenario's name is its file's."""
    nothing = {"result": None, "reason": "", "touchdown_pad_m": None, "refused": None, "fault": None}
    if seed == IS_REFUSED:
        return {**nothing, "refused": "a.yaml: no"}
    if seed == FAULTS:
        return {**nothing, "fault": "KeyError: 'x'"}
    missed = seed == MISSES
    return {
        **nothing,
        "result": result(seed, scenario, "missed" if missed else "landed"),
        "reason": "lateral error 0.91 m, expected at most 0.15" if missed else "",
        "touchdown_pad_m": [1e-3 * seed, 0.0],
    }


def result(seed: int, scenario: str, outcome: str) -> dict[str, Any]:
    """A result as `--json` has it."""
    return {
        "scenario": scenario,
        "seed": seed,
        "outcome": outcome,
        "touchdown": {
            "lateral_error_m": 1e-3 * seed,
            "vertical_speed_m_s": 0.25,
            "horizontal_speed_m_s": 0.02,
            "tilt_deg": 1.5,
            "yaw_error_deg": -0.5,
        },
        "contacts": [{"violations": ["before the landing"]}, {"violations": []}],
        "pad": {"speed_m_s": 1.0},
        "time": {"search_s": 1.0, "approach_s": 2.0, "descent_s": 3.0, "total_s": 30.0},
        "vision": {"frames": 900, "frames_with_pad": 450, "relative_position_rmse_m": 0.03},
        "estimate": {"attitude_rmse_deg": 1.0, "velocity_rmse_m_s": 0.06, "pad_velocity_rmse_m_s": None},
        "control": {
            "cycles": 600,
            "unsolved": 0,
            "late": 0,
            "stopped": 0,
            "blind": 0,
            "limited": 3,
            "iterations_p99": 35.0,
        },
        "latency_ms": {
            "exposure_to_setpoint_p50": 100.0,
            "exposure_to_setpoint_p99": 104.0,
            "cycle_late_p50": 0.1,
            "cycle_late_p99": 1.5,
        },
        "sim": {"real_time_factor": 3.5},
        "events": [{"time_s": 0.0, "kind": "pid", "text": str(os.getpid())}],
    }


def main() -> None:
    """Answer lines until they end."""
    for line in sys.stdin:
        asked = json.loads(line)
        seed = asked["seed"]
        print(f"flying {seed}\nlast words of {seed}", file=sys.stderr, flush=True)
        if seed == DIES:
            os.kill(os.getpid(), signal.SIGKILL)
        if seed == LEAVES:
            sys.exit(7)
        if seed == HANGS:
            # until nobody is there any more
            sys.stdin.read()
            return
        if seed == WAITS:
            time.sleep(WAIT_S)
        print(json.dumps(answer(seed, Path(asked["scenario"]).stem)), flush=True)


if __name__ == "__main__":
    main()
