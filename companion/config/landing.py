"""Settings of search, landing and touchdown."""

from __future__ import annotations

from typing import Final, Self

from pydantic import Field, model_validator

from companion.config.reading import OPERATOR, StrictModel

_GUST_M_S: Final = 0.08  # what a gust adds to a planned sink


class SearchConfig(StrictModel):
    """Looking for the pad; Algorithm 1's other branch."""

    stream_s: float = Field(default=0.5, ge=0.1, le=5.0)
    """Time of setpoints before control is requested; raise it if the autopilot refuses"""
    hold_s: float = Field(default=0.7, ge=0.0, le=30.0)
    """Hold this long before the search; raise it for a pad that is often hidden briefly"""
    request_s: float = Field(default=1.5, ge=1.0, le=60.0)
    """How often the ground station is asked for the pad's position; raise it for a slow telemetry radio"""
    dwell_s: float = Field(default=2.0, ge=0.0, le=30.0)
    """Stay over the pad's likely position for this time before the spiral; raise it for a beacon with an
    accurate position"""
    spacing_m: float = Field(default=4.0, ge=0.5, le=30.0)
    """Spacing of the square spiral's turns; lower it for a narrow lens or a low search"""
    radius_m: float = Field(default=12.0, ge=1.0, le=200.0, json_schema_extra=OPERATOR)
    """Beyond this radius the spiral begins again; set it to the largest error of the pad's expected
    position"""
    trust_s: float = Field(default=12.0, ge=1.0, le=120.0)
    """The pad's last position, by its beacon or a sighting, is trusted this long; lower it for a fast pad"""
    lead_s: float = Field(default=5.0, ge=0.0, le=30.0)
    """Extrapolation time of a beacon's velocity; raise it for a beacon received rarely"""
    climb_m: float = Field(default=6.0, ge=0.0, le=30.0)
    """Greatest climb to look for a pad that was lost; announced. 0 keeps the height; lower it under a roof, a
    bridge or a low airspace limit"""
    floor_m: float = Field(default=1.5, ge=0.5, le=10.0)
    """Least height over home and over the last echoes while the pad is unseen; raise it over uneven ground;
    lower is worse: a pad that is not seen may stand above the ground"""
    sightings: int = Field(default=5, ge=1, le=100)
    """This number of sightings confirm a pad; raise it where false markers occur"""
    velocity_std_m_s: float = Field(default=0.5, gt=0.0, le=5.0)
    """Uncertainty of the pad's velocity below which the approach begins. Larger is worse: the approach
    begins with an uncertain motion of the pad. Lower it for fast pads"""


class LandingConfig(StrictModel):
    """Approach and descent over the pad; heights are of the feet over the pad."""

    approach_height_m: float = Field(default=3.0, ge=1.0, le=20.0)
    """Height of the feet over the pad where the approach ends; raise it for a pad with masts or people near
    it, lower it for a pad of small markers"""
    approach_slope: float = Field(default=0.35, gt=0.0, le=3.0)
    """Slope of the approach, lateral metres per metre of height; lower it for a steeper approach"""
    cone_slope: float = Field(default=0.2, gt=0.0, le=1.0)
    """Descent cone: lateral metres allowed per metre of height; lower it for a narrow lens"""
    cone_floor_m: float = Field(default=0.10, gt=0.0, le=1.0)
    """Narrowest half width of the descent cone; lower it for a small pad"""
    wait_height_m: float = Field(default=0.35, ge=0.1, le=2.0)
    """Height of the feet where touchdown begins; raise it in gusts, within the camera's view"""
    retry_height_m: float = Field(default=1.5, ge=0.3, le=5.0)
    """Height to climb back to after a failed try. Lower is worse: the pad may heave or pitch beneath it.
    Raise it for a deck that heaves by more than a metre"""
    retries: int = Field(default=3, ge=0, le=20, json_schema_extra=OPERATOR)
    """Tries after the first; more is worse: each is a further risk low over the pad. Lower it for a small
    battery"""
    pause_unseen_s: float = Field(default=0.5, gt=0.0, le=5.0)
    """If the pad is unseen for this time, the descent pauses, and just over the pad the vehicle climbs and
    tries again. The descent counts it from the last exposure, the wait just over the pad from when that
    sighting came. Raise it where single frames are often lost"""
    lost_unseen_s: float = Field(default=5.0, gt=0.0, le=10.0)
    """If the pad is unseen for this time, it counts as lost; longer is worse: the vehicle follows a
    prediction. Lower it for a pad that changes its course often"""

    @model_validator(mode="after")
    def _waits_lowest(self) -> Self:
        for name in ("approach_height_m", "retry_height_m"):
            if getattr(self, name) < self.wait_height_m:
                raise ValueError(f"{name}: expected at least wait_height_m ({self.wait_height_m:g})")
        return self


