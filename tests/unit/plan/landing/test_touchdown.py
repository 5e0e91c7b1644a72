import math

import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Quaternion, Vector3, quat_from_euler, scale
from companion.base.messages import AutopilotState, LandedState, LevelOff, PadState, RangeSample
from companion.base.motion import Motion
from companion.config import GuidanceConfig, TouchdownConfig
from companion.plan.debounce import Debounce
from companion.plan.landing.contact import contact_signs
from companion.plan.landing.tolerance import aligned, gentle
from companion.plan.landing.touchdown import TouchdownSequence
from companion.plan.mission.inputs import PlanInputs
from companion.plan.mission.states import Circumstances, DetectedEvent, MissionEvent, State
from companion.plan.mission.table import COMMITTED, ON_PAD, TOUCHDOWN, follows
from companion.plan.trajectory.guidance import ReferenceGenerator
from tests.unit.plan.plan_harness import LEG_M, VEHICLE

CONFIG = TouchdownConfig()
WAIT_M = LEG_M + 0.35
CYCLE_S = 1.0 / 30.0
SINKING = Motion((0.0, 0.0, -LEG_M + 0.1), (0.0, 0.0, 0.22))


def sight(
    aside: float = 0.0,
    height: float = WAIT_M,
    velocity: Vector3 = ZERO3,
    pad_acceleration: Vector3 = ZERO3,
    age: float = 0.0,
) -> PadState:
    """The pad under a vehicle that is so far aside and high, and moves over it at `velocity`."""
    relative = ((-aside, 0.0, height), scale(velocity, -1.0))
    return PadState(0.0, *relative, ZERO3, pad_acceleration, 0.0, 0.0, 0.0, 0.0, seen_time_s=-age)


class Attempt:
    """A try that goes from state to state as the table says; `step` returns what ends it, and a contact."""

    def __init__(self, sequence: TouchdownSequence, generator: ReferenceGenerator) -> None:
        self._sequence, self._generator = sequence, generator
        self.state = State.WAIT
        self.broken_off_by = ""
        self.contact_s = math.nan
        self.note_lean, self.level_off = sequence.note_lean, sequence.level_off

    @property
    def committed(self) -> bool:
        return self.state in COMMITTED

    @property
    def on_pad(self) -> bool:
        return self.state in ON_PAD

    def step(
        self, seen: PadState | None, echo: RangeSample | None, landed: LandedState, now_s: float
    ) -> DetectedEvent | None:
        inputs = PlanInputs(None, None, AutopilotState(now_s, landed=landed), range=echo)
        detected = self._sequence.step(self.state, seen, inputs, now_s)
        if detected is None:
            return None
        branch = follows(self.state, detected[0], Circumstances())
        if branch is None or branch.to not in TOUCHDOWN:
            return detected
        self.state = branch.to
        self._sequence.enter(self.state, now_s)
        if self.state is State.RISE:
            self.broken_off_by = detected[1]
        if self.state is State.STAND:
            self.contact_s = now_s
            return detected
        return None


def fresh(slack: float = 1.0, config: TouchdownConfig = CONFIG) -> Attempt:
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 0.4, 20, 0.1)
    generator.start("pad", Motion((0.0, 0.0, -WAIT_M)), 0.0)
    sequence = TouchdownSequence(config, VEHICLE, 0.35, generator)
    sequence.begin(0.0, slack)
    return Attempt(sequence, generator)


