"""Looking for the pad: hold, ask the ground station where it is, fly there, spiral (Algorithm 1, else).

The search ends only with a pad that will stay in view: the vehicle flies back to one seen in passing. One
reported to be faster than any that is followed is waited for, not chased. All is in the EKF's NED, m, s
and rad; the height is chosen on entry and kept, but for a floor that rises. A step of the EKF's position is
none of the vehicle: the height goes along with it.
"""

import math
from dataclasses import dataclass
from typing import Final

from companion.base.geometry import ZERO3, Vector3, add
from companion.base.messages import PadBeacon, PadState
from companion.base.motion import Motion
from companion.config import SearchConfig
from companion.plan.debounce import Debounce
from companion.plan.landing.contact import KNOWN_S
from companion.plan.landing.relative_state import PadTrack
from companion.plan.search.pad_locator import Lead, PadLocator
from companion.plan.trajectory.min_jerk import SHORTEST_STOP_S
from companion.plan.trajectory.reference_generator import ReferenceGenerator

VIEW_SLOPE: Final = 0.4  # metres aside a metre of height; half the view of 640x480 at fx 533 ends at 0.45

# The reference is at a corner when this close, and goes on to the next without a halt.
_CORNER_M = 1.0
# The floor acts in steps, so that its noise is not flown.
_FLOOR_STEP_M = 0.3
# A pad steadily in view for this long ends the search however it moves.
_LONG_IN_VIEW_S = 3.0
_ANY_SIGHT_AFTER_S = 10.0
# Detours are not planned in every cycle: after this long one was tried to the present corner.
_SOUGHT_S = 0.5


def square_spiral(corner: int, spacing_m: float) -> tuple[float, float]:
    """North and east (m) of a corner of the expanding square; corner 0 is its centre.

    The legs grow so that neighbouring turns lie one spacing apart.
    """
    if corner == 0:
        return (0.0, 0.0)
    turn, side = divmod(corner - 1, 4)
    near, far = turn * spacing_m, (turn + 1) * spacing_m
    return ((far, -near), (far, far), (-far, far), (-far, -far))[side]


@dataclass(frozen=True, slots=True)
class SearchStep:
    """What a cycle of searching asks for; `streaming`: setpoints have been ready for long enough."""

    streaming: bool = False
    request_pad: bool = False
    seen: bool = False
    flying: bool = False


