"""The final descent: blindness, signs of contact, standing, and levelling off before the contact."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.base.messages import AutopilotState, LandedState, LinkHealth, PadState
from companion.plan.debounce import Debounce
from companion.plan.events import MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.mission.states import State
from tests.unit.control.controller_inputs import vehicle_state
from tests.unit.plan.landing.touchdown_attempt import (
    CONFIG,
    CYCLE_S,
    coming_down,
    sight,
    sinking,
    standing,
)
from tests.unit.plan.plan_harness import LEG_M

# of the height, to 10 cm
UNSURE = tuple(tuple((0.01, 1e-4)[row // 3] * (row == column) for column in range(6)) for row in range(6))


def test_half_a_second_of_blindness_on_the_final_descent_is_borne_and_two_are_not() -> None:
    touchdown = sinking()
    assert touchdown.cycles([sight(height=0.4, age=1.4)]) == []
    assert touchdown.cycles([sight(height=0.4, age=1.6)]) == [MissionEvent.PAD_LOST]


@pytest.mark.parametrize(
    ("imu_age_s", "high_m", "down"), [(0.0, 0.15, False), (1.0, 0.15, True), (1.0, 0.35, False)]
)
def test_what_nothing_felt_sink_may_be_lower_than_predicted_and_its_feet_down(
    imu_age_s: float, high_m: float, down: bool
) -> None:
    touchdown = sinking()
    touchdown.cycles([sight(height=LEG_M + high_m, age=1.0)] * 13, echo_m=0.1, imu_age_s=imu_age_s)
    assert touchdown.feet_down(touchdown.now_s) is down


@pytest.mark.parametrize(
    ("aside", "height", "climbs"), [(0.19, 0.4, True), (0.17, 0.4, False), (0.19, 0.21, False)]
)
def test_far_aside_on_the_final_descent_it_climbs_while_still_high_only(
    aside: float, height: float, climbs: bool
) -> None:
    assert sinking().cycles([sight(aside, height)]) == [MissionEvent.MISALIGNED] * climbs


SLIDES = sight(aside=0.05, height=0.2, velocity=(1.4, 0.0, 0.0))


@pytest.mark.parametrize(
    ("seen", "half_width_m", "leaves"),
    [
        pytest.param(SLIDES, 0.2, True, id="slides"),
        pytest.param(sight(aside=0.05, height=0.2, velocity=(0.45, 0.0, 0.0)), 0.2, False, id="slow"),
        pytest.param(replace(SLIDES, seen_time_s=-1.4), 0.2, False, id="unseen for a second"),
        pytest.param(replace(SLIDES, velocity_std_m_s=2.0), 0.2, False, id="the filter has just started"),
        # there it breaks off, once that has lasted
        pytest.param(sight(aside=0.05, height=0.4, velocity=(1.4, 0.0, 0.0)), 0.2, False, id="high"),
        # 1.4 m/s are stopped within 0.33 m: beyond the tolerance, but not beyond a large pad's edge
        pytest.param(SLIDES, 0.65, False, id="friction ends it on the pad"),
    ],
)
def test_a_pad_that_stops_beneath_it_is_left_at_once_even_when_the_feet_touch(
    seen: PadState, half_width_m: float, leaves: bool
) -> None:
    found = sinking(half_width_m=half_width_m).step(seen, 1.0, echo_m=0.1)
    assert found == ((MissionEvent.MISALIGNED, "sliding over the pad at 1.4 m/s") if leaves else None)


def test_a_vehicle_that_slides_rises_from_where_it_is_and_level() -> None:
    """The reference has run on below the pad: a climb from there would first press the feet down."""
    touchdown = sinking()
    while touchdown.reference.at(touchdown.now_s).position_m[2] < -0.15:
        assert touchdown.cycles([sight(height=0.2, velocity=(0.0, 0.0, 0.2))]) == []
    now_s = touchdown.now_s
    assert touchdown.step(SLIDES, now_s) is not None
    assert touchdown.reference.at(now_s).position_m == pytest.approx((0.05, 0.0, -0.2))
    assert touchdown.reference.at(now_s + 0.3).velocity_m_s[2] == pytest.approx(-0.3)
    level = touchdown.level_off()
    assert level is not None
    assert level.from_s <= now_s


def test_a_vehicle_that_the_contact_stopped_does_not_slide_until_sightings_show_it() -> None:
    """The last sighting, before the contact, saw the pad at rest beneath it; the IMU felt 1.4 m/s less."""
    stopped = replace(SLIDES, seen_time_s=-0.07, seen_velocity_ned_m_s=(0.02, 0.0, 0.0))
    assert sinking().step(stopped, 1.0, echo_m=0.1) is None
    touchdown = standing()
    assert touchdown.step(stopped, touchdown.now_s + 0.1) is None


def position_covariance(std_m: float) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(std_m**2 if row == column else 0.0 for column in range(6)) for row in range(6))


@pytest.mark.parametrize(("since_s", "leaves"), [(0.1, True), (0.4, False)])
def test_sliding_ends_the_stand_in_its_first_moments_alone(since_s: float, leaves: bool) -> None:
    touchdown = standing()
    touchdown.now_s += since_s - CYCLE_S
    fast = sight(height=0.2, velocity=(1.4, 0.0, 0.0))
    assert touchdown.cycles([fast]) == [MissionEvent.OFF_PAD] * leaves


@pytest.mark.parametrize(
    ("silent_s", "echo_m", "age_s", "imu_age_s", "leaves"),
    [
        (0.5, 0.25, 9.0, 0.0, True),
        (0.3, 0.25, 9.0, 0.0, False),  # the last setpoint that arrived still counts
        (0.0, 0.25, 9.0, 0.0, False),
        (0.5, 0.10, 9.0, 0.0, True),  # an echo does not tell standing from 3 cm over the pad
        (0.5, 0.25, 0.0, 0.0, False),
        # what is not seen counts where it could be
        (0.5, None, 9.0, 0.0, True),
        (0.3, None, 9.0, 0.0, False),
        (0.5, None, 0.0, 0.0, False),
        (0.5, None, 9.0, 0.5, False),
    ],
)
def test_a_silent_autopilot_that_lifts_it_off_the_pad_is_not_pressed_down(
    silent_s: float, echo_m: float | None, age_s: float, imu_age_s: float, leaves: bool
) -> None:
    given = {"echo_m": echo_m, "silent_s": silent_s, "imu_age_s": imu_age_s}
    found = standing().cycles([sight(height=0.19, age=age_s)] * 15, **given)
    assert (found[:1] == [MissionEvent.OFF_PAD]) == leaves


@pytest.mark.parametrize(
    ("silent_s", "risen_m", "std_m", "speed_m_s", "leaves"),
    [
        (0.5, 0.015, 0.001, 0.0, True),
        (0.5, 0.005, 0.001, 0.0, False),
        (0.5, 0.015, 0.003, 0.0, False),  # not for sure
        (0.0, 0.015, 0.001, 0.0, False),  # it obeys: a bounce
        (0.5, 0.0, 0.001, 1.4, True),  # held in place, the pad drives on beneath it
        (0.0, 0.0, 0.001, 1.4, False),
    ],
)
def test_what_the_camera_sees_of_the_feet_counts_while_our_setpoints_may_not_arrive(
    silent_s: float, risen_m: float, std_m: float, speed_m_s: float, leaves: bool
) -> None:
    """Pressed down again from a centimetre or two it falls with 0.5 m/s, before an echo shows it lifted."""
    touchdown = standing()
    stands, later = (
        replace(sight(height=height, velocity=(speed, 0.0, 0.0)), covariance=position_covariance(std_m))
        for height, speed in ((0.19, 0.0), (0.19 + risen_m, speed_m_s))
    )
    found = touchdown.cycles([stands] * 15, echo_m=0.1, imu_age_s=0.0)
    found += touchdown.cycles([later] * 10, echo_m=0.1, imu_age_s=0.0, silent_s=silent_s)
    assert (found[:1] == [MissionEvent.OFF_PAD]) == leaves


@pytest.mark.parametrize(("risen_m", "leaves"), [(0.0, False), (0.03, True)])
def test_a_deck_that_rocks_under_the_feet_lifts_nothing(risen_m: float, leaves: bool) -> None:
    """18 cm beside the middle of a deck that rolls by 8 deg the height over the middle swings by 2.5 cm."""
    touchdown, found = standing(), list[MissionEvent]()
    for k in range(120):
        roll = math.radians(8.0) * math.sin(math.tau * k * CYCLE_S / 4.0)
        over_m, aside_m = 0.19 + (k >= 60) * risen_m, 0.18
        normal, along = (math.sin(roll), math.cos(roll)), (math.cos(roll), -math.sin(roll))
        east, down = (n * over_m - a * aside_m for n, a in zip(normal, along, strict=True))
        seen = replace(
            sight(),
            relative_position_ned_m=(0.0, east, down),
            tilt_rad=(0.0, normal[0]),
            covariance=position_covariance(1e-3),
        )
        found += touchdown.cycles([seen], echo_m=0.1, silent_s=0.5 * (k >= 15), imu_age_s=0.0)
    assert (MissionEvent.OFF_PAD in found) == leaves


@pytest.mark.parametrize(("after_s", "leaves"), [(0.1, True), (1.5, False)])
def test_after_a_silence_the_feet_have_to_be_seen_down_until_rest_is_proven(
    after_s: float, leaves: bool
) -> None:
    touchdown, found = standing(), list[MissionEvent]()
    # it is seen down until the silence ends: the pad drives away while the first setpoints arrive again
    for silent_s, steps, age_s in ((1.0, 10, 0.0), (0.0, round(after_s / CYCLE_S), 0.0), (0.0, 15, 9.0)):
        seen = [sight(height=0.19, age=age_s)] * steps
        found += touchdown.cycles(seen, echo_m=0.1, silent_s=silent_s, imu_age_s=0.0)
    assert (MissionEvent.OFF_PAD in found) == leaves
    assert (MissionEvent.AT_REST in found) != leaves


def test_off_the_pad_it_rises_level_and_ever_again_from_where_a_silent_autopilot_has_it() -> None:
    touchdown, found = standing(), list[MissionEvent]()
    generator = touchdown.reference
    while not found and touchdown.now_s < 5.0:
        moved = sight(height=0.19, age=9.0, velocity=(0.5, 0.0, 0.0))
        found = touchdown.cycles([moved], silent_s=1.0, imu_age_s=0.0)
    assert found == [MissionEvent.OFF_PAD]
    now_s = touchdown.now_s
    assert generator.at(now_s + 0.3).velocity_m_s == pytest.approx((0.0, 0.0, -0.3))
    for silent_s, height_m in ((1.0, 0.21), (1.0, 0.2), (0.0, 0.3)):
        level = touchdown.level_off()
        assert touchdown._sequence.leaving(now_s)
        assert level is not None
        assert level.from_s <= now_s < now_s + 0.3 <= level.until_s
        now_s += CYCLE_S
        before = generator.at(now_s)
        autopilot = AutopilotState(now_s, landed=LandedState.IN_AIR, connected=True)
        inputs = PlanInputs(vehicle_state(now_s), None, autopilot, link=LinkHealth(silent_s))
        touchdown._sequence.leave(inputs, sight(height=height_m, age=9.0), now_s)
        if silent_s > 0.0:
            assert generator.at(now_s).position_m[2] == pytest.approx(-height_m)
        else:
            assert generator.at(now_s) == before
    assert not touchdown._sequence.leaving(now_s + 0.3)


@pytest.mark.parametrize(("silent_s", "landed"), [(0.0, False), (0.5, False), (0.5, True)])
def test_an_echo_proves_no_rest_to_a_silent_link_unless_the_autopilot_has_landed(
    silent_s: float, landed: bool
) -> None:
    """Pressed down by nobody it may float a centimetre over the pad, whatever we command."""
    touchdown = standing()
    given = {
        "echo_m": 0.1, "imu_age_s": 0.0, "landed": LandedState.ON_GROUND if landed else LandedState.IN_AIR
    }  # fmt: skip
    found = touchdown.cycles([sight(height=0.19)] * 5, **given)
    found += touchdown.cycles([sight(height=0.19, age=9.0)] * 55, silent_s=silent_s, **given)
    assert (MissionEvent.OFF_PAD in found) == (silent_s > 0.0 and not landed)
    assert (MissionEvent.AT_REST in found) == (silent_s == 0.0)
    assert (MissionEvent.LANDING_DETECTED in found) == landed


def test_without_its_imu_and_unheard_it_is_not_pressed_down_until_it_is_seen() -> None:
    """All comes by the link: nothing shows that it left the pad, and nothing that it stands."""
    touchdown, unconfirmed = standing(), []
    for age_s, silent_s, imu_age_s in ((9.0, 0.0, 0.0), (9.0, 0.5, 0.5), (9.0, 0.0, 0.5), (0.0, 0.0, 0.0)):
        touchdown.cycles([sight(height=0.19, age=age_s)], silent_s=silent_s, imu_age_s=imu_age_s)
        unconfirmed.append(touchdown.unconfirmed)
    assert unconfirmed == [False, True, True, False]


@pytest.mark.parametrize(
    ("silent_s", "over_m", "stands"), [(0.0, 0.05, True), (0.5, 0.05, False), (0.5, 0.01, True)]
)
def test_what_stops_over_the_pad_unheard_is_held_by_the_autopilot(
    silent_s: float, over_m: float, stands: bool
) -> None:
    """Heard, what does not sink though it is asked to stands on legs longer than the file's."""
    touchdown = sinking()
    for seen in coming_down(LEG_M + over_m):
        if not touchdown.on_pad:  # the echo would show it down
            touchdown.cycles([seen], echo_m=0.1, silent_s=silent_s, imu_age_s=0.0)
    assert touchdown.on_pad == stands