def wait(touchdown: Attempt, seen: PadState, until_s: float) -> tuple[float, MissionEvent | None]:
    """Step until it commits or finds something; the time and what."""
    k = 0
    while k * CYCLE_S < until_s:
        finding = touchdown.step(seen, None, LandedState.IN_AIR, k * CYCLE_S)
        if finding or touchdown.committed:
            return k * CYCLE_S, finding[0] if finding else None
        k += 1
    return until_s, None


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        (sight(aside=0.059), sight(aside=0.061)),
        (sight(velocity=(0.119, 0.0, 0.0)), sight(velocity=(0.121, 0.0, 0.0))),
        (sight(height=WAIT_M + 0.099), sight(height=WAIT_M + 0.101)),
        (sight(height=WAIT_M - 0.099), sight(height=WAIT_M - 0.101)),
        (sight(velocity=(0.0, 0.0, 0.149)), sight(velocity=(0.0, 0.0, 0.151))),
        (sight(age=0.3), sight(age=0.31)),
    ],
)
def test_aligned_on_both_sides_of_each_bound(good: PadState, bad: PadState) -> None:
    assert aligned(good, WAIT_M, 1.0, CONFIG)
    assert not aligned(bad, WAIT_M, 1.0, CONFIG)


def test_gentle_on_both_sides_of_each_bound() -> None:
    assert gentle(sight(pad_acceleration=(0.0, 1.19, 0.19)), CONFIG)
    assert not gentle(sight(pad_acceleration=(0.86, 0.86, 0.0)), CONFIG)
    assert not gentle(sight(pad_acceleration=(0.0, 0.0, -0.21)), CONFIG)


def test_it_commits_once_aligned_for_a_moment() -> None:
    at, found = wait(fresh(), sight(), 5.0)
    assert found is None
    assert at == pytest.approx(CONFIG.settled_s, abs=0.04)


def test_a_break_in_alignment_starts_the_moment_again() -> None:
    touchdown = fresh()
    for k in range(5):
        touchdown.step(sight(), None, LandedState.IN_AIR, k * CYCLE_S)
    touchdown.step(sight(aside=0.2), None, LandedState.IN_AIR, 5 * CYCLE_S)
    for k in range(6, 11):
        touchdown.step(sight(), None, LandedState.IN_AIR, k * CYCLE_S)
    assert not touchdown.committed


def test_a_restless_pad_is_waited_for_but_not_forever() -> None:
    at, found = wait(fresh(), sight(pad_acceleration=(1.5, 0.0, 0.0)), 20.0)
    assert found is None
    assert at == pytest.approx(CONFIG.patience_s + CONFIG.settled_s, abs=0.08)


def test_a_little_aside_is_accepted_late_and_far_aside_never() -> None:
    at, found = wait(fresh(), sight(aside=0.085), 30.0)
    assert found is None
    assert at == pytest.approx(2.0 * CONFIG.patience_s + CONFIG.settled_s, abs=0.08)
    at, found = wait(fresh(), sight(aside=0.2), 40.0)
    assert found is MissionEvent.MISALIGNED
    assert at == pytest.approx(6.0 * CONFIG.patience_s, abs=0.08)


def test_the_last_try_has_more_slack() -> None:
    assert wait(fresh(slack=1.6), sight(aside=0.085), 30.0)[0] < 1.0


def test_a_pad_unseen_while_waiting_is_lost() -> None:
    assert wait(fresh(), sight(age=CONFIG.blind_s + 0.01), 5.0) == (0.0, MissionEvent.PAD_LOST)


def sinking() -> Attempt:
    touchdown = fresh()
    wait(touchdown, sight(), 5.0)
    assert touchdown.committed
    return touchdown


def test_half_a_second_of_blindness_on_the_last_way_down_is_borne_and_two_are_not() -> None:
    touchdown = sinking()
    assert touchdown.step(sight(height=0.4, age=1.4), None, LandedState.IN_AIR, 1.0) is None
    found = touchdown.step(sight(height=0.4, age=1.6), None, LandedState.IN_AIR, 1.1)
    assert found is not None
    assert found[0] is MissionEvent.PAD_LOST


def test_far_aside_on_the_last_way_down_it_climbs_while_still_high_only() -> None:
    high = sinking().step(sight(aside=0.19, height=0.4), None, LandedState.IN_AIR, 1.0)
    assert high is not None
    assert high[0] is MissionEvent.MISALIGNED
    assert sinking().step(sight(aside=0.17, height=0.4), None, LandedState.IN_AIR, 1.0) is None
    assert sinking().step(sight(aside=0.19, height=0.21), None, LandedState.IN_AIR, 1.0) is None


