"""The autopilots' own precision landing on LANDING_TARGET, as the simulator has it, for comparison with ours.

    python -m benchmarks precision --runs 6

An operator flies the vehicle over the pad at 8 m with the pad's speed and then says LAND (PX4: precision
landing). From then on the autopilot is alone with LANDING_TARGET over MAVLink: from the truth with 1 cm + 1 %
of noise, 30 Hz, 100 ms late, as long as the pad is in the 62 x 48 deg view of a camera fixed to the body.
Landed: within 15 cm, 0.5 m/s down and 0.3 m/s sideways relative to the pad, 8 deg of tilt, at rest, disarmed.
Virtual time, no rendering. Beside each row stands what recordings of the real firmware gave.
"""

import argparse
import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

import numpy as np
from pymavlink.dialects.v20 import common as mavlink
from rich.table import Table

from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, Vector3, add, norm, quat_conjugate, quat_rotate, subtract
from companion.base.messages import Outcome, Phase
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.scenario.scenario import PassBounds, Scenario
from sitl.world.score import judge
from sitl.world.world import World

SMOKE: Final = ("--runs", "1", "--autopilot_kind", "px4", "--case", "line 1")
STEP_S: Final = 1.0 / 400.0
STEPS_A_TICK: Final = 4
TARGET_PERIOD_S: Final = 1.0 / 30.0
TARGET_LATE_S: Final = 0.1
HALF_VIEW_RAD: Final = (math.radians(24.0), math.radians(31.0))  # forward, sideways
HEIGHT_M: Final = 8.0
READY_S: Final = 14.0
OVER_PAD_M: Final = 0.3
LIMIT_S: Final = 150.0
LANDING_LIMIT_S: Final = 60.0
HOME: Final[Vector3] = (47.0, 8.0, 400.0)
_NO_YAW: Final = 0b110000000000
BOUNDS: Final = PassBounds(
    lateral_error_m=0.15, vertical_speed_m_s=0.5, horizontal_speed_m_s=0.3, tilt_deg=8.0
)
PARAMETERS: Final[dict[AutopilotKind, dict[str, tuple[float, int]]]] = {
    # PLND_OPTIONS 1: targets move; PLND_LAG: how late the measurements are
    "ardupilot": {"PLND_ENABLED": (1, 2), "PLND_OPTIONS": (1, 4), "PLND_LAG": (TARGET_LATE_S, 9)},
    "px4": {},
}
REAL: Final[dict[AutopilotKind, dict[str, str]]] = {
    "ardupilot": {"line": "100 %, 1-2 cm, 0.47 m/s, 20 s", "turn": "0 % (0.56 m lag)", "wind": "20-60 %"},
    "px4": {"static": "not recorded", "line": "0 %", "turn": "0 %", "wind": "0 %"},
}


@dataclass(frozen=True, slots=True)
class PrecisionCase:
    """A pad's motion and the wind."""

    name: str
    kind: str
    motion: dict[str, Any]
    wind_m_s: float = 0.0


def line(speed_m_s: float) -> dict[str, Any]:
    """A straight pad, or one that stands."""
    return {"kind": "line", "speed_m_s": speed_m_s} if speed_m_s else {"kind": "static"}


CASES: Final = (
    *(PrecisionCase(f"line {v:g} m/s", "line" if v else "static", line(v)) for v in (0.0, 1.0, 2.1, 4.2)),
    PrecisionCase("circle 5 m, 1.5 m/s", "turn", {"kind": "circle", "speed_m_s": 1.5, "radius_m": 5.0}),
    PrecisionCase("figure 8, 2 m/s", "turn", {"kind": "figure_8", "speed_m_s": 2.0, "half_length_m": 8.0}),
    *(PrecisionCase(f"line {v:g} m/s, wind 8 m/s", "wind", line(v), 8.0) for v in (0.0, 1.0, 2.1, 4.2)),
)


@dataclass(frozen=True, slots=True)
class PrecisionLandingResult:
    """How one went; the numbers are NaN without a touchdown."""

    landed: bool
    lateral_m: float
    vertical_m_s: float
    seconds: float