# 0.35 m at the contact's speed with a blend of 0.8 s, then the wait
DUE_S = CONFIG.blend_s + 0.35 / CONFIG.contact_speed_m_s - 0.5 * CONFIG.blend_s
MISSED_S = CONFIG.settled_s + DUE_S + CONFIG.overdue_s


def test_no_contact_long_after_it_was_due_is_a_miss() -> None:
    touchdown, found = sinking(), list[MissionEvent]()
    touchdown.now_s = 0.2
    while not found and touchdown.now_s < 10.0:
        found = touchdown.cycles([sight(height=0.45)])
    assert found == [MissionEvent.MISALIGNED]
    assert touchdown.now_s == pytest.approx(MISSED_S, abs=0.1)


@pytest.mark.parametrize("stands", [True, False])
def test_what_has_not_sunk_for_as_long_as_the_contact_is_overdue_stands_and_is_not_lifted(
    stands: bool,
) -> None:
    """The pad fills the picture, and an echo that is stuck says 5 cm: nothing but the sink tells."""
    touchdown, found = sinking(), list[MissionEvent]()
    touchdown.now_s = 0.2
    sinks = sight(height=LEG_M + 0.05, velocity=(0.0, 0.0, CONFIG.contact_speed_m_s), age=1.0)
    while not found and touchdown.state is State.SINK and touchdown.now_s < 10.0:
        if stands and touchdown.now_s > MISSED_S - CONFIG.overdue_s + 0.1:
            unseen = sight(height=LEG_M + 0.05, age=2.0)
            found = touchdown.cycles([unseen], echo_m=LEG_M - 0.03, imu_age_s=0.0)
        else:
            found = touchdown.cycles([sinks])
    assert found == ([] if stands else [MissionEvent.MISALIGNED])
    assert (touchdown.state is State.SET_DOWN) == stands
    assert touchdown.now_s == pytest.approx(MISSED_S, abs=0.25)