def test_no_contact_long_after_it_was_due_is_a_miss() -> None:
    touchdown = sinking()
    found = None
    k = 6
    while found is None and k < 300:
        k += 1
        found = touchdown.step(sight(height=0.45), None, LandedState.IN_AIR, k * CYCLE_S)
    assert found is not None
    assert found[0] is MissionEvent.MISALIGNED
    # 0.35 m at the contact's speed with a blend of 0.8 s, then the patience
    speed_m_s = CONFIG.contact_speed_m_s
    due_s = CONFIG.blend_s + (0.35 - 0.5 * CONFIG.blend_s * speed_m_s) / speed_m_s
    assert k * CYCLE_S == pytest.approx(CONFIG.settled_s + due_s + CONFIG.overdue_s, abs=0.1)


@pytest.mark.parametrize(
    ("seen", "echo", "landed", "names"),
    [
        (sight(height=0.199, velocity=(0.0, 0.0, 0.2)), None, LandedState.IN_AIR, {"low"}),
        (sight(height=0.201, velocity=(0.0, 0.0, 0.2)), None, LandedState.IN_AIR, set()),
        (sight(height=0.21, velocity=(0.0, 0.0, 0.05)), None, LandedState.IN_AIR, {"stalled"}),
        (sight(height=0.21, velocity=(0.0, 0.0, 0.07)), None, LandedState.IN_AIR, set()),
        (None, 0.119, LandedState.IN_AIR, {"short_echo"}),
        (None, 0.121, LandedState.IN_AIR, set()),
        (None, None, LandedState.ON_GROUND, {"landed"}),
        (sight(height=0.18), 0.10, LandedState.ON_GROUND, {"low", "stalled", "short_echo", "landed"}),
    ],
)
def test_each_sign_of_contact_on_both_sides_of_its_bound(
    seen: PadState | None, echo: float | None, landed: LandedState, names: set[str]
) -> None:
    sample = None if echo is None else RangeSample(9.9, echo)
    signs = contact_signs(seen, SINKING, sample, landed, 10.0, config=CONFIG, vehicle=VEHICLE)
    assert {n for n in ("low", "stalled", "short_echo", "landed") if getattr(signs, n)} == names
    assert signs.count == len(names)


def test_an_old_echo_and_a_hover_are_no_signs() -> None:
    hover = Motion((0.0, 0.0, -WAIT_M))
    old = RangeSample(9.0, 0.05)
    signs = contact_signs(
        sight(height=0.6), hover, old, LandedState.IN_AIR, 10.0, config=CONFIG, vehicle=VEHICLE
    )
    assert signs.count == 0


@pytest.mark.parametrize(
    ("lean_deg", "above_m", "signs"),
    [(0.0, 0.015, 2), (0.0, 0.025, 0), (8.0, 0.04, 2), (8.0, 0.05, 0), (40.0, 0.06, 2), (40.0, 0.08, 0)],
)
def test_the_foot_that_hangs_lowest_is_the_one_that_touches(
    lean_deg: float, above_m: float, signs: int
) -> None:
    hover = Motion((0.0, 0.0, -LEG_M - above_m))
    echo = RangeSample(10.0, LEG_M + above_m - VEHICLE.range_position_body_m[2])
    found = contact_signs(
        sight(height=LEG_M + above_m),
        hover,
        echo,
        LandedState.IN_AIR,
        10.0,
        config=CONFIG,
        vehicle=VEHICLE,
        lean_rad=math.radians(lean_deg),
    )
    assert found.count == signs


def test_contact_needs_two_signs_for_a_moment() -> None:
    touchdown = sinking()
    down = sight(height=0.18, velocity=(0.0, 0.0, 0.2))
    for k in range(30):
        assert touchdown.step(down, None, LandedState.IN_AIR, 1.0 + k * CYCLE_S) is None
    assert not touchdown.on_pad
    for k in range(30, 40):
        now = 1.0 + k * CYCLE_S
        found = touchdown.step(down, RangeSample(now, 0.1), LandedState.IN_AIR, now)
        if found:
            break
    assert found is not None
    assert found[0] is MissionEvent.CONTACT
    assert touchdown.contact_s == pytest.approx(1.0 + 30 * CYCLE_S + CONFIG.contact_s, abs=0.05)


