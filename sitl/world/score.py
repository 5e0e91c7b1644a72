"""Scoring of a flight: every contact with pad or ground, and whether the flight counts as a landing.

A contact lasts from the first touch until the vehicle is clear of all surfaces by more than a bounce; its
touches are one contact, scored by the worst of them. The landing is the last contact. Any before it is a
failed flight, and so is any that is harder than allowed, the hops of the take-off included.

Speeds are relative to what is touched, positive vertical ones closing; angles in degrees. Where a deck tilts,
vertical means along its normal, horizontal along its surface, and tilt is from its normal. Everything is
taken from the last state before contact forces acted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from companion.base.geometry import (
    ZERO3,
    Vector3,
    dot,
    norm,
    scale,
    subtract,
    tilt_from_quat,
    wrap_angle,
    yaw_from_quat,
)
from companion.base.messages import ContactResult, Outcome, Phase
from sitl.pad.motion import PadTruth
from sitl.scenario.scenario import PassBounds
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.contact import ContactLoad
from sitl.world.ground import tilt_from_normal

AIRBORNE_HEIGHT_M: Final = 1.0
# Feet that come higher have left: at 0.5 m/s, the largest speed that benches let pass, and with nine tenths
# of the weight still carried by the rotors, a touch without any loss would throw it up by 0.13 m; legs lose
# more than half of that.
BOUNCE_M: Final = 0.1
CRASH_SPEED_M_S: Final = 2.0
CRASH_TILT_RAD: Final = math.radians(60.0)
UPSIDE_DOWN_RAD: Final = math.radians(90.0)
_DOWN: Final[Vector3] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class TouchdownState:
    """One contact: its first touch, and the worst of all its touches.

    `offset_pad_m` is where on the pad: along its heading and to its right. `before_flight`: it stood, or
    hopped lower than a bounce, and had not flown yet.
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
    position_ned_m: Vector3 = ZERO3
    touches: int = 1
    before_flight: bool = False

    def reported(self) -> dict[str, float]:
        """The part that the result file has."""
        return {
            "lateral_error_m": self.lateral_error_m,
            "vertical_speed_m_s": self.vertical_speed_m_s,
            "horizontal_speed_m_s": self.horizontal_speed_m_s,
            "tilt_deg": self.tilt_deg,
            "yaw_error_deg": self.yaw_error_deg,
        }

    def and_again(self, touch: TouchdownState) -> TouchdownState:
        """The contact with one more touch: the worst of each figure, time and heading of the first."""
        farther = touch if touch.lateral_error_m > self.lateral_error_m else self
        return replace(
            self,
            lateral_error_m=farther.lateral_error_m,
            offset_pad_m=farther.offset_pad_m,
            vertical_speed_m_s=max(self.vertical_speed_m_s, touch.vertical_speed_m_s),
            horizontal_speed_m_s=max(self.horizontal_speed_m_s, touch.horizontal_speed_m_s),
            tilt_deg=max(self.tilt_deg, touch.tilt_deg),
            impact_speed_m_s=max(self.impact_speed_m_s, touch.impact_speed_m_s),
            on_pad=self.on_pad and touch.on_pad,
            touches=self.touches + 1,
        )


class TouchdownDetector:
    """Watches a flight for its contacts and for a crash.

    A crash stays a crash. `flown`: it has ever been a metre high; `flying`: and touched nothing since, so
    that its height does not matter.
    """

    def __init__(self, *, stands: bool = True) -> None:
        """`stands`: on something, at the beginning."""
        self.contacts: list[TouchdownState] = []
        self.crashed = False
        self.nearest_obstacle_m: float | None = None
        self.flown = False
        self.flying = self._clear = self._anew = False
        self._touching = stands

    @property
    def touchdown(self) -> TouchdownState | None:
        """The landing: the last contact of a vehicle that has flown."""
        last = self.contacts[-1] if self.contacts else None
        return None if last is None or last.before_flight or not self.flown else last

    def begin_flight(self) -> None:
        """What is touched from the next take-off on is another flight's."""
        self._anew = True

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
        if height_m > BOUNCE_M and not self._touching:
            self._clear = True
            if self._anew:
                self._anew = False
                self.contacts.clear()
        if height_m > AIRBORNE_HEIGHT_M:
            self.flying = self.flown = True

    def _hit(self, time_s: float, state: QuadrotorState, pad: PadTruth, load: ContactLoad) -> None:
        touch = _touch(time_s, state, pad, load.on_board > 0)
        if touch.impact_speed_m_s > CRASH_SPEED_M_S:
            self.crashed = True
        if self._clear:
            self.contacts.append(touch)
        elif self.contacts:
            self.contacts[-1] = self.contacts[-1].and_again(touch)
        else:
            self.contacts.append(replace(touch, before_flight=True))
        self.flying = self._clear = False


def _touch(time_s: float, state: QuadrotorState, pad: PadTruth, on_pad: bool) -> TouchdownState:
    # the turning board's velocity at the contact point; the ground has none
    carried = pad.velocity_at_ned_m_s(state.position_ned_m) if on_pad else ZERO3
    relative = subtract(state.velocity_ned_m_s, carried)
    away = subtract(state.position_ned_m, pad.position_ned_m)
    axes = pad.axes()
    normal = axes.down if on_pad else _DOWN
    tilt_rad = tilt_from_normal(pad, state.attitude) if on_pad else tilt_from_quat(state.attitude)
    return TouchdownState(
        time_s=time_s,
        lateral_error_m=math.hypot(*_along_surface(away, axes.down)),
        vertical_speed_m_s=dot(relative, normal),
        horizontal_speed_m_s=math.hypot(*_along_surface(relative, normal)),
        tilt_deg=math.degrees(tilt_rad),
        yaw_error_deg=math.degrees(wrap_angle(yaw_from_quat(state.attitude) - pad.heading_rad)),
        pad_speed_m_s=norm(pad.velocity_ned_m_s),
        impact_speed_m_s=norm(relative),
        on_pad=on_pad,
        offset_pad_m=(dot(away, axes.forward), dot(away, axes.right)),
        position_ned_m=state.position_ned_m,
    )