def test_what_hovers_a_hands_breadth_over_a_pad_in_view_is_lifted_off_and_not_landed_in_land() -> None:
    """An updraft holds it 8 cm up, where it bobs by 8 mm: what stands does not."""
    touchdown, found, swing = sinking(), list[MissionEvent](), math.tau * 1.5
    touchdown.now_s = 0.2
    while not found and touchdown.state is State.SINK and touchdown.now_s < 10.0:
        turned = swing * touchdown.now_s
        hovers = 0.085 + 0.008 * math.cos(turned), 0.008 * swing * math.sin(turned)
        over_m, sink_m_s = max(hovers, (0.43 - 0.2 * touchdown.now_s, 0.2))
        found = touchdown.cycles([sight(height=LEG_M + over_m, velocity=(0.0, 0.0, sink_m_s))], imu_age_s=0.0)
    assert found == [MissionEvent.MISALIGNED]


@pytest.mark.parametrize(("age_s", "contact"), [(0.3, True), (1.2, True), (2.0, False)])
def test_where_no_echo_comes_what_was_seen_lately_shows_where_the_feet_may_meet_the_pad(
    age_s: float, contact: bool
) -> None:
    touchdown = sinking()
    for seen in coming_down(LEG_M):
        if not touchdown.on_pad:
            touchdown.cycles([replace(seen, seen_time_s=-age_s)], imu_age_s=0.0)
    assert touchdown.on_pad == contact