def test_standing_ends_only_when_the_pad_is_seen_well_below() -> None:
    touchdown = sinking()
    for k in range(8):
        now = 1.0 + k * CYCLE_S
        touchdown.step(sight(height=0.18), RangeSample(now, 0.1), LandedState.IN_AIR, now)
    assert touchdown.on_pad
    for k in range(30):
        assert touchdown.step(sight(height=0.40), None, LandedState.IN_AIR, 2.0 + k * CYCLE_S) is None
    found = None
    for k in range(15):
        found = found or touchdown.step(sight(height=0.5), None, LandedState.IN_AIR, 4.0 + k * CYCLE_S)
    assert found is not None
    assert found[0] is MissionEvent.OFF_PAD


def test_a_debounce_counts_from_the_last_break() -> None:
    held = Debounce()
    assert held.held_s(True, 1.0) == 0.0
    assert held.held_s(True, 1.5) == 0.5
    assert held.held_s(False, 1.6) < 0.0
    assert held.held_s(True, 2.0) == 0.0


def descent(touchdown: Attempt, lags_m: float, sink_m_s: float, count: int = 15) -> ReferenceGenerator:
    """Cycles of a vehicle that is so much above the reference and sinks at its own speed."""
    generator = touchdown._generator
    for k in range(count):
        now = 1.2 + k * CYCLE_S
        height = -generator.at(now).position_m[2] + lags_m
        touchdown.step(sight(height=height, velocity=(0.0, 0.0, sink_m_s)), None, LandedState.IN_AIR, now)
    return generator


def test_on_the_last_way_down_the_reference_gives_way_to_the_vehicles_height_but_not_its_speed() -> None:
    free, held = sinking(), sinking()
    lower = descent(free, 0.0, 0.2)
    higher = descent(held, 0.05, 0.2)
    gained = lower.at(1.7).position_m[2] - higher.at(1.7).position_m[2]
    # 0.05 m with a time constant of 0.3 s, over half a second
    assert gained == pytest.approx(0.05 * 0.5 / 0.3, rel=0.2)
    assert higher.at(1.7).velocity_m_s == lower.at(1.7).velocity_m_s


def test_next_to_the_pad_the_reference_goes_on_so_that_standing_shows() -> None:
    touchdown = sinking()
    for k in range(60):
        now = 1.0 + k * CYCLE_S
        touchdown.step(sight(height=LEG_M + 0.03), None, LandedState.IN_AIR, now)
    assert touchdown._generator.at(3.0).position_m[2] > -LEG_M + 0.05


@pytest.mark.parametrize(
    ("height", "sink_m_s", "broken"),
    [
        (LEG_M + 0.2, 0.36, True),
        (LEG_M + 0.2, 0.34, False),
        # it needs some 13 cm to stop from that, foot and all, and 18 from half a metre a second
        (LEG_M + 0.12, 0.36, False),
        (LEG_M + 0.14, 0.36, True),
        (LEG_M + 0.17, 0.5, False),
    ],
)
def test_sinking_too_fast_it_breaks_off_unless_it_is_down_already(
    height: float, sink_m_s: float, broken: bool
) -> None:
    touchdown = sinking()
    fast = sight(height=height, velocity=(0.0, 0.0, sink_m_s))
    for k in range(6):
        assert touchdown.step(fast, None, LandedState.IN_AIR, 1.0 + k * CYCLE_S) is None
        if not touchdown.committed:
            break
    assert touchdown.committed is not broken
    if broken:
        # and rises to where it waits, without a step, and may commit again
        before = touchdown._generator.at(1.2)
        for k in range(6, 80):
            touchdown.step(sight(height=height), None, LandedState.IN_AIR, 1.0 + k * CYCLE_S)
        after = touchdown._generator.at(3.5)
        assert before.velocity_m_s[2] > 0.0
        assert after.position_m[2] == pytest.approx(-WAIT_M, abs=0.01)
        assert wait(touchdown, sight(), 9.0)[1] is None


