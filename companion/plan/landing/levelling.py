"""When the vehicle goes level for the contact, and for how long; how far it tilts by then.

The vehicle levels shortly before contact, and briefly: a level vehicle cannot follow the pad and drifts. If
contact comes late it stays level while the drift is small, and longer where it is so low that a tilt would
put a foot on the pad. The reference comes against the drift, so that there is none when the contact is due.
The more tilt is levelled off, the firmer it sets down: less time to drift in.

The vehicle's tilt against the wind stays, that for the pad's acceleration turns with its course:
over a pad on a circle there is a moment at which the two are against one another.
NED, rad, SI units.
"""

from __future__ import annotations

import cmath
import math
from statistics import NormalDist
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, tilt_from_quat
from companion.base.messages import ACCELERATION_FILTER_S, LevelOff, PadState, VehicleState
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.debounce import StepClock
from companion.plan.inputs import LONGEST_CYCLE_S
from companion.plan.landing.contact import RESPONDS_S, UNSEEN_S
from companion.plan.landing.drift import AFTER_S, LEVELS_M_S3, Drift
from companion.plan.trajectory.reference_generator import ReferenceGenerator

# Beside the leg height's own: the pose, and a sink that wind and ground effect change by 0.05 m/s in 0.3 s
# of levelling off (a standard deviation).
CONTACT_STD_M: Final = 0.015
# Near the pad the ground effect slows the sink; below this share of the planned sink only for moments: what
# sinks no faster may have met it.
SLOWEST_SINK: Final = 0.5
LEARNS_S: Final = 2.0  # what gusts do: what it was before is of another wind and course
NORMAL: Final = NormalDist()
# Of the speed over the pad that one may start down with; what is gentle on the feet is a bit more.
FASTEST_DRIFT: Final = 2.0


class TiltPrediction:
    """How far the vehicle tilts, and will have to, as the horizontal acceleration that its thrust makes.

    It has to go with the pad, against the force of the air, which the accelerometer feels. The tilt that
    there is tells less: it makes up for errors as well, and comes later.
    """

    SMOOTHING_S: Final = 0.25

    def __init__(self) -> None:
        self.tilt_rad = self._scatter_m2_s4 = 0.0
        # complex: north + i east
        self._lasting_m_s2 = 0j
        self._sight: PadState | None = None
        self._clock = StepClock()

    def note(self, vehicle: VehicleState, sight: PadState | None, now_s: float) -> None:
        """Take in the vehicle's tilt and what the air does to it; an unseen pad goes on as it did."""
        self._sight = sight or self._sight
        self.tilt_rad = tilt_from_quat(vehicle.attitude)
        elapsed_s = self._clock.step_s(now_s)
        change = -complex(*vehicle.side_force_ned_m_s2[:2]) - self._lasting_m_s2
        self._lasting_m_s2 += -math.expm1(-elapsed_s / self.SMOOTHING_S) * change
        learns = -math.expm1(-min(LONGEST_CYCLE_S, elapsed_s) / LEARNS_S)
        # what the side force's low-pass leaves of the sensor's white noise is no gust
        noise_m2_s4 = 0.5 * vehicle.acceleration_density_m2_s3 / ACCELERATION_FILTER_S
        gust_m2_s4 = 0.5 * abs(change) ** 2 - noise_m2_s4
        self._scatter_m2_s4 += learns * (gust_m2_s4 - self._scatter_m2_s4)

    @property
    def scatter_m2_s4(self) -> float:
        """Mean square on an axis of what gusts have changed it by lately, within `SMOOTHING_S`."""
        return max(0.0, self._scatter_m2_s4)

    @property
    def _with_pad_m_s2(self) -> complex:
        return 0j if self._sight is None else complex(*self._sight.acceleration_ned_m_s2[:2])

    def predicted_m_s2(self, ahead_s: float) -> complex:
        """How much it will take so much later (m/s²), north + i east."""
        turned = cmath.rect(1.0, ahead_s * (0.0 if self._sight is None else self._sight.turn_rate_rad_s))
        return self._lasting_m_s2 + self._with_pad_m_s2 * turned


