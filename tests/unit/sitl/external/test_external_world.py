"""The pad on the flat ground of somebody else's simulator, and the score of recorded flights over it."""

import math
from typing import Any

import pytest

from companion.base.geometry import ZERO3, Vector3
from companion.base.messages import Outcome, Phase
from companion.config import ConfigError
from sitl.external.world import ExternalWorld
from sitl.scenario.scenario import Scenario, load_scenario
from tests.unit.sitl.external.external_vehicle import GROUND, Flight, hop, sample

STEP_S = 0.02
START_S = 1000.0
STANDING_M = 0.18


def scenario(motion: dict[str, Any]) -> Scenario:
    return Scenario.model_validate(
        {"name": "t", "description": "t", "pad": {"heading": 0.0, "motion": motion}}
    )


def static(spread_m: float = 0.0) -> Scenario:
    return scenario({"kind": "static", "meet": {"point_ned_m": [4.0, 3.0], "spread_m": spread_m}})


def line(speed_m_s: float) -> Scenario:
    meet = {"point_ned_m": [4.0, 3.0], "time_s": 10.0, "spread_m": 0.0}
    return scenario({"kind": "line", "speed_m_s": speed_m_s, "course_deg": 90.0, "meet": meet})


def play(
    world: ExternalWorld, flight: Flight, seconds: float, *, disarm_s: float = math.inf
) -> ExternalWorld:
    """Stand for a second, fly armed, and tell the world at 50 Hz."""
    world.begin(GROUND)
    for k in range(50):
        world.see(sample(START_S - 1.0 + k * STEP_S, (0.0, 0.0, 0.0)), armed=False)
    for k in range(round(seconds / STEP_S)):
        position, velocity = flight(k * STEP_S)
        world.see(sample(START_S + k * STEP_S, position, velocity), armed=k * STEP_S < disarm_s)
    return world


def test_a_landing_on_the_pad_is_scored() -> None:
    flight, contact_s = hop(4.05, 3.0)
    world = play(ExternalWorld(static(), 0), flight, contact_s + 2.0, disarm_s=contact_s + 1.0)
    touchdown = world.watch.touchdown
    assert touchdown is not None
    assert touchdown.on_pad
    assert touchdown.time_s == pytest.approx(START_S + contact_s, abs=0.1)
    assert touchdown.lateral_error_m == pytest.approx(0.05, abs=0.005)
    # of the last message in the air: those of the ground say that it stands
    assert touchdown.vertical_speed_m_s == pytest.approx(0.3, abs=1e-3)
    assert touchdown.horizontal_speed_m_s == pytest.approx(0.0, abs=1e-6)
    verdict = world.judge(Phase.LANDED)
    assert (verdict.outcome, verdict.failures) == (Outcome.LANDED, ())
    assert world.at_rest_on_pad
    assert world.pad_at(START_S + contact_s + 0.9).velocity_ned_m_s == (0.0, 0.0, 0.0)


def test_beside_the_pad_is_missed_and_armed_is_no_landing() -> None:
    flight, contact_s = hop(4.0, 0.5)
    beside = play(ExternalWorld(static(), 0), flight, contact_s + 2.0, disarm_s=contact_s + 1.0)
    assert beside.judge(Phase.LANDED).outcome is Outcome.MISSED
    flight, contact_s = hop(4.0, 3.0)
    armed = play(ExternalWorld(static(), 0), flight, contact_s + 2.0)
    assert armed.judge(Phase.LANDED).failures == ("not disarmed",)


def test_a_hard_landing_is_a_crash_and_no_flight_is_a_timeout() -> None:
    flight, contact_s = hop(4.0, 3.0, sink_m_s=3.0)
    world = play(ExternalWorld(static(), 0), flight, contact_s + 2.0)
    assert world.judge(Phase.LANDED).outcome is Outcome.CRASHED
    stood = play(ExternalWorld(static(), 0), lambda _: (ZERO3, ZERO3), 3.0)
    assert stood.watch.touchdown is None
    assert stood.judge(Phase.SEARCH).outcome is Outcome.TIMEOUT


def test_a_touch_before_the_landing_counts_and_not_that_of_the_flight_before() -> None:
    """Up, down beside the pad, up at once and on to the pad; then disarmed, and a clean second flight."""
    beside, at_s = hop(4.0, 0.5)
    onto, contact_s = hop(4.0, 3.0)

    def twice(time_s: float) -> tuple[Vector3, Vector3]:
        return beside(time_s) if time_s < at_s + 0.5 else onto(time_s - at_s - 0.5)

    end_s = at_s + 0.5 + contact_s + 1.0
    world = play(ExternalWorld(static(), 0), twice, end_s + 1.0, disarm_s=end_s)
    verdict = world.judge(Phase.LANDED)
    assert verdict.outcome is Outcome.MISSED
    assert [(contact.surface, bool(contact.violations)) for contact in verdict.contacts] == [
        ("ground", True),
        ("pad", False),
    ]
    for k in range(round((contact_s + 2.0) / STEP_S)):
        position, velocity = onto(k * STEP_S)
        armed = k * STEP_S < contact_s + 1.0
        world.see(sample(START_S + end_s + 1.0 + k * STEP_S, position, velocity), armed=armed)
    assert len(world.judge(Phase.LANDED).contacts) == 1
    assert world.judge(Phase.LANDED).outcome is Outcome.LANDED


