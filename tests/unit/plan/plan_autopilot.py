"""An autopilot for the planner alone: it answers actions and keeps the modes that are its own."""

import math
from dataclasses import dataclass, field

from companion.base.geometry import ZERO3, Vector3, ned_from_geodetic
from companion.base.messages import Action, ActionKind, ActionResult, LandedState

HOME = (47.0, 8.0, 400.0)
GIVES_UP_S = 2.0  # the link, after four tries


@dataclass
class PlanAutopilot:
    """Answers actions; flies the modes that are its own."""

    autopilot_kind: str = "px4"
    armed: bool = False
    mode: str = "HOLD"
    refuse: dict[ActionKind, int] = field(default_factory=dict)
    silent: set[ActionKind] = field(default_factory=set)
    target_ned_m: Vector3 = ZERO3
    landed: LandedState = LandedState.ON_GROUND
    connected: bool = True
    heard: list[tuple[float, ActionKind]] = field(default_factory=list)
    ready_from_s: float = 2.0
    ekf_ready_from_s: float = 0.0
    doubts: bool = False  # never finds that it has landed
    battery_share: float | None = None
    round_trip_s: float | None = 0.02
    untold: frozenset[str] = frozenset()  # fields of the state that have never come
    twin_until_s: float = -math.inf
    rival: tuple[int, int] | None = None

    def answer(self, action: Action, position: Vector3, now_s: float) -> ActionResult | None:
        """What the link makes of it, as of `time_s`."""
        kind = action.kind
        self.heard.append((now_s, kind))
        if kind is ActionKind.REQUEST_PAD_POSITION:
            return None
        if kind is ActionKind.ARM and self.armed:
            return ActionResult(now_s, kind, False, "armed before it has answered", in_doubt=None)
        if kind in self.silent:
            return ActionResult(now_s + GIVES_UP_S, kind, False, "it does not answer", in_doubt=True)
        if kind is ActionKind.HOLD_IF_OBEYED and self.mode not in {"OFFBOARD", "GUIDED"}:
            return None  # the link waits for a heartbeat that shows it
        if self.refuse.get(kind, 0) > 0:
            self.refuse[kind] -= 1
            return ActionResult(now_s, kind, False, "Denied: not now")
        return ActionResult(now_s, kind, self._obey(action, position), "")

    def _obey(self, action: Action, position: Vector3) -> bool:
        kind = action.kind
        if kind is ActionKind.ARM:
            self.armed = True
        elif kind is ActionKind.DISARM:
            if self.landed is not LandedState.ON_GROUND and not action.force:
                return False
            self.armed = False
        elif kind is ActionKind.TAKE_OFF:
            self.mode, self.target_ned_m = (
                self._own_mode("TAKEOFF"),
                (position[0], position[1], -action.height_m),
            )
        elif kind is ActionKind.GO_TO:
            assert action.position is not None
            latitude, longitude, height = action.position
            north, east, _ = ned_from_geodetic(latitude, longitude, HOME[2], HOME)
            self.mode, self.target_ned_m = self._own_mode("LOITER"), (north, east, -height)
        elif kind is ActionKind.TAKE_CONTROL:
            self.mode = self._own_mode("OFFBOARD")
        elif kind is ActionKind.LEAVE_OFFBOARD:
            self.mode = "LOITER"
        elif kind in {ActionKind.HOLD, ActionKind.HOLD_IF_OBEYED}:
            self.mode, self.target_ned_m = "LOITER", position
        elif kind is ActionKind.LAND:
            self.mode, self.target_ned_m = "LAND", (position[0], position[1], 5.0)
        return True

    def _own_mode(self, px4: str) -> str:
        """ArduPilot flies all of these in GUIDED."""
        return px4 if self.autopilot_kind == "px4" else "GUIDED"