def test_a_break_off_climbs_at_once() -> None:
    touchdown = sinking()
    now_s, low = 1.0, sight(0.1, LEG_M + 0.25, velocity=(0.0, 0.0, 0.19))
    while touchdown.committed:
        touchdown.step(low, None, LandedState.IN_AIR, now_s)
        now_s += CYCLE_S
    begun_s = now_s - CYCLE_S
    start = touchdown._generator.at(begun_s)
    lowest_m = start.position_m[2]
    while now_s < begun_s + 0.3:
        touchdown.step(low, None, LandedState.IN_AIR, now_s)
        lowest_m = max(lowest_m, touchdown._generator.at(now_s).position_m[2])
        now_s += CYCLE_S
    assert start.velocity_m_s[2] == pytest.approx(CONFIG.contact_speed_m_s, abs=0.02)
    assert lowest_m - start.position_m[2] < 0.03
    assert touchdown._generator.at(now_s).velocity_m_s[2] < -0.25
    # and comes to rest where it waits, not far over it
    highest_m = 0.0
    while now_s < begun_s + 3.0:
        touchdown.step(sight(0.1), None, LandedState.IN_AIR, now_s)
        highest_m = min(highest_m, touchdown._generator.at(now_s).position_m[2])
        now_s += CYCLE_S
    assert -highest_m < WAIT_M + 0.1
    assert touchdown._generator.at(now_s).position_m[2] == pytest.approx(-WAIT_M, abs=0.01)


def test_one_fast_sample_is_no_reason_to_break_off() -> None:
    touchdown = sinking()
    for k in range(9):
        speed = 0.5 if k % 3 == 0 else 0.2
        seen = sight(height=0.4, velocity=(0.0, 0.0, speed))
        touchdown.step(seen, None, LandedState.IN_AIR, 1.0 + k * CYCLE_S)
    assert touchdown.committed


def leaning(acceleration_m_s2: float) -> Quaternion:
    return quat_from_euler(math.atan(acceleration_m_s2 / GRAVITY_M_S2), 0.0, 1.0)


def waited(touchdown: Attempt, lean_m_s2: float, from_s: float, until_s: float) -> None:
    for k in range(round((until_s - from_s) / CYCLE_S)):
        now_s = from_s + k * CYCLE_S
        touchdown.note_lean(leaning(lean_m_s2), now_s)
        touchdown.step(sight(), None, LandedState.IN_AIR, now_s)


@pytest.mark.parametrize(("share", "commits"), [(0.95, True), (1.05, False)])
def test_it_waits_while_it_leans_further_than_it_can_level_off(share: float, commits: bool) -> None:
    touchdown = fresh()
    waited(touchdown, share * CONFIG.gentle_lean_m_s2, 0.0, 2.0)
    assert touchdown.committed is commits


def test_impatience_bears_more_lean_by_and_by() -> None:
    touchdown = fresh()
    # 1.35 times what is gentle: borne once a patience beyond two of them has run out
    waited(touchdown, 1.35 * CONFIG.gentle_lean_m_s2, 0.0, 2.9 * CONFIG.patience_s)
    assert not touchdown.committed
    waited(touchdown, 1.35 * CONFIG.gentle_lean_m_s2, 2.9 * CONFIG.patience_s, 3.0 * CONFIG.patience_s + 1.0)
    assert touchdown.committed


def test_what_would_break_it_off_at_once_is_no_moment_to_commit() -> None:
    touchdown, told = fresh(), 0
    for k in range(round(29.0 / CYCLE_S)):
        was = touchdown.committed
        touchdown.note_lean(leaning(3.0), k * CYCLE_S)
        touchdown.step(sight(), None, LandedState.IN_AIR, k * CYCLE_S)
        told += touchdown.committed is not was
        if touchdown.committed:
            break
    assert told == 1
    assert k * CYCLE_S > 4.0 * CONFIG.patience_s