class PrecisionFlight:
    """One world with its autopilot, and the operator's and the target's ends of the link."""

    def __init__(self, autopilot_kind: AutopilotKind, case: PrecisionCase, seed: int) -> None:
        self.world = World(_scenario(case), seed)
        generators = np.random.default_rng((seed, 77)).spawn(2)
        self.autopilot = SimulatedAutopilot(autopilot_kind, self.world.airframe.body, generators[0], HOME)
        self._rng = generators[1]
        self._endpoint = MavlinkEndpoint(self.autopilot)
        self._us = mavlink.MAVLink(None, srcSystem=255, srcComponent=191)
        self._late: deque[tuple[float, Any]] = deque()
        self._target_due_s = 0.0

    def run(self, until_s: float) -> Iterator[float]:
        """Step on by ticks of 10 ms, sending targets; yields the world's time."""
        while self.world.time_s < until_s:
            for _ in range(STEPS_A_TICK):
                motors = self.autopilot.step(self.world.state, STEP_S, self.world.time_s)
                self.world.step(motors, STEP_S)
            self._look()
            self._endpoint.transmit(self.world.time_s)
            yield self.world.time_s

    def send(self, message: Any) -> None:
        """As bytes over the link."""
        self._endpoint.receive(bytes(message.pack(self._us)), self.world.time_s)

    def command(self, number: int, *parameters: float) -> None:
        """COMMAND_LONG, the parameters that are not given NaN."""
        filled = (*parameters, *(math.nan,) * (7 - len(parameters)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled))

    def _look(self) -> None:
        """See the pad at 30 Hz, and tell of it 100 ms later."""
        now_s = self.world.time_s
        if now_s >= self._target_due_s:
            self._target_due_s += TARGET_PERIOD_S
            message = self._target(now_s)
            if message is not None:
                self._late.append((now_s + TARGET_LATE_S, message))
        while self._late and now_s >= self._late[0][0]:
            self.send(self._late.popleft()[1])

    def _target(self, now_s: float) -> Any | None:
        state, pad = self.world.state, self.world.pad_state
        away = subtract(pad.position_ned_m, state.position_ned_m)
        x, y, z = quat_rotate(quat_conjugate(state.attitude), away)
        forward, sideways = HALF_VIEW_RAD
        if z <= 0.0 or abs(math.atan2(x, z)) > forward or abs(math.atan2(y, z)) > sideways:
            return None
        spread = 0.01 + 0.01 * norm(away)
        noise = (spread * self._rng.standard_normal(3)).tolist()
        seen: Vector3 = (x + noise[0], y + noise[1], z + noise[2])
        frame = mavlink.MAV_FRAME_BODY_FRD
        if self.autopilot.profile.name == "px4":  # it takes places in its own NED alone
            estimate = self.autopilot.estimate
            seen = add(estimate.position_ned_m, quat_rotate(estimate.attitude, seen))
            frame = mavlink.MAV_FRAME_LOCAL_NED
        return mavlink.MAVLink_landing_target_message(
            round(now_s * 1e6), 0, frame, 0.0, 0.0, norm(away), 0.0, 0.0, *seen, IDENTITY,
            mavlink.LANDING_TARGET_TYPE_VISION_FIDUCIAL, 1,
        )  # fmt: skip

    def follow_pad(self) -> None:
        """A setpoint over the pad with its velocity and acceleration, in the autopilot's own frame."""
        estimate, pad = self.autopilot.estimate, self.world.pad_state
        state = self.world.state
        offset = subtract(estimate.position_ned_m, state.position_ned_m)
        x, y, z = add(pad.position_ned_m, offset)
        over = (x, y, z - HEIGHT_M)
        motion = (*pad.velocity_ned_m_s, *pad.acceleration_ned_m_s2)
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, _NO_YAW, *over, *motion, 0.0, 0.0
            )
        )


def _scenario(case: PrecisionCase) -> Scenario:
    meet = {"point_ned_m": [10.0, 0.0], "time_s": 22.0, "spread_m": 0.0}
    return Scenario.model_validate(
        {
            "name": "bench",
            "description": case.name,
            "pad": {"surface_height_m": 0.1, "motion": {**case.motion, "meet": meet}},
            "wind": {"mean_m_s": case.wind_m_s},
        }
    )