class TouchdownConfig(StrictModel):
    """The last third of a metre: when to commit, how fast, and what counts as contact."""

    lateral_m: float = Field(default=0.06, gt=0.0, le=0.5)
    """Lateral offset from the pad's centre below which the final descent begins; raise it if wind prevents
    the vehicle from settling; larger is worse: the feet touch nearer to the edge"""
    lateral_speed_m_s: float = Field(default=0.12, gt=0.0, le=1.0)
    """Speed relative to the pad below which the final descent begins; raise it in strong gusts, up to what
    the landing gear bears"""
    settled_s: float = Field(default=0.2, ge=0.0, le=5.0)
    """Time for which every condition of the final descent has to hold; raise it for a steadier vehicle at
    contact, after a longer wait"""
    gentle_horizontal_m_s2: float = Field(default=1.2, gt=0.0, le=5.0)
    """The pad's horizontal acceleration stays below this at a gentle moment; raise it for a pad that always
    turns harder"""
    gentle_vertical_m_s2: float = Field(default=0.2, gt=0.0, le=5.0)
    """Largest vertical acceleration of the pad at contact; raise it for a deck in heavy sea"""
    contact_tilt_deg: float = Field(default=7.0, ge=1.0, le=30.0)
    """Largest tilt at contact, to which the vehicle levels; raise it for wind in which it cannot level;
    more is worse: one foot touches first, and the vehicle slides"""
    gentle_tilt_m_s2: float = Field(default=1.6, gt=0.0, le=6.0)
    """Horizontal acceleration by tilt that following the pad may take at a gentle moment, wind included;
    raise it in strong wind. Contact is never accepted if the vehicle cannot level within contact_tilt_deg
    and lateral_speed_m_s"""
    contact_deck_tilt_deg: float = Field(default=5.0, ge=1.0, le=30.0)
    """Largest predicted tilt of a swinging deck at contact; the limit widens with the length of a try.
    Raise it for a wide landing gear on a rough sea"""
    gentle_wait_s: float = Field(default=5.0, ge=0.5, le=60.0)
    """Time to wait for a gentle moment. After it the pad's acceleration no longer counts, and a lull of the
    wind is enough. After twice this time the tolerances for offset and speed are 1.5 times as wide, and those
    for tilt and drift widen steadily; after six times the try has failed. Raise it on a rough deck"""
    contact_speed_m_s: float = Field(default=0.19, ge=0.05, le=0.4)
    """Sink rate at contact, relative to the pad; lower it for fragile legs; higher is worse: a harder
    contact, and a bounce"""
    firm_contact_m_s: float = Field(default=0.32, ge=0.05, le=0.4)
    """Largest planned sink rate at contact, for a vehicle that tilts with the pad or against the wind and
    levels off for the contact; lower it for fragile legs, raise it if the vehicle slides at contact in
    strong wind; higher is worse: a harder contact"""
    fastest_contact_m_s: float = Field(default=0.42, ge=0.05, le=1.0)
    """At a greater sink rate the vehicle rises and waits again. Higher is worse: a harder contact. Raise it
    for a strong landing gear, lower it for a fragile one"""
    break_off_lateral_m: float = Field(default=0.07, gt=0.0, le=0.5)
    """Lateral offset beyond which the final descent is broken off. Larger is worse: the feet touch nearer
    to the edge. Raise it for a large pad in strong gusts, lower it for a small one"""
    break_off_above_m: float = Field(default=0.06, ge=0.03, le=1.0)
    """The final descent is broken off only with the feet higher than this; raise it for a vehicle that
    climbs slowly"""
    blend_s: float = Field(default=0.8, ge=0.2, le=3.0)
    """Time of the transition from waiting to the sink rate at contact; raise it for a heavy vehicle"""
    blind_s: float = Field(default=1.5, ge=0.1, le=5.0)
    """If the pad is unseen for this time since the last exposure on the last way down, the vehicle climbs and
    tries again; without room to climb, LAND sets it down. Less than 10 cm over contact it goes on while an
    echo agrees. Longer is worse: it descends by a prediction. Lower it for a pad that changes its course
    often"""
    overdue_s: float = Field(default=1.5, ge=0.3, le=10.0)
    """If there is no contact within this time after the expected one, the vehicle climbs and tries again; if
    a height says that the feet are down, LAND is commanded instead. Raise it for a pad whose height is
    uncertain"""
    escape_lateral_m: float = Field(default=0.18, gt=0.0, le=1.0)
    """Lateral offset in the final descent beyond which it climbs and tries again. Larger is worse: a foot may
    miss the pad. Raise it for a large pad, lower it for a small one"""
    contact_margin_m: float = Field(default=0.02, gt=0.0, le=0.2)
    """Feet nearer to the pad than this count as low; raise it if the height is uncertain"""
    contact_s: float = Field(default=0.15, ge=0.0, le=1.0)
    """A height with a stopped sink, or with the autopilot's word, for this long counts as contact. Shorter
    is worse: a false contact reduces the thrust in the air. Raise it for a springy landing gear"""
    land_after_s: float = Field(default=1.0, ge=0.5, le=30.0)
    """After this time at rest on the pad without thrust the app disarms, by force if refused. It is also how
    long a stopped sink, up to 10 cm too high, takes to count as contact. Longer is worse: a link lost
    meanwhile leaves the motors on. Much shorter is worse too: a bounce may look like rest. Raise it for a
    landing gear that bounces"""

    @property
    def giving_up_s(self) -> float:
        """So long a try may last until it has failed; the final descent may still follow."""
        return 6.0 * self.gentle_wait_s

    @model_validator(mode="after")
    def _goes_on_from_where_it_commits(self) -> TouchdownConfig:
        if self.break_off_lateral_m < self.lateral_m:
            raise ValueError(
                f"break_off_lateral_m {self.break_off_lateral_m:g}: expected no less than lateral_m, "
                f"{self.lateral_m:g}"
            )
        planned_m_s = max(self.contact_speed_m_s, self.firm_contact_m_s)
        if self.fastest_contact_m_s < planned_m_s + _GUST_M_S:
            raise ValueError(
                f"fastest_contact_m_s {self.fastest_contact_m_s:g}: expected {planned_m_s + _GUST_M_S:g} or "
                f"more, {_GUST_M_S:g} above contact_speed_m_s and firm_contact_m_s"
            )
        if self.break_off_above_m <= 2.0 * self.contact_margin_m:
            raise ValueError(
                f"break_off_above_m {self.break_off_above_m:g}: expected more than twice contact_margin_m, "
                f"{self.contact_margin_m:g}; so low the feet may stand"
            )
        return self