@pytest.mark.parametrize(
    ("aside", "height", "broken"),
    [
        (CONFIG.break_off_lateral_m - 0.002, LEG_M + 0.2, False),
        (CONFIG.break_off_lateral_m + 0.002, LEG_M + 0.2, True),
        (CONFIG.break_off_lateral_m + 0.002, LEG_M + CONFIG.break_off_above_m + 0.01, True),
        (CONFIG.break_off_lateral_m + 0.002, LEG_M + CONFIG.break_off_above_m - 0.01, False),
    ],
)
def test_aside_on_the_last_way_down_it_waits_again_over_the_pad(
    aside: float, height: float, broken: bool
) -> None:
    touchdown = sinking()
    for k in range(6):
        assert touchdown.step(sight(aside, height), None, LandedState.IN_AIR, 1.0 + k * CYCLE_S) is None
    assert touchdown.committed is not broken
    assert (f"{100.0 * aside:.0f} cm aside" in touchdown.broken_off_by) is broken


@pytest.mark.parametrize(("lean_deg", "broken"), [(0.0, True), (5.0, True), (12.0, False)])
def test_a_break_off_keeps_room_for_the_foot_that_hangs_lower(lean_deg: float, broken: bool) -> None:
    touchdown = sinking()
    # GIVEN 9 cm under the feet, of which a sink of 0.2 m/s takes 5 before it ends
    low = sight(0.1, LEG_M + 0.09, velocity=(0.0, 0.0, 0.2))
    for k in range(6):
        touchdown.note_lean(quat_from_euler(math.radians(lean_deg), 0.0, 0.0), 1.0 + k * CYCLE_S)
        touchdown.step(low, None, LandedState.IN_AIR, 1.0 + k * CYCLE_S)
    assert touchdown.committed is not broken


@pytest.mark.parametrize(
    ("aside", "speed_m_s", "broken"),
    [(0.04, 0.12, False), (0.04, 0.15, True), (0.0, 0.33, True), (-0.06, 0.4, False), (-0.06, -0.06, True)],
)
def test_a_gust_that_will_carry_it_aside_breaks_it_off_before_it_has(
    aside: float, speed_m_s: float, broken: bool
) -> None:
    touchdown = sinking()
    drifting = sight(aside, LEG_M + 0.2, velocity=(speed_m_s, 0.0, 0.19))
    for k in range(6):
        assert touchdown.step(drifting, None, LandedState.IN_AIR, 1.0 + k * CYCLE_S) is None
    assert touchdown.committed is not broken
    assert (f"at {abs(speed_m_s):.2f} m/s" in touchdown.broken_off_by) is broken


def test_it_does_not_start_down_into_a_drift_that_would_break_it_off() -> None:
    touchdown, told = fresh(slack=1.6), 0
    drifting = sight(0.088, velocity=(0.17, 0.0, 0.0))
    for k in range(round(15.0 / CYCLE_S)):
        was = touchdown.committed
        touchdown.step(drifting, None, LandedState.IN_AIR, k * CYCLE_S)
        told += touchdown.committed is not was
        if touchdown.committed:
            break
    assert told == 1
    assert k * CYCLE_S > 2.0 * CONFIG.patience_s


def test_drift_that_does_not_get_less_is_borne_by_and_by() -> None:
    committed = []
    for waited_s in (0.0, 4.0 * CONFIG.patience_s):
        touchdown, now_s = fresh(), 0.0
        while not touchdown.committed and now_s < waited_s + 1.0:
            touchdown.step(sight(0.2 if now_s < waited_s else 0.0), None, LandedState.IN_AIR, now_s)
            now_s += CYCLE_S
        # 13 cm in 0.22 s
        drifting = sight(0.06, LEG_M + 0.2, velocity=(0.3, 0.0, 0.19))
        for k in range(6):
            touchdown.step(drifting, None, LandedState.IN_AIR, now_s + k * CYCLE_S)
        committed.append(touchdown.committed)
    assert committed == [False, True]