def test_a_contact_is_not_overdue_while_the_feet_may_stand() -> None:
    """Legs longer than told touch late: half a second before the miss they bear, a second shows it."""
    touchdown = sinking()
    touchdown.now_s = 0.2
    while not touchdown.on_pad and touchdown.now_s < 10.0:
        sink_m_s = 0.0 if touchdown.now_s + CYCLE_S > MISSED_S - 0.5 else CONFIG.contact_speed_m_s
        found = touchdown.cycles([sight(height=LEG_M + 0.08, velocity=(0.0, 0.0, sink_m_s))])
        assert set(found) <= {MissionEvent.CONTACT}
    assert touchdown.on_pad


def test_contact_is_felt_for_a_moment_whatever_the_heights_say() -> None:
    """Camera and echo say by the same leg height that the feet are down: 8 cm wrong, they are 8 cm up."""
    touchdown = sinking()
    sinks, stands = (sight(height=0.18, velocity=(0.0, 0.0, speed)) for speed in (0.2, 0.0))
    assert touchdown.cycles([sinks] * 30, echo_m=0.1) == []
    assert not touchdown.on_pad
    assert touchdown.cycles([stands] * 15) == [MissionEvent.CONTACT]
    found_s = 1.0 + 30 * CYCLE_S + CONFIG.contact_s
    assert touchdown.contact_s == pytest.approx(found_s, abs=0.08)