def fly(autopilot_kind: AutopilotKind, case: PrecisionCase, seed: int) -> PrecisionLandingResult:
    """One flight: set up, up, over the pad, and down by the autopilot's own means."""
    flight = PrecisionFlight(autopilot_kind, case, seed)
    _set_up(flight)
    _take_off(flight)
    began_s = _meet_pad(flight)
    flight.command(*((mavlink.MAV_CMD_NAV_LAND,) if autopilot_kind == "ardupilot" else (23,)))  # NAV_PRECLAND
    for now_s in flight.run(began_s + LANDING_LIMIT_S):
        if not flight.autopilot.armed or now_s > LIMIT_S:
            break
    return _judged(flight, began_s)


def _set_up(flight: PrecisionFlight) -> None:
    for name, (value, kind) in PARAMETERS[flight.autopilot.profile.name].items():
        flight.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    flight.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    for _ in flight.run(6.0):
        pass


def _take_off(flight: PrecisionFlight) -> None:
    if flight.autopilot.profile.name == "ardupilot":
        flight.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    over_sea = flight.autopilot.geodetic(flight.autopilot.home_ned_m)[2]
    base = 0.0 if flight.autopilot.profile.take_off_needs_guided else over_sea
    flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, *(math.nan,) * 6, base + HEIGHT_M)
    for _ in flight.run(READY_S):
        pass


def _meet_pad(flight: PrecisionFlight) -> float:
    """Fly over the pad and along with it; returns when that has gone well for a second."""
    good_s = 0.0
    for tick, now_s in enumerate(flight.run(LIMIT_S - LANDING_LIMIT_S)):
        if tick % 5 == 0:
            flight.follow_pad()
        if tick == 20 and flight.autopilot.profile.name == "px4":
            flight.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6)
        state, pad = flight.world.state, flight.world.pad_state
        away = subtract(state.position_ned_m, pad.position_ned_m)
        slip = subtract(state.velocity_ned_m_s, pad.velocity_ned_m_s)
        over = math.hypot(away[0], away[1]) < OVER_PAD_M and norm(slip) < OVER_PAD_M
        good_s = good_s + STEP_S * STEPS_A_TICK if over and now_s > READY_S + 1.0 else 0.0
        if good_s > 1.0:
            break
    return flight.world.time_s


def _judged(flight: PrecisionFlight, began_s: float) -> PrecisionLandingResult:
    world = flight.world
    verdict = judge(
        world.touchdown,
        BOUNDS,
        contacts=world.contacts,
        crashed=world.crashed,
        at_rest_on_pad=world.at_rest_on_pad,
        disarmed=not flight.autopilot.armed,
        final_phase=Phase.LANDED,
    )
    touch = world.touchdown
    if touch is None:
        return PrecisionLandingResult(False, math.nan, math.nan, math.nan)
    landed = verdict.outcome is Outcome.LANDED
    return PrecisionLandingResult(
        landed, touch.lateral_error_m, touch.vertical_speed_m_s, touch.time_s - began_s
    )


def row(
    autopilot_kind: AutopilotKind, case: PrecisionCase, landings: list[PrecisionLandingResult]
) -> tuple[str, ...]:
    """A line of the table."""
    touched = [landing for landing in landings if not math.isnan(landing.lateral_m)]
    middles = ("-", "-", "-")
    if touched:
        middles = (
            f"{100.0 * median(t.lateral_m for t in touched):.1f}",
            f"{median(t.vertical_m_s for t in touched):.2f}",
            f"{median(t.seconds for t in touched):.1f}",
        )
    share = f"{100.0 * sum(landing.landed for landing in landings) / len(landings):.0f} %"
    kind = case.kind if case.kind in REAL[autopilot_kind] else "line"
    return (autopilot_kind, case.name, share, *middles, REAL[autopilot_kind][kind])


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly all cases for both autopilots and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=6, help="landings a case")
    parser.add_argument("--autopilot_kind", choices=["ardupilot", "px4"], help="one alone")
    parser.add_argument("--case", default="", help="cases whose name begins so")
    options = parser.parse_args(arguments)
    report = BenchReport(width=120)
    table = Table(
        *("autopilot", "case", "landed", "lateral p50 cm", "vertical p50 m/s", "seconds p50", "real firmware")
    )
    kinds: tuple[AutopilotKind, ...] = (
        (options.autopilot_kind,) if options.autopilot_kind else ("ardupilot", "px4")
    )
    for autopilot_kind in kinds:
        for case in (case for case in CASES if case.name.startswith(options.case)):
            table.add_row(
                *row(autopilot_kind, case, [fly(autopilot_kind, case, seed) for seed in range(options.runs)])
            )
    report.show(table)
    return report
