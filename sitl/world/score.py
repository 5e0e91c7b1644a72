"""Scoring of a flight: the true touchdown, and whether it counts as a landing.

Speeds are relative to the pad, positive vertical ones closing; angles in degrees. Where a deck tilts,
vertical means along its normal, horizontal along its surface, and tilt is from its normal. Everything is
taken from the last state before contact forces acted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from companion.base.geometry import (
    Vector3,
    dot,
    norm,
    scale,
    subtract,
    tilt_from_quat,
    wrap_angle,
    yaw_from_quat,
)
from companion.base.messages import Outcome, Phase
from sitl.pad.motion import PadTruth
from sitl.scenario.scenario import PassBounds
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.contact import ContactLoad
from sitl.world.ground import tilt_from_normal

AIRBORNE_HEIGHT_M: Final = 1.0
CRASH_SPEED_M_S: Final = 2.0
CRASH_TILT_RAD: Final = math.radians(60.0)
UPSIDE_DOWN_RAD: Final = math.radians(90.0)


@dataclass(frozen=True, slots=True)
class TouchdownState:
    """The first contact after a flight. `impact_speed_m_s` is relative to what was hit.

    `offset_pad_m` is where on the pad: along its heading and to its right.
    """

    time_s: float
    lateral_error_m: float
    vertical_speed_m_s: float
    horizontal_speed_m_s: float
    tilt_deg: float
    yaw_error_deg: float
    pad_speed_m_s: float
    impact_speed_m_s: float
    on_pad: bool
    offset_pad_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class TouchdownResult:
    """The touchdown as the result file has it."""

    lateral_error_m: float
    vertical_speed_m_s: float
    horizontal_speed_m_s: float
    tilt_deg: float
    yaw_error_deg: float

    @classmethod
    def of(cls, touchdown: TouchdownState) -> TouchdownResult:
        """The part of a touchdown that is reported."""
        t = touchdown
        return cls(
            t.lateral_error_m, t.vertical_speed_m_s, t.horizontal_speed_m_s, t.tilt_deg, t.yaw_error_deg
        )


class TouchdownDetector:
    """Watches a flight for its touchdown and for a crash.

    A vehicle that rises a metre again after a touchdown flies again: its next contact replaces the last.
    A crash stays a crash. `flown`: it has ever been so high.
    """

    def __init__(self) -> None:
        self.touchdown: TouchdownState | None = None
        self.crashed = False
        self.nearest_obstacle_m: float | None = None
        self.flown = False
        self._airborne = False
        self._touching = True

    @property
    def flying(self) -> bool:
        """Whether it has been high enough since it last stood: then its height does not matter."""
        return self._airborne

    def step(self, time_s: float, state: QuadrotorState, pad: PadTruth, load: ContactLoad) -> None:
        """Look at a state and the contact that is about to act on it."""
        tilt = tilt_from_quat(state.attitude)
        if load.touching and not self._touching:
            self._hit(time_s, state, pad, load)
        self._touching = load.touching
        if tilt > UPSIDE_DOWN_RAD or (load.touching and tilt > CRASH_TILT_RAD):
            self.crashed = True

    def beside(self, obstacle_clearance_m: float | None) -> None:
        """Note how far the rotors' tips are from the nearest obstacle; touching one is a crash."""
        if obstacle_clearance_m is None:
            return
        nearest_m = self.nearest_obstacle_m
        if nearest_m is None or obstacle_clearance_m < nearest_m:
            self.nearest_obstacle_m = obstacle_clearance_m
        if obstacle_clearance_m <= 0.0:
            self.crashed = True

    def airborne(self, height_m: float) -> None:
        """Note the feet's height (m) over whatever is beneath."""
        if height_m > AIRBORNE_HEIGHT_M:
            self._airborne = self.flown = True

    def _hit(self, time_s: float, state: QuadrotorState, pad: PadTruth, load: ContactLoad) -> None:
        touchdown = _touchdown(time_s, state, pad, load.on_board > 0)
        if touchdown.impact_speed_m_s > CRASH_SPEED_M_S:
            self.crashed = True
        if self._airborne:
            self.touchdown = touchdown
            self._airborne = False


