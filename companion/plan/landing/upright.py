"""Whether a vehicle whose motors have just stopped has landed: it stands upright, on the pad.

A motor that stops is no landing by itself: a kill switch, a crash detected and a vehicle that has toppled
over the pad's edge end in the same word. Relative to the pad, NED axes, m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from companion.base.geometry import Quaternion, quat_rotate
from companion.base.messages import LandedState, PadState
from companion.config import VehicleConfig
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import AWAY_M

_FRESH_S: Final = 1.0
# No deck that is landed on tilts so far (24 deg is refused for a ship's), and legs that stand do not either.
_UPRIGHT_RAD: Final = math.radians(30.0)


def not_standing(
    sight: PadState | None,
    inputs: PlanInputs,
    vehicle: VehicleConfig,
    pad_reach_m: float,
    now_s: float,
    *,
    surface_m: float | None,
    touched: bool,
) -> str:
    """Why it does not stand upright on the pad, in words; "" when it does.

    Both attitudes count, ours and the autopilot's, as long as they are fresh. `pad_reach_m`: from the pad's
    middle to its corner. `surface_m`: the height over what several echoes agree on. `touched`: the feet have
    been shown down.
    """
    attitudes = [*_attitudes(inputs, now_s)]
    tilt_rad = max((_tilt_rad(attitude) for attitude in attitudes), default=None)
    if tilt_rad is None:
        return "attitude unknown"
    if tilt_rad > _UPRIGHT_RAD:
        return f"tilted by {math.degrees(tilt_rad):.0f} deg"
    if why := _elsewhere(sight, surface_m, vehicle.leg_height_m + AWAY_M, pad_reach_m):
        return why
    if not touched and inputs.autopilot.landed is not LandedState.ON_GROUND:
        return "contact never confirmed"
    return ""


def _elsewhere(sight: PadState | None, surface_m: float | None, deepest_m: float, pad_reach_m: float) -> str:
    """Where the pad is instead, by a fresh sight or else by the echoes; "" where neither says so."""
    if sight is None or sight.age_s > _FRESH_S:
        away = surface_m is not None and surface_m > deepest_m
        return f"surface {surface_m:.1f} m below" if away else ""
    if sight.lateral_m > pad_reach_m:
        return f"{sight.lateral_m:.1f} m beside the pad's centre"
    return f"the pad is {sight.height_m:.1f} m below" if sight.height_m > deepest_m else ""


def _attitudes(inputs: PlanInputs, now_s: float) -> Iterator[Quaternion]:
    ours = inputs.vehicle
    if ours is not None and ours.aligned and now_s - ours.sensed_time_s <= _FRESH_S:
        yield ours.attitude
    autopilot = inputs.autopilot
    if autopilot.attitude is not None and now_s - autopilot.attitude_time_s <= _FRESH_S:
        yield autopilot.attitude


def _tilt_rad(attitude: Quaternion) -> float:
    return math.acos(max(-1.0, min(1.0, quat_rotate(attitude, (0.0, 0.0, 1.0))[2])))
