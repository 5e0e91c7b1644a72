"""A try at a touchdown, from state to state as the table says."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_euler,
    scale,
)
from companion.base.messages import (
    AutopilotState,
    LandedState,
    LinkHealth,
    PadState,
    RangeSample,
    VehicleState,
)
from companion.base.motion import Motion
from companion.config import GuidanceConfig, LandingConfig, TouchdownConfig
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.landing.success import SuccessEstimate
from companion.plan.landing.touchdown import TouchdownSequence
from companion.plan.mission.states import Circumstances, State
from companion.plan.mission.table import COMMITTED, GOING_DOWN, ON_PAD, TOUCHDOWN, follows
from companion.plan.steering import enter_touchdown, touch_down
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.control.controller_inputs import vehicle_state
from tests.unit.plan.plan_harness import LEG_M, VEHICLE

CONFIG = TouchdownConfig()
WAIT_M = LEG_M + 0.35
SMALL_PAD_M = 0.2  # half of its width: what an indoor pad has
CYCLE_S = 1.0 / 30.0
SEEN_CLEARLY = tuple(tuple(1e-6 if row == column else 0.0 for column in range(6)) for row in range(6))


def sight(
    aside: float = 0.0,
    height: float = WAIT_M,
    velocity: Vector3 = ZERO3,
    pad_acceleration: Vector3 = ZERO3,
    age: float = 0.0,
    *,
    east: float = 0.0,
) -> PadState:
    """The pad under a vehicle that is so far aside (north) and high, and moves over it at `velocity`."""
    relative = ((-aside, -east, height), scale(velocity, -1.0))
    return PadState(
        0.0, *relative, ZERO3, pad_acceleration, 0.0, 0.0, 0.0, 0.0,
        seen_time_s=-age, seen_velocity_ned_m_s=relative[1], covariance=SEEN_CLEARLY,
    )  # fmt: skip


class Attempt:
    """A try that goes from state to state as the table says; `step` returns what ends it, and a contact."""

    def __init__(
        self, sequence: TouchdownSequence, generator: ReferenceGenerator, success: SuccessEstimate
    ) -> None:
        self._sequence, self._generator, self._success = sequence, generator, success
        self.state = State.WAIT
        self.broken_off_by = ""
        self.contact_s = math.nan
        self.now_s = -CYCLE_S  # of the last cycle
        self._seen: PadState | None = None  # in it
        self.level_off = sequence.levelling.window
        self.reference = generator

    @property
    def committed(self) -> bool:
        return self.state in COMMITTED

    @property
    def levels_off(self) -> bool:
        return self._sequence.levelling.begun

    @property
    def on_pad(self) -> bool:
        return self.state in ON_PAD

    @property
    def unloading(self) -> float:
        return self._sequence.contact.unloading if self.state in GOING_DOWN else 0.0

    @property
    def unconfirmed(self) -> bool:
        return self._sequence.unconfirmed(self._seen)

    @property
    def met(self) -> PadState | None:
        return self._sequence.met

    def feet_down(self, now_s: float) -> bool:
        return self._sequence.short_echoes.standing(now_s)

    def note_tilt(self, attitude: Quaternion, now_s: float, seen: PadState | None = None) -> None:
        self._success.tilt.note(held_against_air(attitude, seen), seen, now_s)

    def step(
        self,
        seen: PadState | None,
        now_s: float,
        *,
        echo_m: float | None = None,
        echo_age_s: float = 0.0,
        landed: LandedState = LandedState.IN_AIR,
        silent_s: float = 0.0,
        imu_age_s: float | None = None,
    ) -> DetectedEvent | None:
        """One cycle, from which the sight's times count; an IMU with an age makes our own state known."""
        if seen is not None:
            seen = replace(seen, time_s=now_s + seen.time_s, seen_time_s=now_s + seen.seen_time_s)
        self.now_s, self._seen = now_s, seen
        vehicle = None if imu_age_s is None else vehicle_state(now_s, imu_age_s=imu_age_s)
        echo = None if echo_m is None else RangeSample(now_s - echo_age_s, echo_m)
        autopilot = AutopilotState(now_s, landed=landed, connected=True)
        inputs = PlanInputs(vehicle, None, autopilot, range=echo, link=LinkHealth(silent_s))
        self._success.note(seen, vehicle, self._generator, now_s)
        detected = touch_down(self._sequence, self.state, seen, inputs, now_s)
        if detected is None:
            return None
        branch = follows(self.state, detected[0], Circumstances())
        if branch is None or branch.to not in TOUCHDOWN:
            return detected
        self.state = branch.to
        enter_touchdown(self._sequence, self.state, seen, vehicle, now_s)
        if self.state is State.RISE:
            self.broken_off_by = detected[1]
        if self.state is State.STAND:
            self.contact_s = now_s
            return detected
        return None

    def cycles(self, sights: Iterable[PadState | None], **given: Any) -> list[MissionEvent]:
        """A cycle for each sight, from the last one on; what they bring."""
        found = [self.step(seen, self.now_s + CYCLE_S, **given) for seen in sights]
        return [finding[0] for finding in found if finding]