def _along_surface(v: Vector3, normal: Vector3) -> Vector3:
    return subtract(v, scale(normal, dot(v, normal)))


# ---------------------------------------------------------------- the verdict


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome, the touchdown as reported if any, a line for each violated bound, and every contact."""

    outcome: Outcome
    touchdown: dict[str, float] | None
    failures: tuple[str, ...] = ()
    contacts: tuple[ContactResult, ...] = ()


def judge(
    watch: TouchdownDetector,
    bounds: PassBounds,
    *,
    at_rest_on_pad: bool,
    disarmed: bool,
    final_phase: Phase,
) -> Verdict:
    """Judge a flight that has ended, or whose time is up, by what was seen of it.

    Landed: its only contact is the touchdown, on the pad within the bounds, and it stands on it and is
    disarmed. Missed: it touched down but touched something before, violated a bound, left the pad or came
    down beside it. Aborted: the app gave up, whatever the place. Timeout: none of these, or on the pad but
    still armed.
    """
    touchdown, nearest_m = watch.touchdown, watch.nearest_obstacle_m
    result = None if touchdown is None else touchdown.reported()
    told = tuple(_told(contact, touchdown, bounds) for contact in watch.contacts)
    struck = nearest_m is not None and nearest_m <= 0.0
    wrong = tuple(map(_in_words, (contact for contact in told if contact.violations)))
    if watch.crashed or struck:
        why = "touched an obstacle" if struck else "crashed"
        return Verdict(Outcome.CRASHED, result, (why, *wrong), told)
    if final_phase is Phase.ABORT:
        return Verdict(Outcome.ABORTED, result, ("the app aborted", *wrong), told)
    if touchdown is None:
        return Verdict(Outcome.TIMEOUT, None, ("never touched down", *wrong), told)
    # the touchdown is the last contact
    violated = told[-1].violations
    failures = (*(wrong[:-1] if violated else wrong), *violated)
    if not at_rest_on_pad:
        failures = (*failures, "not at rest on the pad")
    if failures:
        return Verdict(Outcome.MISSED, result, failures, told)
    if not disarmed:
        return Verdict(Outcome.TIMEOUT, result, ("not disarmed",), told)
    return Verdict(Outcome.LANDED, result, (), told)


def _told(contact: TouchdownState, landing: TouchdownState | None, bounds: PassBounds) -> ContactResult:
    """The contact with all that is wrong about it."""
    if contact is landing:
        violations = _violated(contact, bounds)
    else:
        # An autopilot that takes off in a gust slides before it lifts: the real ArduCopter at 1.3 m/s in
        # 11 m/s. That is its own doing, on the ground where it stood.
        violations = (
            _too_hard(contact, bounds)
            if contact.before_flight
            else ("before the landing", *_too_fast(contact, bounds))
        )
    return ContactResult(
        time_s=contact.time_s,
        surface="pad" if contact.on_pad else "ground",
        position_ned_m=contact.position_ned_m,
        lateral_error_m=contact.lateral_error_m,
        vertical_speed_m_s=contact.vertical_speed_m_s,
        horizontal_speed_m_s=contact.horizontal_speed_m_s,
        tilt_deg=contact.tilt_deg,
        touches=contact.touches,
        violations=violations,
    )


def _in_words(contact: ContactResult) -> str:
    return (
        f"touched the {contact.surface} {contact.lateral_error_m:.1f} m from the pad's centre at "
        f"{contact.vertical_speed_m_s:.2f} m/s down, {contact.horizontal_speed_m_s:.2f} m/s sideways: "
        f"{', '.join(contact.violations)}"
    )


def _over(measured: Iterable[tuple[str, float, float, str]]) -> tuple[str, ...]:
    return tuple(
        f"{name} {value:.2f} {unit}, expected at most {limit:g}"
        for name, value, limit, unit in measured
        if not value <= limit  # so that what is no number is no landing
    )


def _too_hard(contact: TouchdownState, bounds: PassBounds) -> tuple[str, ...]:
    return _over((("vertical speed", contact.vertical_speed_m_s, bounds.vertical_speed_m_s, "m/s"),))


def _too_fast(contact: TouchdownState, bounds: PassBounds) -> tuple[str, ...]:
    sideways = ("horizontal speed", contact.horizontal_speed_m_s, bounds.horizontal_speed_m_s, "m/s")
    return (*_too_hard(contact, bounds), *_over((sideways,)))


def _violated(touchdown: TouchdownState, bounds: PassBounds) -> tuple[str, ...]:
    violated = (
        *_over((("lateral error", touchdown.lateral_error_m, bounds.lateral_error_m, "m"),)),
        *_too_fast(touchdown, bounds),
        *_over((("tilt", touchdown.tilt_deg, bounds.tilt_deg, "deg"),)),
    )
    return violated if touchdown.on_pad else ("touched down beside the pad", *violated)