def test_the_pad_lies_on_the_ground_whatever_height_the_scenario_gives_it() -> None:
    world = ExternalWorld(load_scenario("line"), 0)
    assert world.pad_at(START_S).position_ned_m[2] == 0.0
    play(world, lambda _: (ZERO3, ZERO3), 1.0)
    # the vehicle's reference point stands over its feet
    assert world.truth_at(START_S).vehicle_position_ned_m == pytest.approx((0.0, 0.0, -STANDING_M), abs=1e-6)


def test_a_pad_that_heaves_or_lies_at_sea_is_refused_in_one_line() -> None:
    settings = static().model_dump(by_alias=True)
    settings["pad"] |= {"deck": {}, "surface_height_m": 2.0}
    for wrong, words in (
        (load_scenario("heave"), r"'heave': its pad leaves the ground.*expected one that stays level"),
        (Scenario.model_validate(settings), r"^scenario 't': pad.deck: expected none, since the ground.*$"),
    ):
        with pytest.raises(ConfigError, match=words):
            ExternalWorld(wrong, 0)


@pytest.mark.parametrize("name", ["static", "line", "circle", "figure_8"])
def test_the_shipped_ones_that_stay_on_the_ground_suit(name: str) -> None:
    assert ExternalWorld(load_scenario(name), 0).pad_at(0.0).position_ned_m[2] == 0.0


def test_the_pad_sets_off_when_the_vehicle_is_armed() -> None:
    world = ExternalWorld(line(1.0), 0)
    world.begin(GROUND)
    still = world.pad_at(START_S - 1.0)
    assert still.velocity_ned_m_s == (0.0, 0.0, 0.0)
    play(world, lambda _: (ZERO3, ZERO3), 10.0)
    assert world.pad_at(START_S - 0.5).position_ned_m == still.position_ned_m
    met = world.pad_at(START_S + 10.0)
    assert met.position_ned_m == pytest.approx((4.0, 3.0, 0.0), abs=1e-6)
    assert met.velocity_ned_m_s == pytest.approx((0.0, 1.0, 0.0), abs=1e-6)


def test_armed_and_disarmed_on_the_ground_it_is_back_at_its_start_and_sets_off_anew() -> None:
    world, place = ExternalWorld(line(1.0), 0), (0.0, 0.0, 0.0)
    world.begin(GROUND)
    start = world.pad_at(START_S - 100.0)
    for k in range(4000):
        world.see(sample(START_S - 80.0 + k * STEP_S, place), armed=k < 250)
    assert world.pad_at(START_S - 0.1) == start
    for k in range(round(10.0 / STEP_S) + 1):
        world.see(sample(START_S + k * STEP_S, place), armed=True)
    assert world.pad_at(START_S + 10.0).position_ned_m == pytest.approx((4.0, 3.0, 0.0), abs=1e-6)


def test_disarmed_after_a_flight_it_goes_on() -> None:
    flight, contact_s = hop(0.0, -30.0)
    world = play(ExternalWorld(line(1.0), 0), flight, contact_s + 3.0, disarm_s=contact_s + 1.0)
    assert world.flown
    there = world.pad_at(START_S + contact_s + 2.9)
    assert there.position_ned_m[1] == pytest.approx(3.0 + contact_s + 2.9 - 10.0, abs=1e-6)


def test_begun_anew_nothing_of_the_last_ground_is_left() -> None:
    """The truth comes: 1.2 m under the estimates' ground, where nothing has been touched yet."""
    world = ExternalWorld(line(1.0), 0)
    play(world, lambda _: ((0.5, 0.0, 0.0), (0.0, 0.0, 0.0)), 1.0)
    world.begin(sample(0.0, (0.3, -0.4, 1.2)).place)
    world.see(sample(START_S + 1.0, (0.3, -0.4, 1.2)), armed=False)
    assert world.truth_at(START_S + 1.0).vehicle_position_ned_m == pytest.approx(
        (0.0, 0.0, -STANDING_M), abs=1e-6
    )
    assert world.pad_at(START_S + 9.0).velocity_ned_m_s == (0.0, 0.0, 0.0)
    world.see(sample(START_S + 1.02, (0.3, -0.4, 0.1)), armed=True)
    assert not world.truth_at(START_S + 1.02).in_contact