# Estimated sinks in the simulator, one a cycle from the first foot's contact on: in 8 m/s of wind the vehicle
# bounced, over a turning pad it came slowly to level.
BOUNCES_M_S = (0.25, 0.18, 0.11, 0.10, -0.12, -0.17, -0.07, -0.01, 0.04, 0.09, -0.01, -0.11, -0.02, 0.05)
LEVELS_M_S = (0.24, 0.18, 0.03, 0.02, 0.04, 0.05, 0.06, 0.07, 0.07, -0.03, -0.05, -0.01, 0.01, 0.03)


@pytest.mark.parametrize("sinks_m_s", [BOUNCES_M_S, LEVELS_M_S])
def test_feet_that_bounce_or_come_down_one_by_one_are_found_in_a_third_of_a_second(
    sinks_m_s: tuple[float, ...],
) -> None:
    touchdown = sinking()
    touchdown.cycles(sight(height=LEG_M, velocity=(0.0, 0.0, sink_m_s)) for sink_m_s in sinks_m_s)
    assert touchdown.on_pad
    assert touchdown.contact_s - 1.0 < 0.34


def test_feet_that_may_stand_are_given_weight_and_a_vehicle_that_sinks_gets_its_thrust_back() -> None:
    touchdown, shares = sinking(), []
    for sink_m_s in (0.2, 0.2, 0.0, 0.0, 0.2, 0.2, 0.2, 0.2, 0.2, *[0.0] * 14):
        touchdown.cycles([sight(height=LEG_M, velocity=(0.0, 0.0, sink_m_s))])
        shares.append(touchdown.unloading)
    assert shares[1] == shares[8] == 0.0
    assert 0.0 < shares[2] < shares[3] < 1.0
    assert shares[4] > shares[5] > shares[6]
    assert touchdown.on_pad


def test_legs_longer_than_told_are_found_by_what_they_bear_though_the_heights_flicker() -> None:
    """Feet down at 3 cm more than the file says: an echo now and then says that they are."""
    touchdown = sinking()
    for k, seen in enumerate(coming_down(LEG_M + 0.03)):
        echo_m = 0.115 - LEG_M - 0.03 + seen.height_m + (0.0 if k % 3 == 0 else 0.01)
        touchdown.cycles([replace(seen, covariance=UNSURE)], echo_m=echo_m)
    assert touchdown.on_pad
    assert touchdown.contact_s - 1.0 < 0.5


