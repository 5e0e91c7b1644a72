"""Fence, ceiling and the fastest pad: reached with room to stop, whatever is followed."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import Vector3, add, geodetic_from_ned, quat_from_euler
from companion.base.messages import (
    Action,
    ActionKind,
    ActionResult,
    AutopilotState,
    LinkHealth,
    PadState,
    Phase,
    Quantity,
    VehicleState,
)
from companion.base.motion import Motion
from companion.base.second_sources import ROWS, SIGMA_THRESHOLD, Reaction, SourceRow
from companion.config import GuidanceConfig, MissionConfig, PhaseTimesConfig, PlanConfig
from companion.plan.events import MissionEvent
from companion.plan.inputs import ComputerLoad, PlanInputs
from companion.plan.mission.bounds import Bounds, stopping_m
from companion.plan.mission.failsafe_monitor import FailsafeMonitor
from companion.plan.mission.requests import Requests
from companion.plan.mission.states import Authority, Circumstances, State
from companion.plan.mission.table import BY_THE_PAD, FINAL, IN_AIR, StateMachine, follows
from companion.plan.trajectory.avoidance import Avoidance
from companion.plan.trajectory.coordinate_frames import along_arc
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.plan.compared import STD, differ
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import line, still
from tests.unit.plan.plan_autopilot import HOME
from tests.unit.plan.plan_harness import ORIGIN, ORIGIN_NED_M, PlanWorld

CONFIG = PlanConfig(mission=MissionConfig(total_timeout_s=100.0, phases=PhaseTimesConfig(approach_s=30.0)))
FLYING = AutopilotState(0.0, connected=True, autopilot_kind="px4", armed=True, mode="OFFBOARD", offboard=True)
HELD = replace(FLYING, mode="LOITER", offboard=False)


def inputs(autopilot: AutopilotState = FLYING, stop: bool = False, vehicle: bool = True) -> PlanInputs:
    w = PlanWorld(still())
    w.now_s = 50.0
    known = w.inputs().vehicle if vehicle else None
    return PlanInputs(vehicle=known, pad=None, autopilot=autopilot, stop_requested=stop)


def monitor(
    state: State = State.APPROACH, authority: Authority = Authority.OURS, requests: Requests | None = None
) -> tuple[FailsafeMonitor, StateMachine]:
    machine = StateMachine(retries=3)
    machine.state, machine.authority = state, authority
    return FailsafeMonitor(CONFIG, machine, requests or Requests(2.0, 5.0, 3)), machine


def gravest(
    given: PlanInputs, state: State = State.APPROACH, authority: Authority = Authority.OURS
) -> MissionEvent | None:
    """The first event that means something in a state; control is not granted anew."""
    watch, machine = monitor(state, authority)
    events = [event for event, _ in watch.detect(given, 50.0)]
    circumstances = Circumstances(machine.authority)
    return next((e for e in events if follows(state, e, circumstances) is not None), None)


@pytest.mark.parametrize(
    ("turned_deg", "flown"), [(None, True), (10.0, True), (15.0, False), (34.0, False), (179.0, False)]
)
def test_a_camera_that_is_turned_is_named_before_the_pad_that_seems_too_fast(
    turned_deg: float | None, flown: bool
) -> None:
    watch, machine = monitor()
    zero = (0.0, 0.0, 0.0)
    fast = PadState(50.0, zero, zero, (6.2, 0.0, 0.0), zero, 0.0, 0.0, 0.1, 0.1, seen_time_s=50.0)
    shown = () if turned_deg is None else (differ(Quantity.CAMERA_ROTATION, turned_deg),)
    given = replace(inputs(), pad=fast, comparisons=shown)
    watch.detect(given, 49.0)
    found = watch.detect(given, 50.0)
    meant = [e for e, _ in found if follows(machine.state, e, Circumstances(machine.authority)) is not None]
    assert meant[0] is (MissionEvent.PAD_TOO_FAST if flown else MissionEvent.PAD_DISPUTED)
    if not flown:
        assert f": {turned_deg:.1f} ±0.5 deg apart" in dict(found)[MissionEvent.PAD_DISPUTED]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.quantity.value)
def test_what_two_sources_say_is_flown_with_up_to_its_bound(row: SourceRow) -> None:
    # GIVEN a difference just within, and one just beyond what is surely more than the bound
    events: dict[Reaction | None, MissionEvent] = {
        Reaction.HAND_BACK: MissionEvent.ESTIMATE_DISPUTED,
        Reaction.HAND_BACK_AWAY: MissionEvent.VELOCITY_UNCERTAIN,
        Reaction.LEAVE_PAD: MissionEvent.PAD_DISPUTED,
    }
    meant, away = events.get(row.reaction), row.reaction is Reaction.HAND_BACK_AWAY
    surely = SIGMA_THRESHOLD * STD
    for more, flown in ((-0.01, True), (0.01, row.bound is None or meant is None)):
        shown = differ(row.quantity, (row.bound or 1e6) + surely + more)
        # THEN the gravest event is that its sources differ, with both figures, or nothing
        given = replace(inputs(), comparisons=(shown,))
        assert gravest(given, State.SEARCH if away else State.APPROACH) is (None if flown else meant)
        assert not away or all(gravest(given, state) is None for state in BY_THE_PAD)
        if meant is not None and not flown:
            found = dict(monitor()[0].detect(given, 50.0))
            assert shown.first in found[meant]
            assert shown.second in found[meant]


def taken_over(watch: FailsafeMonitor, autopilot: AutopilotState) -> bool:
    return MissionEvent.TAKEN_OVER in dict(watch.detect(inputs(autopilot), 50.0))


@pytest.mark.parametrize("shortage", ["", "too little thrust: it drifts (wind 5.8 m/s2)"])
def test_an_end_by_time_names_the_wind_that_led_to_it(shortage: str) -> None:
    watch, _ = monitor(State.SEARCH)
    watch.phase_begins(0.0)
    words = dict(watch.detect(replace(inputs(), shortage=shortage), 100.0))
    assert words[MissionEvent.TIMEOUT] == "60 s in search" + (f"; {shortage}" if shortage else "")


@pytest.mark.parametrize(
    ("ours_deg", "theirs_deg", "falls_m_s2", "jolts_m_s2", "speed_m_s", "for_s", "lies"),
    [
        (92.0, 88.0, 0.2, 0.2, 0.0, 1.1, True),
        (92.0, 88.0, 0.2, 6.0, 4.0, 1.1, True),  # its motors drag it over the ground
        (92.0, 88.0, 0.2, 0.2, 0.0, 0.9, False),  # thrown over, it may come back
        (92.0, 4.0, 0.2, 0.2, 0.0, 3.0, False),  # one of them is wrong, and a comparison says so
        (92.0, None, 0.2, 0.2, 0.0, 3.0, False),
        (92.0, 88.0, 6.0, 6.0, 0.0, 3.0, False),  # in the air
        (62.0, 62.0, 0.2, 0.2, 17.0, 3.0, False),  # in the air, fast
        (50.0, 50.0, 0.2, 0.2, 0.0, 3.0, False),
    ],
)
def test_a_vehicle_lies_on_its_side_by_both_attitudes_and_at_rest(
    ours_deg: float,
    theirs_deg: float | None,
    falls_m_s2: float,
    jolts_m_s2: float,
    speed_m_s: float,
    for_s: float,
    lies: bool,
) -> None:
    watch, _ = monitor(State.APPROACH)
    theirs = None if theirs_deg is None else quat_from_euler(math.radians(theirs_deg), 0.0, 0.0)
    given = inputs(replace(FLYING, attitude=theirs))
    assert given.vehicle is not None
    ours = quat_from_euler(math.radians(ours_deg), 0.0, 0.0)
    vehicle = replace(given.vehicle, attitude=ours, velocity_ned_m_s=(speed_m_s, 0.0, 0.0))
    events = list[MissionEvent]()
    for k in range(round(for_s / 0.1) + 1):
        now_s = 50.0 + 0.1 * k
        heard = replace(given.autopilot, attitude_time_s=now_s)
        felt_m_s2 = jolts_m_s2 if k % 4 == 0 else falls_m_s2
        fresh = replace(vehicle, time_s=now_s, acceleration_ned_m_s2=(0.0, 0.0, felt_m_s2))
        found = watch.detect(replace(given, vehicle=fresh, autopilot=heard), now_s)
        events = [event for event, _ in found]
    assert (MissionEvent.TIPPED_OVER in events) is lies
    assert not lies or events[0] is MissionEvent.TIPPED_OVER


def test_all_is_well_is_nothing() -> None:
    assert gravest(inputs()) is None


def test_control_is_granted_once_the_autopilot_obeys() -> None:
    requests = Requests(2.0, 5.0, 3)
    watch, _ = monitor(State.SEARCH, Authority.NONE, requests)
    for granted, autopilot, found in ((False, FLYING, False), (True, HELD, False), (True, FLYING, True)):
        if granted:
            requests.ask(Action(ActionKind.TAKE_CONTROL), 50.0)
            requests.due(50.0)
            requests.hear((ActionResult(50.0, ActionKind.TAKE_CONTROL, True),), 50.0)
        assert (MissionEvent.CONTROL_GRANTED in dict(watch.detect(inputs(autopilot), 50.0))) is found


def test_with_control_ours_any_other_mode_is_somebody_elses_even_one_that_is_nobodys() -> None:
    watch, _ = monitor()
    assert not taken_over(watch, FLYING)
    assert taken_over(watch, HELD)


def test_returned_to_the_autopilot_the_change_of_mode_that_was_asked_for_is_ours() -> None:
    requests = Requests(2.0, 5.0, 3)
    watch, machine = monitor(requests=requests)
    assert not taken_over(watch, FLYING)
    machine.authority = Authority.RELEASED
    requests.ask(Action(ActionKind.HOLD), 50.0)
    assert not taken_over(watch, HELD)
    assert taken_over(watch, replace(HELD, mode="AUTO.LAND"))
    requests.forget()
    requests.ask(Action(ActionKind.LAND), 50.0)
    assert taken_over(watch, HELD)


def test_what_was_heard_of_the_mode_before_the_link_was_lost_is_old() -> None:
    watch, _ = monitor()
    assert not taken_over(watch, replace(HELD, connected=False))


@pytest.mark.parametrize("state", sorted(IN_AIR))
def test_motors_that_the_pilot_cut_are_the_pilots_in_every_state(state: State) -> None:
    cut = inputs(replace(FLYING, motors_cut=True))
    assert gravest(cut, state) is MissionEvent.TAKEN_OVER


@pytest.mark.parametrize(("share", "critical"), [(None, False), (0.13, False), (0.12, True), (0.0, True)])
def test_a_battery_is_critical_on_both_sides_of_its_bound(share: float | None, critical: bool) -> None:
    found = gravest(inputs(replace(FLYING, battery_share=share)))
    assert (found is MissionEvent.BATTERY_CRITICAL) is critical


@pytest.mark.parametrize(("share", "low"), [(None, False), (0.26, False), (0.25, True), (0.1, True)])
def test_a_battery_is_low_on_both_sides_of_its_bound(share: float | None, low: bool) -> None:
    watch, _ = monitor()
    found = dict(watch.detect(inputs(replace(FLYING, battery_share=share)), 50.0))
    assert (MissionEvent.BATTERY_LOW in found) is low


@pytest.mark.parametrize("woke", [False, True])
def test_a_machine_that_was_suspended_ends_the_flight(woke: bool) -> None:
    given = replace(inputs(), computer=ComputerLoad(woke=woke))
    assert gravest(given) is (MissionEvent.SUSPENDED if woke else None)
    assert gravest(given, State.DESCEND) is None  # the estimate, lost with it, ends that


@pytest.mark.parametrize(
    ("round_trip_s", "age_s", "late"),
    [(None, 0.0, False), (0.3, 0.0, False), (0.31, 0.0, True), (0.31, 3.0, True), (0.31, 3.1, False)],
)
def test_a_link_is_late_beyond_its_bound_while_that_is_fresh(
    round_trip_s: float | None, age_s: float, late: bool
) -> None:
    slow = replace(FLYING, round_trip_s=round_trip_s, round_trip_time_s=50.0 - age_s)
    assert (gravest(inputs(slow)) is MissionEvent.LINK_LATE) is late
    assert gravest(inputs(slow), State.SINK) is None
    assert gravest(inputs(replace(slow, connected=False))) is MissionEvent.LINK_LOST


def test_a_link_is_lost_where_the_autopilot_does_not_hear_us() -> None:
    deaf = replace(inputs(FLYING), link=LinkHealth(3.2, lost_after_s=3.0))
    assert gravest(deaf) is MissionEvent.LINK_LOST
    assert gravest(deaf, State.AWAIT_LINK) is None  # no heartbeat of its ends the wait
    assert gravest(replace(deaf, link=LinkHealth()), State.AWAIT_LINK) is MissionEvent.LINK_UP
    assert gravest(deaf, State.SINK) is None


@pytest.mark.parametrize(
    ("given", "state", "event"),
    [
        (inputs(replace(FLYING, armed=False)), State.APPROACH, MissionEvent.DISARMED),
        (inputs(HELD), State.APPROACH, MissionEvent.TAKEN_OVER),
        (inputs(stop=True), State.APPROACH, MissionEvent.STOP),
        (inputs(replace(FLYING, connected=False)), State.APPROACH, MissionEvent.LINK_LOST),
        (inputs(vehicle=False), State.APPROACH, MissionEvent.ESTIMATE_LOST),
        (inputs(replace(FLYING, connected=False)), State.STAND, None),
        (inputs(vehicle=False), State.STAND, None),
        # a pilot is asked before the one at the keyboard, and a lost link knows no mode
        (inputs(HELD, stop=True), State.APPROACH, MissionEvent.TAKEN_OVER),
        (inputs(replace(HELD, connected=False)), State.APPROACH, MissionEvent.LINK_LOST),
        # in the final descent a stop waits, and what else is wrong does not
        (inputs(stop=True), State.WAIT, MissionEvent.STOP),
        (inputs(stop=True), State.SINK, None),
        (inputs(replace(FLYING, connected=False)), State.SINK, None),
        (inputs(vehicle=False, stop=True), State.SINK, MissionEvent.ESTIMATE_LOST),
        # before take-off being disarmed is no event
        (inputs(replace(FLYING, armed=False)), State.ARM, None),
    ],
)
def test_the_gravest_event_that_means_something_counts(
    given: PlanInputs, state: State, event: MissionEvent | None
) -> None:
    authority = Authority.NONE if state is State.ARM else Authority.OURS
    assert gravest(given, state, authority) is event


@pytest.mark.parametrize("authority", [Authority.OURS, Authority.RELEASED])
def test_a_pilot_is_heeded_on_the_pad_too_and_our_own_land_is_not_a_pilot(authority: Authority) -> None:
    watch, _ = monitor(State.AUTO_LAND, authority)
    assert not taken_over(watch, replace(FLYING, mode="AUTO.LAND", offboard=False))
    assert not taken_over(watch, FLYING)
    assert taken_over(watch, replace(FLYING, mode="POSCTL", offboard=False))


def test_a_velocity_that_nobody_knows_ends_a_search_but_not_a_descent() -> None:
    given = inputs()
    assert given.vehicle is not None
    lost = replace(given, vehicle=replace(given.vehicle, velocity_std_m_s=2.0))
    assert gravest(lost, State.SEARCH) is MissionEvent.VELOCITY_UNCERTAIN
    assert gravest(lost, State.DESCEND) is None


@pytest.mark.parametrize("state", sorted(FINAL))
def test_a_mission_that_has_ended_detects_nothing_more(state: State) -> None:
    watch, _ = monitor(state)
    assert watch.detect(inputs(HELD, stop=True), 50.0) == ()


def test_time_on_both_sides_of_its_bounds() -> None:
    watch, machine = monitor(State.ARM, Authority.NONE)
    w = PlanWorld(still())

    def at(now_s: float) -> list[MissionEvent]:
        w.now_s = now_s
        given = replace(inputs(), vehicle=w.inputs().vehicle)
        late = {MissionEvent.TIMEOUT, MissionEvent.OVERTIME}
        return [event for event, _ in watch.detect(given, now_s) if event in late]

    # waiting on the ground is not flying: the mission's time counts from take-off
    watch.phase_begins(2.0)
    machine.state = State.TAKE_OFF
    watch.phase_begins(10.0)
    machine.state = State.APPROACH
    watch.phase_begins(20.0)
    assert at(49.9) == []
    assert at(50.1) == [MissionEvent.TIMEOUT]
    watch.phase_begins(109.0)
    assert at(109.9) == []
    assert at(110.1) == [MissionEvent.OVERTIME]


def test_an_estimate_that_is_old_counts_as_lost() -> None:
    given = inputs()
    assert given.vehicle is not None
    old = replace(given, vehicle=replace(given.vehicle, time_s=49.4))
    assert gravest(old) is MissionEvent.ESTIMATE_LOST
    without_imu = replace(given, vehicle=replace(given.vehicle, imu_age_s=0.6))
    assert gravest(without_imu) is MissionEvent.ESTIMATE_LOST
    unaligned = replace(given, vehicle=replace(given.vehicle, aligned=False))
    assert gravest(unaligned) is MissionEvent.ESTIMATE_LOST
    # not needed where the autopilot navigates
    assert gravest(old, State.WAYPOINT, Authority.NONE) is None


@pytest.mark.parametrize(
    ("imu_age_s", "unseen_s", "lost"),
    [(0.6, 0.2, False), (1.4, 0.2, False), (1.6, 0.2, True), (0.4, 1.0, False), (0.6, 0.4, True)],
)
def test_sinking_without_the_imu_the_motion_of_a_pad_seen_until_then_is_kept_longer(
    imu_age_s: float, unseen_s: float, lost: bool
) -> None:
    """LAND would brake it over a pad that drives on. `unseen_s`: at the loss of the IMU."""
    given, zero = inputs(), (0.0, 0.0, 0.0)
    assert given.vehicle is not None
    seen_s = given.vehicle.time_s - imu_age_s - unseen_s
    pad = PadState(50.0, zero, zero, zero, zero, 0.0, 0.0, 0.1, 0.1, seen_time_s=seen_s)
    blind = replace(given, vehicle=replace(given.vehicle, imu_age_s=imu_age_s), pad=pad)
    assert gravest(blind, State.SINK) is (MissionEvent.ESTIMATE_LOST if lost else None)


def test_a_controller_without_a_plan_for_a_second_ends_the_flight_by_setpoints() -> None:
    watch, _ = monitor()
    failed, told = replace(inputs(), control_failure="no plan"), []
    for cycle in range(60):
        found = watch.detect(failed if cycle != 20 else inputs(), 50.0 + cycle / 30.0)
        told.append(MissionEvent.CONTROL_FAILED in [event for event, _ in found])
    assert told.index(True) == 51  # counted from the last plan on
    assert all(told[51:])


def test_a_computer_that_is_too_slow_is_named_before_what_it_causes() -> None:
    """Slow, it sees answers late, estimates that are old and a camera that seems turned."""
    slow = replace(FLYING, round_trip_s=0.5, round_trip_time_s=50.0)
    given = replace(
        inputs(slow),
        computer=ComputerLoad("computer too slow"),
        comparisons=(differ(Quantity.CAMERA_ROTATION, 45.0),),
        control_failure="no plan",
    )
    assert gravest(given) is MissionEvent.COMPUTER_LATE
    assert gravest(given, State.SINK) is not MissionEvent.COMPUTER_LATE
    assert gravest(replace(given, computer=ComputerLoad())) is MissionEvent.LINK_LATE


@pytest.mark.parametrize(("held_up_s", "words"), [(0.7, ""), (1.3, ": setpoints stopped for 1.3 s")])
def test_a_mode_that_follows_setpoints_that_stopped_is_not_the_pilots_alone(
    held_up_s: float, words: str
) -> None:
    watch, _ = monitor()
    held_up = ComputerLoad(None, held_up_s)
    given = replace(
        inputs(replace(HELD, mode="POSCTL")), computer=held_up, link=LinkHealth(keeps_setpoint_s=1.0)
    )
    watch.detect(inputs(), 49.0)
    found = dict(watch.detect(given, 50.0))
    assert found[MissionEvent.TAKEN_OVER] == f"mode POSCTL was not requested{words}"


@pytest.mark.parametrize(
    ("mode", "intended", "words"),
    [
        ("AUTO.LAND", "", "mode AUTO.LAND was not requested"),
        ("AUTO.LAND", "AUTO.LAND", "mode AUTO.LAND was not requested"),
        ("AUTO.LAND", "OFFBOARD", "autopilot failsafe: AUTO.LAND instead of OFFBOARD"),
        ("POSCTL", "OFFBOARD", "mode POSCTL was not requested"),
    ],
)
def test_a_failsafe_of_the_autopilots_is_not_called_a_pilot(mode: str, intended: str, words: str) -> None:
    # PX4's CURRENT_MODE tells what was chosen from what a failsafe flies in its place
    watch, _ = monitor()
    watch.detect(inputs(), 49.0)
    flown = replace(HELD, mode=mode, intended_mode=intended)
    found = dict(watch.detect(inputs(flown), 50.0))
    assert found[MissionEvent.TAKEN_OVER] == words


# ---------------- Fence, ceiling and the fastest pad: reached with room to stop, whatever is followed

BOUNDED = PlanConfig(mission=MissionConfig(fence_m=50.0, ceiling_m=20.0))


def vehicle_at(from_home_m: Vector3, velocity: Vector3) -> VehicleState:
    w = PlanWorld(still())
    w.now_s = 5.0
    known = w.inputs().vehicle
    assert known is not None
    position = add(from_home_m, tuple(-p for p in ORIGIN_NED_M))  # type: ignore[arg-type]
    return replace(known, position_ned_m=position, velocity_ned_m_s=velocity, origin=ORIGIN)


def found(
    vehicle: VehicleState | None, home: Vector3 | None = HOME, config: PlanConfig = BOUNDED
) -> list[str]:
    autopilot = AutopilotState(5.0, connected=True, home=home)
    return [reason for _, reason in Bounds(config).detect(vehicle, None, autopilot, 5.0)]


@pytest.mark.parametrize("speed", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("course_deg", [0.0, 135.0, 250.0])
def test_the_fence_is_reached_so_early_that_it_can_stop_before_it(speed: float, course_deg: float) -> None:
    x, y = math.cos(math.radians(course_deg)), math.sin(math.radians(course_deg))
    edge_m = 50.0 - stopping_m(speed, speed, BOUNDED.guidance.horizontal_acceleration_m_s2)
    outward = (speed * x, speed * y, 0.0)
    for away_m, reached in ((edge_m - 0.1, False), (edge_m + 0.1, True)):
        assert bool(found(vehicle_at((away_m * x, away_m * y, -5.0), outward))) is reached
    # flying home or along the fence, it may be nearer
    for velocity in ((-speed * x, -speed * y, 0.0), (-speed * y, speed * x, 0.0)):
        assert found(vehicle_at((49.8 * x, 49.8 * y, -5.0), velocity)) == []


def test_the_ceiling_likewise() -> None:
    assert found(vehicle_at((0.0, 0.0, -19.5), (0.0, 0.0, 1.0))) == []
    assert found(vehicle_at((0.0, 0.0, -19.5), (0.0, 0.0, -1.0))) == ["ceiling: 20 m over home, limit 20 m"]


def test_the_room_to_stop_in_is_that_of_a_late_and_gentle_brake() -> None:
    # 0.8 s straight on, then at 2 m/s²
    assert stopping_m(4.0, 4.0, 2.0) == pytest.approx(0.8 * 4.0 + 4.0**2 / 4.0)
    assert stopping_m(-3.0, 3.0, 2.0) == 0.0


@pytest.mark.parametrize("brakes_m_s2", [0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("speed_m_s", [0.5, 4.0, 7.0])
def test_the_app_s_own_hold_stops_before_the_bounds(speed_m_s: float, brakes_m_s2: float) -> None:
    config = PlanConfig(
        mission=MissionConfig(fence_m=100.0, ceiling_m=20.0),
        guidance=GuidanceConfig(horizontal_acceleration_m_s2=brakes_m_s2),
    )
    climbing = (speed_m_s, 0.0, -1.0)
    held = ReferenceGenerator(config.guidance, lambda _d, _v, _a: 1.0, 20, 0.1, Avoidance(config, 0.0))
    held.start("local", Motion((0.0, 0.0, 0.0), climbing), 0.0)
    north_m, _, down_m = held.resting_place_m()
    beyond_m = 0.01
    over_fence = found(vehicle_at((100.0 - north_m + beyond_m, 0.0, -5.0), climbing), config=config)
    assert [words[:5] for words in over_fence] == ["fence"]
    over_ceiling = found(vehicle_at((0.0, 0.0, -20.0 - down_m - beyond_m), climbing), config=config)
    assert [words[:7] for words in over_ceiling] == ["ceiling"]


@pytest.mark.parametrize(
    ("ours", "theirs", "reason"),
    [
        ((20.0, 0.0, -5.0), (0.0, 60.0, -5.0), "fence: 60 m from home, limit 50 m"),
        ((60.0, 0.0, -5.0), (0.0, 20.0, -5.0), "fence: 60 m from home, limit 50 m"),
        ((0.0, 0.0, -5.0), (0.0, 0.0, -22.0), "ceiling: 22 m over home, limit 20 m"),
    ],
)
def test_without_gps_the_autopilots_position_counts_as_well(
    ours: Vector3, theirs: Vector3, reason: str
) -> None:
    drifts = replace(vehicle_at(ours, (0.0, 0.0, 0.0)), has_gps=False)
    autopilot = AutopilotState(
        5.0, connected=True, home=HOME, global_position=geodetic_from_ned(theirs, HOME)
    )
    assert [words for _, words in Bounds(BOUNDED).detect(drifts, None, autopilot, 5.0)] == [reason]
    fixed = replace(drifts, has_gps=True)
    assert bool([*Bounds(BOUNDED).detect(fixed, None, autopilot, 5.0)]) is (ours[0] > 50.0)
    # and so where the pad will be
    pad = Motion(drifts.position_ned_m)
    inside = Bounds(BOUNDED).inside_after(5.0, pad, 0.0, drifts, autopilot)
    assert inside is not reason.startswith("fence")


def test_without_home_or_an_estimate_there_is_nothing_to_count_from() -> None:
    assert found(vehicle_at((500.0, 0.0, -5.0), (0.0, 0.0, 0.0)), home=None) == []
    assert found(None) == []


def moving_pad(speed: float, acceleration: float, std_m_s: float) -> PadState:
    zero = (0.0, 0.0, 0.0)
    return PadState(
        0.0, zero, zero, (0.0, speed, 9.0), (acceleration, 0.0, 9.0), 0.0, 0.0, 0.1, std_m_s, seen_time_s=0.0
    )


@pytest.mark.parametrize(
    ("speed", "std_m_s", "followed"),
    [(4.9, 0.0, True), (5.1, 0.0, False), (5.25, 0.1, True), (5.35, 0.1, False), (9.0, 1.4, True)],
)
def test_a_pad_that_is_surely_too_fast_is_not_followed(speed: float, std_m_s: float, followed: bool) -> None:
    """Unseen for two seconds, or just found, its speed says little."""
    events = list(Bounds(BOUNDED).detect(None, moving_pad(speed, 0.0, std_m_s), AutopilotState(0.0), 0.0))
    assert [event for event, _ in events] == ([] if followed else [MissionEvent.PAD_TOO_FAST])


@pytest.mark.parametrize(("acceleration", "followed"), [(4.9, True), (5.1, False)])
def test_a_pad_that_turns_too_hard_for_half_a_second_is_not_followed(
    acceleration: float, followed: bool
) -> None:
    bounds, autopilot = Bounds(BOUNDED), AutopilotState(0.0)
    for step in range(18):
        events = list(bounds.detect(None, moving_pad(1.0, acceleration, 0.1), autopilot, step / 30.0))
        if step / 30.0 < 0.5:
            assert events == []
    assert [event for event, _ in events] == ([] if followed else [MissionEvent.PAD_TOO_FAST])


def test_a_pad_that_leads_away_is_left_before_the_fence() -> None:
    config = PlanConfig.model_validate({"mission": {"fence_m": 30.0}})
    w = world(line(2.0, start=-20.0), config)
    w.blind = lambda _t, height: height < 1.0  # it is never landed on
    farthest_m = 0.0

    def watch(w: PlanWorld, _step: object) -> None:
        nonlocal farthest_m
        farthest_m = max(farthest_m, math.hypot(*w.position[:2]))

    w.each = watch
    flight = w.fly(120.0)
    w.fly(6.0, until=lambda _w: False)
    assert flight.phase is Phase.ABORT
    assert any("limit 30 m" in text for text in flight.told("phase"))
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD
    assert farthest_m <= 30.0


def test_no_landing_begins_on_a_pad_that_is_beyond_the_fence_before_it_ends() -> None:
    # low over a pad that drives away at 2 m/s, 5 m before the fence: the landing would end outside
    w = world(line(2.0))
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    fence_m = math.hypot(*w.position[:2]) + 5.0
    low = world(line(2.0), PlanConfig.model_validate({"mission": {"fence_m": fence_m}}))
    flight = low.fly(120.0)
    low.fly(6.0, until=lambda _w: False)
    assert flight.phase is Phase.ABORT
    assert any("the pad leaves the fence" in text for text in flight.told("fence"))
    assert flight.told("commit") == []
    assert len(flight.told("fence")) == 1
    assert flight.told("heading") == []  # it would be told in every cycle of the wait
    assert any(f"limit {fence_m:.0f} m" in text for text in flight.told("phase"))
    assert math.hypot(*low.position[:2]) <= fence_m


def test_a_pad_that_drives_home_is_landed_on_however_near_to_the_fence() -> None:
    bounds, autopilot = Bounds(BOUNDED), AutopilotState(5.0, connected=True, home=HOME)
    vehicle = vehicle_at((49.0, 0.0, -0.5), (0.0, 0.0, 0.0))
    place = add((49.0, 0.0, 0.0), tuple(-p for p in ORIGIN_NED_M))  # type: ignore[arg-type]

    def inside(north_m_s: float, turn_rate_rad_s: float = 0.0) -> bool:
        pad = Motion(place, (north_m_s, 0.0, 0.0))
        return bounds.inside_after(4.0, pad, turn_rate_rad_s, vehicle, autopilot)

    assert inside(-2.0)
    assert inside(0.2)
    assert not inside(0.3)
    # once round in the time
    assert inside(2.0, math.tau / 4.0)
    assert bounds.inside_after(4.0, None, 0.0, vehicle, autopilot)
    assert bounds.inside_after(4.0, Motion(place, (9.0, 0.0, 0.0)), 0.0, vehicle, AutopilotState(5.0))


def test_what_turns_gets_as_far_as_its_arc() -> None:
    assert along_arc((1.0, 0.0, -2.0), (3.0, 4.0, 9.0), 0.0, 2.0) == (7.0, 8.0)
    # a quarter of a circle of 2 m to the right of north
    north, east = along_arc((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.5, math.pi)
    assert north == pytest.approx(2.0)
    assert east == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"ceiling_m": 14.0}, r"ceiling_m 14: expected at least 15"),
        ({"fence_m": 11.0}, r"a waypoint 10 m from home, expected at most fence_m - 2 = 9"),
    ],
)
def test_what_is_planned_outside_is_refused_at_the_start(settings: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        PlanConfig.model_validate({"mission": settings})