def test_a_moment_aside_is_no_reason_to_break_off() -> None:
    touchdown = sinking()
    for k in range(9):
        seen = sight(aside=0.12 if k % 3 == 0 else 0.05, height=LEG_M + 0.2)
        touchdown.step(seen, None, LandedState.IN_AIR, 1.0 + k * CYCLE_S)
    assert touchdown.committed


def test_the_most_patient_of_tries_goes_on_from_no_farther_aside_than_twelve_centimetres() -> None:
    for aside, goes_on in ((0.115, True), (0.125, False)):
        touchdown = fresh(slack=2.0)
        wait(touchdown, sight(), 5.0)
        for k in range(6):
            touchdown.step(sight(aside, LEG_M + 0.2), None, LandedState.IN_AIR, 1.0 + k * CYCLE_S)
        assert touchdown.committed is goes_on


def test_it_does_not_start_down_from_where_it_would_break_off() -> None:
    touchdown = fresh(slack=1.6)
    at, found = wait(touchdown, sight(0.13), 40.0)
    assert found is MissionEvent.MISALIGNED
    assert at == pytest.approx(CONFIG.giving_up_s, abs=0.08)


@pytest.mark.parametrize(("aside", "goes_on"), [(0.24, True), (0.26, False)])
def test_for_a_larger_pad_it_may_be_farther_aside(aside: float, goes_on: bool) -> None:
    wide = TouchdownConfig(lateral_m=0.2, break_off_lateral_m=0.25, escape_lateral_m=0.5)
    touchdown = fresh(config=wide)
    wait(touchdown, sight(), 5.0)
    for k in range(6):
        touchdown.step(sight(aside, LEG_M + 0.2), None, LandedState.IN_AIR, 1.0 + k * CYCLE_S)
    assert touchdown.committed is goes_on


def test_each_break_off_uses_up_the_same_try() -> None:
    touchdown, commits, found, k = fresh(), 0, None, 0
    while found is None and k * CYCLE_S < 60.0:
        was = touchdown.committed
        seen = sight(0.2, LEG_M + 0.2) if was else sight()
        found = touchdown.step(seen, None, LandedState.IN_AIR, k * CYCLE_S)
        found = None if found and found[0] is MissionEvent.MISALIGNED and was else found
        commits += touchdown.committed and not was
        k += 1
    assert commits > 5
    assert found is not None
    assert found[0] is MissionEvent.MISALIGNED
    assert k * CYCLE_S == pytest.approx(CONFIG.giving_up_s, abs=0.6)


def test_a_gust_on_the_way_down_breaks_it_off() -> None:
    touchdown = fresh()
    waited(touchdown, 0.0, 0.0, 0.5)
    before = touchdown.committed
    waited(touchdown, 3.0, 0.5, 1.2)
    assert (before, touchdown.committed) == (True, False)
    assert touchdown.broken_off_by == "leaning too far"
    assert touchdown.level_off() is None


def levelling(lean_m_s2: float) -> tuple[Attempt, LevelOff]:
    """A vehicle on its last way down, 0.3 m over the pad at 1 s, that leans so."""
    touchdown = fresh()
    waited(touchdown, 0.0, 0.0, 0.5)
    for now_s in (0.5, 10.0):  # so long that the smoothed lean is there
        touchdown.note_lean(leaning(lean_m_s2), now_s)
    touchdown.step(sight(height=LEG_M + 0.3), None, LandedState.IN_AIR, 1.0)
    level = touchdown.level_off()
    assert level is not None
    return touchdown, level


def test_it_levels_off_shortly_before_the_contact_and_no_longer_than_that_takes() -> None:
    _, level = levelling(0.0)
    due_s = 1.0 + (0.3 - 0.02) / CONFIG.contact_speed_m_s  # low on one side
    assert due_s - level.from_s == pytest.approx(0.31)
    assert level.until_s - level.from_s == pytest.approx(0.42)
    assert level.tilt_rad == pytest.approx(math.radians(CONFIG.contact_tilt_deg))