def _touchdown(time_s: float, state: QuadrotorState, pad: PadTruth, on_pad: bool) -> TouchdownState:
    # velocity of the turning board at the contact point; next to the board, the pad's own velocity
    carried = pad.velocity_at_ned_m_s(state.position_ned_m) if on_pad else pad.velocity_ned_m_s
    relative = subtract(state.velocity_ned_m_s, carried)
    away = subtract(state.position_ned_m, pad.position_ned_m)
    axes = pad.axes()
    normal = axes.down
    return TouchdownState(
        time_s=time_s,
        lateral_error_m=math.hypot(*_along_surface(away, normal)),
        vertical_speed_m_s=dot(relative, normal),
        horizontal_speed_m_s=math.hypot(*_along_surface(relative, normal)),
        tilt_deg=math.degrees(tilt_from_normal(pad, state.attitude)),
        yaw_error_deg=math.degrees(wrap_angle(yaw_from_quat(state.attitude) - pad.heading_rad)),
        pad_speed_m_s=norm(pad.velocity_ned_m_s),
        impact_speed_m_s=norm(relative if on_pad else state.velocity_ned_m_s),
        on_pad=on_pad,
        offset_pad_m=(dot(away, axes.forward), dot(away, axes.right)),
    )


def _along_surface(v: Vector3, normal: Vector3) -> Vector3:
    return subtract(v, scale(normal, dot(v, normal)))


# ---------------------------------------------------------------- the verdict


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome, the touchdown if there was one, and a line for each violated bound."""

    outcome: Outcome
    touchdown: TouchdownResult | None
    failures: tuple[str, ...] = ()


def judge(
    touchdown: TouchdownState | None,
    bounds: PassBounds,
    *,
    crashed: bool,
    at_rest_on_pad: bool,
    disarmed: bool,
    final_phase: Phase,
    nearest_obstacle_m: float | None = None,
) -> Verdict:
    """Judge a flight that has ended, or whose time is up.

    Landed: touched down on the pad within the bounds, stands on it and is disarmed. Missed: it touched down
    but violated a bound, left the pad or came down beside it. Aborted: the app gave up, whatever the place.
    Timeout: none of these, or on the pad but still armed.
    """
    result = None if touchdown is None else TouchdownResult.of(touchdown)
    struck = nearest_obstacle_m is not None and nearest_obstacle_m <= 0.0
    if crashed or struck:
        return Verdict(Outcome.CRASHED, result, ("touched an obstacle" if struck else "crashed",))
    if final_phase is Phase.ABORT:
        return Verdict(Outcome.ABORTED, result, ("the app aborted",))
    if touchdown is None:
        return Verdict(Outcome.TIMEOUT, None, ("never touched down",))
    failures = _violated(touchdown, bounds)
    if not at_rest_on_pad:
        failures = (*failures, "not at rest on the pad")
    if failures:
        return Verdict(Outcome.MISSED, result, failures)
    if not disarmed:
        return Verdict(Outcome.TIMEOUT, result, ("not disarmed",))
    return Verdict(Outcome.LANDED, result)


def _violated(touchdown: TouchdownState, bounds: PassBounds) -> tuple[str, ...]:
    measured = (
        ("lateral error", touchdown.lateral_error_m, bounds.lateral_error_m, "m"),
        ("vertical speed", touchdown.vertical_speed_m_s, bounds.vertical_speed_m_s, "m/s"),
        ("horizontal speed", touchdown.horizontal_speed_m_s, bounds.horizontal_speed_m_s, "m/s"),
        ("tilt", touchdown.tilt_deg, bounds.tilt_deg, "deg"),
    )
    violated = tuple(
        f"{name} {value:.2f} {unit}, expected at most {limit:g}"
        for name, value, limit, unit in measured
        if not value <= limit  # so that what is no number is no landing
    )
    return violated if touchdown.on_pad else ("touched down beside the pad", *violated)
