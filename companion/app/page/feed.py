"""A tap on the log: keeps the newest of what the page shows, and a minute or two of plots and phases.

It gets every message on the control loop, so it keeps references and computes nothing: a picture is
put together when one is due and somebody looks.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel

from companion.app.page.look import Look, TrackPoint
from companion.base.geometry import add, scale
from companion.base.messages import Frame, FrameReport, PadSighting, PadState, Phase, PlanStep, VehicleState
from companion.config import CompanionConfig, VehicleConfig
from companion.flightlog.foxglove.scene import time_to_touchdown_s
from companion.flightlog.meter import Meter
from companion.flightlog.record import Tap

TRACK_PERIOD_S: Final = 0.2
TRACK_S: Final = 120.0
PHASES_KEPT: Final = 40
# at 30 Hz: longer than from exposure to the frame's result
STATES_KEPT: Final = 12
OLDEST_STATE_S: Final = 0.5

M = TypeVar("M", VehicleState, PadState)


class LiveFeed(Tap):
    """Takes what the log takes."""

    def __init__(self, rate_hz: float, meter: Meter | None = None) -> None:
        """At most `rate_hz` pictures a second; `meter` counts already, else one is kept here."""
        self.meter = Meter() if meter is None else meter
        self._counts = meter is None
        self._period_s = 1.0 / rate_hz
        self._next_picture_s = self._next_point_s = float("-inf")
        self._frame: Frame | None = None
        self._sighting: PadSighting | None = None
        self._plan: PlanStep | None = None
        self._vehicles: deque[VehicleState] = deque(maxlen=STATES_KEPT)
        self._pads: deque[PadState] = deque(maxlen=STATES_KEPT)
        self.track: deque[TrackPoint] = deque(maxlen=round(TRACK_S / TRACK_PERIOD_S))
        self.phases: deque[tuple[float, str]] = deque(maxlen=PHASES_KEPT)
        self.settings: dict[str, BaseModel] = {}
        self.failure: str | None = None  # of ours, after which nothing is taken any more
        self.on_look: Callable[[Look], None] | None = None  # while somebody looks
        self._takers: dict[str, Callable[[Any, float], None]] = {
            "vehicle": lambda message, _: self._vehicles.append(message),
            "pad": lambda message, _: self._pads.append(message),
            "plan": self._take_plan,
            "sighting": self._take_sighting,
            "frame_report": self._take_report,
        }

    def know(self, settings: Mapping[str, BaseModel]) -> None:
        self.settings |= settings

    def frame(self, frame: Frame) -> None:
        self._frame = frame

    def note(self, topic: str, message: Any, time_s: float) -> None:
        if self._counts:
            self.meter.note(topic, message, time_s)
        take = self._takers.get(topic)
        if take is None:
            return
        try:
            take(message, time_s)
        except Exception as error:
            # whoever logs is flying: a fault of ours leaves the page without news, and nothing more
            self.failure = f"{type(error).__name__}: {error}"
            self._takers.clear()

    def look(self, now_s: float) -> Look:
        """What there is without a picture."""
        return Look(self._point(now_s), self._phase)

    def lacks_pictures(self, now_s: float) -> bool:
        """Whether none came for so long that the rest is to be sent without one."""
        return now_s > self._next_picture_s + 2.0 * self._period_s

    @property
    def _phase(self) -> str:
        return self.phases[-1][1] if self.phases else ""

    def _take_plan(self, plan: PlanStep, time_s: float) -> None:
        self._plan = plan
        if plan.phase.value != self._phase:
            self.phases.append((time_s, plan.phase.value))
        if time_s >= self._next_point_s:
            self._next_point_s = time_s + TRACK_PERIOD_S
            self.track.append(self._point(time_s))

    def _take_sighting(self, sighting: PadSighting, _: float) -> None:
        self._sighting = sighting

    def _take_report(self, report: FrameReport, time_s: float) -> None:
        """A frame's result is complete with its report."""
        if self.on_look is None or time_s < self._next_picture_s or self._frame is None:
            return
        # a camera's period that divides ours badly must not halve the rate
        self._next_picture_s = max(self._next_picture_s + self._period_s, time_s + 0.5 * self._period_s)
        self.on_look(self._picture(self._frame, report, time_s))

    def _picture(self, frame: Frame, report: FrameReport, now_s: float) -> Look:
        sighting = self._sighting
        seen = report.seen and sighting is not None and sighting.sequence == frame.sequence
        vehicle, pad = _nearest(self._vehicles, frame.time_s), _nearest(self._pads, frame.time_s)
        touchdown_s = self._touchdown_s(now_s)
        place = None
        if pad is not None and touchdown_s is not None:
            moved = scale(pad.velocity_ned_m_s, touchdown_s - pad.time_s)
            place = add(pad.relative_position_ned_m, moved)
        return Look(
            self._point(now_s),
            self._phase,
            frame,
            sighting if seen else None,
            None if vehicle is None else vehicle.attitude,
            place,
            self._left_s(touchdown_s, pad, now_s),
        )

    def _touchdown_s(self, now_s: float) -> float | None:
        """When the planned motion reaches the pad."""
        plan = self._plan
        if plan is None or now_s - plan.time_s > OLDEST_STATE_S:
            return None
        duration_s = time_to_touchdown_s(plan)
        return None if duration_s is None else plan.time_s + duration_s

    def _left_s(self, leg_ends_s: float | None, pad: PadState | None, now_s: float) -> float | None:
        """How long until the feet touch; None while that is not known: before the descent.

        A descent's planned motion ends where the final descent begins; that one's speed is known.
        """
        if leg_ends_s is None:
            return None
        leg_s = max(0.0, leg_ends_s - now_s)
        config = self.settings.get("config")
        if not isinstance(config, CompanionConfig):
            return leg_s
        speed_m_s = config.plan.touchdown.contact_speed_m_s
        if self._phase == Phase.DESCEND.value:
            return leg_s + config.plan.landing.wait_height_m / speed_m_s
        if self._phase == Phase.TOUCHDOWN.value and pad is not None:
            return max(0.0, pad.height_m - self._legs_m) / speed_m_s
        return None

    @property
    def _legs_m(self) -> float:
        """From the vehicle's reference point down to its feet."""
        vehicle = self.settings.get("vehicle")
        return vehicle.leg_height_m if isinstance(vehicle, VehicleConfig) else 0.0

    def _point(self, time_s: float) -> TrackPoint:
        vehicle, pad = _newest(self._vehicles, time_s), _newest(self._pads, time_s)
        return TrackPoint(
            time_s,
            None if pad is None else pad.height_m - self._legs_m,
            None if pad is None else pad.lateral_m,
            None if vehicle is None else -vehicle.position_ned_m[2],
        )


def _newest(states: deque[M], now_s: float) -> M | None:
    return states[-1] if states and now_s - states[-1].time_s <= OLDEST_STATE_S else None


def _nearest(states: deque[M], time_s: float) -> M | None:
    """The state nearest to an exposure; None where none is near."""
    found = min(states, key=lambda state: abs(state.time_s - time_s), default=None)
    return found if found is not None and abs(found.time_s - time_s) <= OLDEST_STATE_S else None