def fresh(
    slack: float = 1.0,
    config: TouchdownConfig = CONFIG,
    half_width_m: float = SMALL_PAD_M,
    *,
    watched_s: float = 10.0,
    seen_at: Callable[[float], PadState] = lambda _: sight(),
) -> Attempt:
    """Over the pad, which it has followed like that for so long."""
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 0.4, 20, 0.1)
    success = SuccessEstimate(config)
    generator.start("pad", Motion((0.0, 0.0, -WAIT_M)), -watched_s)
    for k in range(round(watched_s / CYCLE_S)):
        now_s = k * CYCLE_S - watched_s
        success.note(seen_at(now_s), None, generator, now_s)
    generator.start("pad", Motion((0.0, 0.0, -WAIT_M)), 0.0)
    standing = StandingHeight(VEHICLE)
    standing.measured_m["the rangefinder"] = VEHICLE.leg_height_m, 0.0
    sequence = TouchdownSequence(config, LandingConfig(), generator, standing, half_width_m, success, 0.0)
    sequence.slack = slack
    return Attempt(sequence, generator, success)


def wait(touchdown: Attempt, seen: PadState, until_s: float) -> tuple[float, MissionEvent | None]:
    """Step until it commits or finds something; the time and what."""
    k = 0
    while k * CYCLE_S < until_s:
        finding = touchdown.step(seen, k * CYCLE_S)
        if finding or touchdown.committed:
            return k * CYCLE_S, finding[0] if finding else None
        k += 1
    return until_s, None


def sinking(**given: Any) -> Attempt:
    """On its final descent; its next cycle is at 1 s."""
    touchdown = fresh(**given)
    wait(touchdown, sight(), 5.0)
    assert touchdown.committed
    touchdown.now_s = 1.0 - CYCLE_S
    return touchdown


def coming_down(height_m: float, *, aside_m: float = 0.0, stands_for_s: float = 1.5) -> list[PadState]:
    """A cycle each: it sinks to a height at 0.2 m/s, and stops there."""
    above_m = [0.2 * CYCLE_S * k for k in range(5, 0, -1)]
    sinks = [sight(aside_m, height_m + over_m, (0.0, 0.0, 0.2)) for over_m in above_m]
    return [*sinks, *[sight(aside_m, height_m)] * round(stands_for_s / CYCLE_S)]


def standing() -> Attempt:
    touchdown = sinking()
    for seen in coming_down(0.19):
        if not touchdown.on_pad:
            touchdown.cycles([seen], echo_m=0.1)
    assert touchdown.on_pad
    return touchdown


def held_against_air(attitude: Quaternion, seen: PadState | None = None) -> VehicleState:
    """It tilts so to go with the pad, or to stay where it is, against what the air does to it."""
    with_pad_m_s2 = ZERO3 if seen is None else seen.acceleration_ned_m_s2
    return vehicle_state(0.0, attitude=attitude, acceleration_ned_m_s2=with_pad_m_s2)


def tilting(acceleration_m_s2: float) -> Quaternion:
    return quat_from_euler(math.atan(acceleration_m_s2 / GRAVITY_M_S2), 0.0, 1.0)


def waited(touchdown: Attempt, tilt_m_s2: float, from_s: float, until_s: float) -> None:
    for k in range(round((until_s - from_s) / CYCLE_S)):
        now_s = from_s + k * CYCLE_S
        touchdown.note_tilt(tilting(tilt_m_s2), now_s)
        touchdown.step(sight(), now_s)