def test_estimates_that_rose_by_themselves_are_no_flight_and_the_truth_beneath_no_touchdown() -> None:
    world = ExternalWorld(static(), 0)
    play(world, lambda time_s: ((0.0, 0.0, -1.5 * time_s), (0.0, 0.0, -1.5)), 1.0, disarm_s=0.0)
    assert not world.flown
    world.begin(GROUND)
    world.see(sample(START_S + 1.0, (0.0, 0.0, 0.0)), armed=False)
    assert world.watch.touchdown is None


def test_the_touchdown_is_measured_against_the_pad_of_the_same_moment() -> None:
    """At 2 m/s and 20 Hz one message is 10 cm of way."""
    speed_m_s, gap_s, sink_m_s = 2.0, 0.05, 0.4
    world = ExternalWorld(line(speed_m_s), 0)
    world.begin(GROUND)
    for k in range(400):
        time_s = gap_s * k
        height_m = max(0.0, 3.0 - sink_m_s * time_s)
        pad = world.pad_at(time_s).position_ned_m
        moves = (0.0, speed_m_s, sink_m_s) if height_m else (0.0, 0.0, 0.0)
        world.see(sample(time_s, (pad[0], pad[1], -height_m), moves), armed=True)
        if world.watch.touchdown is not None:
            break
    assert world.watch.touchdown is not None
    assert world.watch.touchdown.on_pad
    assert world.watch.touchdown.lateral_error_m < 1e-3


def test_a_moving_pad_waits_under_a_vehicle_that_stands_on_it_and_goes_on_after_it() -> None:
    """The vehicle's own simulator does not carry it along."""
    top_m, sink_m_s = 3.0, 0.5
    down_s = top_m / sink_m_s
    world = ExternalWorld(line(0.4), 0)
    contact_s = 10.0  # when the pad is at (4, 3)

    def flight(time_s: float) -> tuple[Vector3, Vector3]:
        east = 3.0 + 0.4 * (min(time_s, contact_s) - contact_s)
        height = max(0.0, sink_m_s * (contact_s - time_s))
        if time_s < contact_s - down_s:
            return (4.0, east, -top_m), (0.0, 0.4, 0.0)
        moving = time_s < contact_s
        if time_s > 12.0:
            return (4.0, 3.0, -(time_s - 12.0)), (0.0, 0.0, -1.0)
        return (4.0, east, -height), (0.0, 0.4 if moving else 0.0, sink_m_s if moving else 0.0)

    play(world, flight, 14.0)
    touchdown = world.watch.touchdown
    assert touchdown is not None
    assert touchdown.horizontal_speed_m_s == pytest.approx(0.0, abs=1e-3)
    assert touchdown.pad_speed_m_s == pytest.approx(0.4, abs=1e-6)
    assert touchdown.lateral_error_m < 0.01
    # it stood from contact to 12 s, and has gone on since
    gone = world.pad_at(START_S + 13.9).position_ned_m[1] - 3.0
    assert gone == pytest.approx(0.4 * 1.9, abs=0.03)


def test_the_same_seed_gives_the_bundled_simulators_pad() -> None:
    from sitl.world.world import World

    shipped = load_scenario("static")
    bundled, external = World(shipped, 3).pad_state, ExternalWorld(shipped, 3).pad_at(0.0)
    assert external.position_ned_m[:2] == bundled.position_ned_m[:2]
    assert external.heading_rad == bundled.heading_rad


def test_the_ultrasonic_hears_the_ground_under_a_level_vehicle() -> None:
    world = ExternalWorld(static(), 0)
    assert world.range_m((0.0, 0.0, 0.05), 0.26) is None
    world.begin(GROUND)
    world.see(sample(START_S, (0.0, 0.0, -2.0)), armed=True)
    assert world.range_m((0.0, 0.0, 0.05), 0.26) == pytest.approx(2.0 + STANDING_M - 0.05, abs=1e-6)
    rolled = sample(START_S + 0.02, (0.0, 0.0, -2.0))._replace(
        attitude=(math.cos(0.2), math.sin(0.2), 0.0, 0.0)
    )
    world.see(rolled, armed=True)
    assert world.range_m((0.0, 0.0, 0.05), 0.26) is None


def test_the_ultrasonic_hears_the_pad_that_sank_into_the_ground_with_the_vehicle() -> None:
    flight, contact_s = hop(4.0, 3.0)
    world = play(ExternalWorld(static(), 0), flight, contact_s + 0.1)
    standing = world.range_m((0.0, 0.0, 0.05), 0.26)
    assert standing == pytest.approx(STANDING_M - 0.05, abs=0.005)
    newest = world.track.newest
    assert newest is not None
    for k in range(1, 26):
        below = sample(newest.time_s + k * STEP_S, (4.0, 3.0, 0.2 * k * STEP_S), (0.0, 0.0, 0.2))
        world.see(below, armed=True)
    assert world.pad_at(newest.time_s + 0.5).position_ned_m[2] == pytest.approx(0.1, abs=0.01)
    assert world.range_m((0.0, 0.0, 0.05), 0.26) == pytest.approx(standing, abs=0.005)