@pytest.mark.parametrize(("excess_m_s2", "longer_s"), [(0.0, 0.8), (0.5, 0.24), (0.8, 0.15)])
def test_a_contact_that_comes_late_keeps_it_level_while_that_makes_little_speed(
    excess_m_s2: float, longer_s: float
) -> None:
    level_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(CONFIG.contact_tilt_deg))
    touchdown, _ = levelling(level_m_s2 + excess_m_s2)
    near = sight(height=LEG_M + 0.05, velocity=(0.0, 0.0, 0.4))
    now_s = 1.0
    for _ in range(34):  # 5 cm up all the time
        touchdown.step(near, None, LandedState.IN_AIR, now_s)
        now_s += CYCLE_S
    level = touchdown.level_off()
    assert level is not None
    assert level.from_s == pytest.approx(1.0)
    assert level.until_s - level.from_s - 0.42 == pytest.approx(
        longer_s, abs=0.15 if longer_s > 0.5 else 1e-3
    )


def test_a_sink_that_slows_once_it_is_level_is_a_later_contact() -> None:
    touchdown, _ = levelling(0.0)
    for now_s, sink_m_s in ((1.0, CONFIG.contact_speed_m_s), (1.3, 0.1)):
        near = sight(height=LEG_M + 0.06, velocity=(0.0, 0.0, sink_m_s))
        touchdown.step(near, None, LandedState.IN_AIR, now_s)
    level = touchdown.level_off()
    assert level is not None
    assert level.from_s == pytest.approx(1.0)
    assert level.until_s == pytest.approx(1.3 + 0.04 / 0.1 + 0.42 - 0.31)


def test_while_contact_is_made_sure_of_it_stays_level() -> None:
    touchdown, _ = levelling(0.0)
    down = sight(height=LEG_M)
    for k in range(30):
        now_s = 1.0 + k * CYCLE_S
        touchdown.step(down, RangeSample(now_s, LEG_M - 0.08), LandedState.IN_AIR, now_s)
        level = touchdown.level_off()
        if touchdown.on_pad:
            break
        assert level is not None
        assert level.until_s > now_s + 0.1
    assert touchdown.on_pad


@pytest.mark.parametrize("lateral_m", [0.0, 0.19])
def test_who_gives_the_last_way_down_up_climbs_at_once(lateral_m: float) -> None:
    touchdown = sinking()
    late_s = 1.0 if lateral_m else 20.0
    low = sight(lateral_m, LEG_M + 0.05, velocity=(0.0, 0.0, 0.19))
    found = touchdown.step(low, None, LandedState.IN_AIR, late_s)
    assert found is not None
    assert found[0] is MissionEvent.MISALIGNED
    # WHEN the landing flies back to over the pad from the next cycle on
    before = touchdown._generator.at(late_s)
    touchdown._generator.fly_to(Motion((0.0, 0.0, -LEG_M - 1.5)), late_s + CYCLE_S)
    lowest_m = max(touchdown._generator.at(late_s + 0.01 * k).position_m[2] for k in range(30))
    assert lowest_m < before.position_m[2] + 0.03
    assert touchdown._generator.at(late_s + 0.3).velocity_m_s[2] == pytest.approx(-0.3, abs=0.01)


def test_leaning_back_from_far_aside_a_low_foot_is_no_contact() -> None:
    for aside_m, found in ((0.25, MissionEvent.MISALIGNED), (0.08, MissionEvent.CONTACT)):
        touchdown, finding = sinking(), None
        low = sight(aside_m, LEG_M + 0.05, velocity=(0.0, 0.0, 0.05))
        for k in range(12):
            now_s = 1.0 + k * CYCLE_S
            touchdown.note_lean(quat_from_euler(math.radians(12.0), 0.0, 0.0), now_s)
            echo = RangeSample(now_s, LEG_M + 0.05 - VEHICLE.range_position_body_m[2])
            finding = finding or touchdown.step(low, echo, LandedState.IN_AIR, now_s)
        assert finding is not None
        assert finding[0] is found