@pytest.mark.parametrize("over_m", [0.08, 0.15])
def test_held_up_over_the_pad_no_more_is_unloaded_than_makes_a_gentle_fall_and_high_up_nothing(
    over_m: float,
) -> None:
    touchdown, shares = sinking(), []
    for seen in coming_down(LEG_M + over_m):
        touchdown.cycles([seen])
        shares.append(touchdown.unloading)
    falls_m = over_m - 0.03 / math.sqrt(2.0)  # the leg height is told and measured to 3 cm
    gentle = CONFIG.fastest_contact_m_s**2 / (2.0 * GRAVITY_M_S2 * falls_m)
    assert max(shares) == pytest.approx(gentle if over_m < 0.1 else 0.0)


@pytest.mark.parametrize(("over_m", "stands"), [(0.08, True), (0.2, False)])
def test_what_sinks_no_more_stands_though_the_leg_height_is_too_low_in_its_file(
    over_m: float, stands: bool
) -> None:
    touchdown = sinking()
    touchdown.cycles(coming_down(LEG_M + over_m))
    assert touchdown.on_pad is stands
    assert not stands or touchdown.contact_s < 1.8


def test_where_the_heights_say_contact_and_nothing_is_felt_it_ends_in_land() -> None:
    touchdown, found = sinking(), list[MissionEvent]()
    while not found and touchdown.state is not State.SET_DOWN and touchdown.now_s < 11.0:
        found = touchdown.cycles([sight(height=LEG_M, velocity=(0.0, 0.0, 0.1))], echo_m=0.1)
    assert (touchdown.state, found) == (State.SET_DOWN, [])


def test_standing_ends_only_when_the_pad_is_seen_well_below() -> None:
    touchdown = standing()
    touchdown.now_s = 2.0
    assert touchdown.cycles([sight(height=0.40)] * 30) == []
    touchdown.now_s = 4.0
    assert touchdown.cycles([sight(height=0.5)] * 15)[:1] == [MissionEvent.OFF_PAD]


def test_a_debounce_counts_from_the_last_break() -> None:
    held = Debounce()
    assert held.held_s("down", True, 1.0) == 0.0
    assert held.held_s("down", True, 1.5) == 0.5
    assert held.held_s("still", True, 1.5) == 0.0
    assert held.held_s("down", False, 1.6) < 0.0
    assert held.held_s("down", True, 2.0) == 0.0
    assert held.held_s("still", True, 2.0) == 0.5
    held.end("still")
    assert held.held_s("down", True, 3.0) == 1.0
    assert held.held_s("still", True, 3.0) == 0.0


def test_on_the_final_descent_the_reference_gives_way_to_the_vehicles_height_but_not_its_speed() -> None:
    at_half_a_second = []
    for lags_m in (0.0, 0.05):  # so much above the reference, at its speed
        touchdown = sinking()
        touchdown.now_s = 1.2 - CYCLE_S
        for _ in range(15):
            reference_m = -touchdown.reference.at(touchdown.now_s + CYCLE_S).position_m[2]
            touchdown.cycles([sight(height=reference_m + lags_m, velocity=(0.0, 0.0, 0.2))])
        at_half_a_second.append(touchdown.reference.at(1.7))
    lower, higher = at_half_a_second
    # 0.05 m with a time constant of 0.3 s, over half a second
    assert lower.position_m[2] - higher.position_m[2] == pytest.approx(0.05 * 0.5 / 0.3, rel=0.2)
    assert higher.velocity_m_s == lower.velocity_m_s


def test_next_to_the_pad_the_reference_goes_on_so_that_standing_shows() -> None:
    touchdown = sinking()
    touchdown.cycles([sight(height=LEG_M + 0.03, velocity=(0.0, 0.0, 0.07))] * 60)
    assert touchdown.reference.at(3.0).position_m[2] > -LEG_M + 0.05


@pytest.mark.parametrize(
    ("keeps_s", "silent_s", "counts"), [(0.5, 0.45, True), (1.0, 0.7, False), (3.0, 2.5, True)]
)
def test_how_long_a_silence_is_one_the_vehicles_own_time_out_says(
    keeps_s: float, silent_s: float, counts: bool
) -> None:
    assert LinkHealth(silent_s, keeps_s).silent is counts