class Levelling:
    """One window of level attitude; `reset` for the next."""

    def __init__(self, config: TouchdownConfig, vehicle: VehicleConfig, leg_height_std_m: float) -> None:
        self._config, self._vehicle = config, vehicle
        self._std_m = math.hypot(leg_height_std_m, CONTACT_STD_M)
        self._tilt_rad = math.radians(config.contact_tilt_deg)
        self._foot_drop_m = vehicle.foot_reach_m * math.sin(self._tilt_rad)  # of the foot that hangs lower
        self._level_m_s2 = GRAVITY_M_S2 * math.tan(self._tilt_rad)
        self.reset()

    def reset(self) -> None:
        """No contact is near."""
        self.due_s = math.inf
        # from when on it is level, how long before the contact, and how much tilt was needed
        self._level: tuple[float, float, float] | None = None
        self._too_low_s = -math.inf
        self._ahead: LevelOff | None = None
        self.planned_m_s = self._config.contact_speed_m_s

    def sink_m_s(self, needed_m_s2: float) -> float:
        """The sink rate for a contact at which pad and wind need so much tilt.

        What the level vehicle lacks of it makes it drift for as long as the contact is late: firm enough that
        the drift stays small where it lies deeper than expected by two standard deviations.
        """
        c = self._config
        excess_m_s2 = needed_m_s2 - self._level_m_s2
        return max(
            c.contact_speed_m_s,
            min(c.firm_contact_m_s, excess_m_s2 * 2.0 * self._std_m / c.lateral_speed_m_s),
        )

    def drift(
        self, needed_m_s2: float, scatter_m2_s4: float, sink_std_m_s: float, ahead_s: float
    ) -> tuple[float, float]:
        """Standard deviations (m/s, m) of what a level vehicle drifts by until it touches so much later.

        It lacks what is needed beyond its level, a normal distribution cut off at none. The reference is
        ahead of that but for a late contact, by how much deeper it may lie and how much slower the vehicle
        may sink while it levels, and for what gusts change meanwhile: as a random walk, of which
        `scatter_m2_s4` is the mean square beside its own low-pass.
        """
        levels_s = min(ahead_s, self._levelling_s(math.atan(needed_m_s2 / GRAVITY_M_S2)))
        late_s = math.hypot(self._std_m, sink_std_m_s * levels_s) / self.sink_m_s(needed_m_s2)
        lasts_s = levels_s + late_s
        variance = 2.0 * scatter_m2_s4 * lasts_s / TiltPrediction.SMOOTHING_S
        lacks_m_s2, std_m_s2 = needed_m_s2 - self._level_m_s2, math.sqrt(variance) + 1e-9
        share, density = NORMAL.cdf(lacks_m_s2 / std_m_s2), std_m_s2 * NORMAL.pdf(lacks_m_s2 / std_m_s2)
        mean = lacks_m_s2 * share + density
        square = max(0.0, (lacks_m_s2**2 + variance) * share + lacks_m_s2 * density)
        speed_m_s = math.sqrt(square * late_s**2 + max(0.0, square - mean**2) * lasts_s**2 / 3.0)
        return speed_m_s, 0.5 * levels_s * speed_m_s

    @property
    def begun(self) -> bool:
        """Whether it goes level by now."""
        return self._level is not None

    def window(self) -> LevelOff | None:
        """Until when the vehicle may tilt how far at most; None until the contact is near."""
        if self._level is None:
            return self._ahead
        from_s, lead_s, needed_m_s2 = self._level
        late_s = max(0.0, self.due_s - lead_s - from_s)
        excess_m_s2 = needed_m_s2 - self._level_m_s2
        if excess_m_s2 > 0.0:
            late_s = min(late_s, self._config.lateral_speed_m_s / excess_m_s2)
        until_s = max(from_s + late_s, self._too_low_s) + lead_s + AFTER_S
        return LevelOff(from_s, until_s, self._tilt_rad)

    def expect(
        self, sight: PadState, tilt: TiltPrediction, generator: ReferenceGenerator, now_s: float
    ) -> None:
        """When the feet will touch: by the sink as planned, until it goes level; from then on as seen.

        Unseen, what was expected last holds: it goes level by that.
        """
        fresh = sight.unseen_s <= UNSEEN_S
        over_m = sight.height_m - self._vehicle.leg_height_m
        reference = generator.at(now_s)
        if fresh:
            planned_m_s = (SLOWEST_SINK if self.begun else 1.0) * self.planned_m_s
            sink_m_s = max(planned_m_s, sight.sink_m_s)
            self.due_s = now_s + max(0.0, over_m - self._foot_drop_m) / sink_m_s
            if not self.begun:
                # until the reference sinks as fast as is planned
                blends_s = max(0.0, generator.end_s - now_s)
                blended_m = generator.at(now_s + blends_s).position_m[2] - reference.position_m[2]
                self.due_s += blends_s - blended_m / planned_m_s
        # before it responds it tilts as far as the reference asks for by now
        asked_m_s2 = abs(tilt.predicted_m_s2(0.0) + complex(*reference.acceleration_m_s2[:2]))
        tilt_rad = max(tilt.tilt_rad, math.atan(asked_m_s2 / GRAVITY_M_S2))
        lead_s = self._levelling_s(tilt_rad)
        if not self.begun and now_s >= self.due_s - lead_s:
            self._level = now_s, lead_s, abs(tilt.predicted_m_s2(0.0))
        level_s = self.due_s - self._tilts_on_s(tilt_rad)
        self._ahead = LevelOff(level_s, self.due_s + AFTER_S, self._tilt_rad)
        # no tilt that would put a foot on the pad, unless the level vehicle drifts so fast that this is worse
        slow = sight.lateral_speed_m_s <= FASTEST_DRIFT * self._config.lateral_speed_m_s
        if self._level is not None and fresh and slow:
            hangs_m = self._vehicle.foot_reach_m * math.sin(math.atan(self._level[2] / GRAVITY_M_S2))
            if over_m <= hangs_m + self._config.contact_margin_m:
                self._too_low_s = now_s

    def drift_of(self, needed_m_s2: complex, due_s: float) -> Drift:
        """The drift to a contact that is due then, of a vehicle that needs so much (north + i east)."""
        most = self._level_m_s2 / (abs(needed_m_s2) + 1e-9)
        lacks_m_s2 = needed_m_s2 * max(0.0, 1.0 - most)
        sink_m_s = max(self.planned_m_s, self.sink_m_s(abs(needed_m_s2)))
        return Drift(lacks_m_s2, due_s, self._std_m / sink_m_s)

    def touching(self, now_s: float) -> None:
        """No tilt while contact is confirmed."""
        self.due_s = self._too_low_s = now_s
        if self._level is None:
            self._level = now_s - RESPONDS_S, RESPONDS_S, 0.0

    def stay(self, now_s: float) -> None:
        """Level until told otherwise."""
        self._level = self._level or (now_s, RESPONDS_S, 0.0)
        self.due_s = now_s + self._level[1]

    def _levelling_s(self, tilt_rad: float) -> float:
        """How long before the contact it has to begin to level off from a tilt."""
        excess_m_s2 = GRAVITY_M_S2 * math.tan(tilt_rad) - self._level_m_s2
        return self._tilts_on_s(tilt_rad) + max(0.0, excess_m_s2) / LEVELS_M_S3

    def _tilts_on_s(self, tilt_rad: float) -> float:
        """How long before the contact the command has to be level for a contact that comes early."""
        return RESPONDS_S + self._std_m / self.sink_m_s(GRAVITY_M_S2 * math.tan(tilt_rad))