class Search:
    """One search after another: `begin`, then `step` every cycle. Steers the reference in the EKF's NED."""

    def __init__(
        self, config: SearchConfig, generator: ReferenceGenerator, fastest_m_s: float = math.inf
    ) -> None:
        self._config, self._generator, self._fastest_m_s = config, generator, fastest_m_s
        self.locator = PadLocator(config)
        self._place_m, self._most_up_m = ZERO3, 0.0  # where it holds, and at what height it searches
        self._corner = 0
        self._next_request_s = -math.inf
        self._held = Debounce()

    def hear(self, beacon: PadBeacon | None, origin: Vector3 | None) -> None:
        """Take in the beacon; one far from the expected place restarts the spiral."""
        if self.locator.hear(beacon, origin):
            self._corner = 0
            self._held.end("arrived")

    def request_now(self) -> None:
        """Ask for the pad's position at the next step, however lately that was done."""
        self._next_request_s = -math.inf

    def begin(self, climb_m: float, lowest_down_m: float, now_s: float) -> float:
        """Start from the reference; returns the climb (m), bounded, that the search will make.

        It ends no lower than lowest_down_m (EKF's NED), and that bounds it too.
        """
        here = self._generator.at(now_s).position_m
        self.locator.start = Lead(-math.inf, here)
        wished_m = max(0.0, min(self._config.climb_m, climb_m))
        down_m = min(here[2] - wished_m, lowest_down_m)
        self._place_m = (*self._generator.resting_place_m()[:2], down_m)
        self._most_up_m = down_m - self._config.climb_m
        self._corner = 0
        self._held.end("arrived", "sought", "in view", "searches")
        self._held.held_s("searches", True, now_s)
        return here[2] - down_m

    def go_along(self, step_m: Vector3) -> None:
        """Keep the height and where it holds, though the EKF's position stepped; places sought stay."""
        self._place_m = add(self._place_m, step_m)
        self._most_up_m += step_m[2]

    def keep_above(self, lowest_down_m: float) -> float:
        """Keep the search above a floor (EKF's NED) that rose; returns the climb (m), if any.

        All such climbs of a search together are bounded: a floor that keeps rising is a fault.
        """
        floor_m = max(lowest_down_m, self._most_up_m)
        climb_m = self._place_m[2] - floor_m
        if climb_m < _FLOOR_STEP_M:
            return 0.0
        self._place_m = (*self._place_m[:2], floor_m - _FLOOR_STEP_M)
        return climb_m + _FLOOR_STEP_M

    def ask_again(self, unseen_s: float, now_s: float) -> bool:
        """Whether to ask for the pad's position outside of a search.

        That is while the pad is unseen, and once while it is seen: to learn by how much the beacon is off.
        """
        wanted = not self.locator.beacon_compared or unseen_s > KNOWN_S
        return wanted and self._request_due(now_s)

    def _request_due(self, now_s: float) -> bool:
        if now_s < self._next_request_s:
            return False
        self._next_request_s = now_s + self._config.request_s
        return True

    def _takes_up(self, pad: PadTrack, now_s: float) -> bool:
        """Whether the pad will stay in view: its velocity is known, and no overshoot loses it."""
        steady = pad.steady(now_s)
        long = self._held.held_s("in view", steady, now_s) >= _LONG_IN_VIEW_S
        # a pad that turns as fast as we fly is never met with little overshoot: then any sighting counts
        late = self._held.held_s("searches", True, now_s) >= _ANY_SIGHT_AFTER_S
        return steady and pad.sight is not None and (long or late or self._stays_in_view(pad.sight))

    def _stays_in_view(self, sight: PadState) -> bool:
        c = self._config
        (x, y, _), (vx, vy, _) = sight.relative_position_ned_m, sight.relative_velocity_ned_m_s
        stop_s = math.hypot(vx, vy) / (2.0 * self._generator.limits.horizontal_acceleration_m_s2)
        overshoot_m = math.hypot(x + stop_s * vx, y + stop_s * vy)
        return sight.velocity_std_m_s <= c.velocity_std_m_s and overshoot_m <= VIEW_SLOPE * sight.height_m

    def step(
        self, actual: Motion, in_control: bool, pad: PadTrack, now_s: float, *, believed: bool = True
    ) -> SearchStep:
        """One cycle; `actual` is the vehicle in the EKF's NED. A pad that is not believed ends no search."""
        seen = self._takes_up(pad, now_s) and believed
        control_s = self._held.held_s("control", in_control, now_s)
        searched_s = self._held.held_s("searches", True, now_s)
        if not in_control:
            # PX4 changes to OFFBOARD only while setpoints stream; the headings are compared meanwhile
            return SearchStep(streaming=searched_s >= self._config.stream_s)
        if control_s == 0.0:
            self._generator.take_up(actual, now_s)
        if seen:
            return SearchStep(seen=True)
        request = not pad.steady(now_s) and self._request_due(now_s)
        flying = min(searched_s, control_s) >= self._config.hold_s or self.locator.seen_lately(now_s)
        flying = not self._waits_for_it(now_s) and flying
        if flying:
            self._generator.fly_to(self._target(now_s), now_s)
        elif searched_s >= SHORTEST_STOP_S:  # a search that begins with a climb comes to rest first
            self._generator.fly_to(Motion(self._place_m), now_s)
        return SearchStep(request_pad=request, flying=flying)

    def _waits_for_it(self, now_s: float) -> bool:
        """Whether the pad is too fast to be followed; the reference comes to rest when that begins."""
        fast = math.hypot(*self.locator.likely(now_s).velocity_m_s[:2]) > self._fastest_m_s
        if self._held.held_s("too fast", fast, now_s) == 0.0:
            self._generator.rest(self._generator.at(now_s), now_s)
            self._place_m = (*self._generator.resting_place_m()[:2], self._place_m[2])
        return fast

    def _target(self, now_s: float) -> Motion:
        """The pad's likely place first, then the corners of a spiral about it, moving as it does."""
        centre = self.locator.likely(now_s)
        reference = self._generator.at(now_s).position_m
        place = self._corner_of(centre)
        # a corner that obstacles block counts as visited once a detour to it was tried
        sought = self._held.held_s("sought", True, now_s) >= _SOUGHT_S
        if math.dist(reference[:2], place) < _CORNER_M or (sought and self._generator.avoidance.blocked):
            self._at_corner(now_s)
            place = self._corner_of(centre)
        return Motion((*place, self._place_m[2]), centre.velocity_m_s, centre.acceleration_m_s2)

    def _at_corner(self, now_s: float) -> None:
        """Go on to the next corner; dwell at the centre first."""
        if self._held.held_s("arrived", True, now_s) < self._config.dwell_s and self._corner == 0:
            return
        north, east = square_spiral(self._corner + 1, self._config.spacing_m)
        # beyond the radius it restarts: the pad may have come closer. A place at which it is not seen is one
        # turn wrong at least, however surely it is told
        reach_m = self.locator.reach_m(now_s) + 0.5 * self._config.spacing_m
        farthest_m = min(self._config.radius_m, max(reach_m, math.sqrt(2.0) * self._config.spacing_m))
        self._corner = 0 if math.hypot(north, east) > farthest_m else self._corner + 1
        self._held.end("arrived", "sought")

    def _corner_of(self, centre: Motion) -> tuple[float, float]:
        north, east = square_spiral(self._corner, self._config.spacing_m)
        return (centre.position_m[0] + north, centre.position_m[1] + east)
