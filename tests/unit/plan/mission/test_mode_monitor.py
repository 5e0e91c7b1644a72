"""Which modes are ours, and which are a pilot's word, in every state and for both autopilots."""

from dataclasses import replace

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Action, ActionKind, ActionResult, AutopilotState, LandedState, LinkHealth
from companion.plan.mission.mode_monitor import TAKES_S, ModeMonitor, in_land
from companion.plan.mission.requests import Requests
from companion.plan.mission.states import Authority, State
from companion.plan.mission.table import LIVE

TAKE_OFF_M = 7.0
PX4_OTHERS = ("MANUAL", "POSCTL", "AUTO.MISSION", "AUTO.RTL", "AUTO.FOLLOW_TARGET", "mode 196608")
ARDUPILOT_OTHERS = ("STABILIZE", "LOITER", "AUTO", "RTL", "ALT_HOLD", "mode 27")
WITHOUT_CONTROL = (State.TAKE_OFF, State.WAYPOINT, State.ROUTE, State.SEARCH, State.AWAIT_LINK)
UNHEEDED = {State.STANDBY, State.CONNECT}


class Modes:
    """A monitor, and the mode that it is shown."""

    def __init__(self, kind: AutopilotKind = "px4", found: str = "AUTO.LOITER") -> None:
        self.kind: AutopilotKind = kind
        self.monitor = ModeMonitor(TAKE_OFF_M)
        self.now_s, self.landed = 0.0, LandedState.IN_AIR
        assert not self.taken_over(found, State.CONNECT)

    def taken_over(
        self,
        mode: str,
        state: State,
        authority: Authority = Authority.NONE,
        *,
        requested: bool = True,
        up_m: float | None = 0.0,
        asked: frozenset[ActionKind] = frozenset(),
    ) -> bool:
        self.now_s += 0.03
        autopilot = AutopilotState(
            self.now_s, connected=True, autopilot_kind=self.kind, mode=mode, landed=self.landed
        )
        return self.monitor.taken_over(
            state, authority, autopilot, requested=requested, over_home_m=up_m, now_s=self.now_s, asked=asked
        )

    def taken_since_end(self, mode: str, *asked: ActionKind) -> bool:
        autopilot = AutopilotState(
            self.now_s, connected=True, autopilot_kind=self.kind, mode=mode, landed=self.landed
        )
        return self.monitor.taken_since_end(autopilot, frozenset(asked))

    def take_off(self) -> None:
        """To the take-off height in the autopilot's own mode."""
        own = "AUTO.TAKEOFF" if self.kind == "px4" else "GUIDED"
        assert not self.taken_over(own, State.TAKE_OFF, up_m=1.0)
        assert not self.taken_over(own, State.TAKE_OFF, up_m=TAKE_OFF_M)


def test_a_flight_as_requested_is_nobody_elses() -> None:
    px4 = Modes()
    px4.take_off()
    for state in (State.TAKE_OFF, State.WAYPOINT, State.SEARCH):
        assert not px4.taken_over("AUTO.LOITER", state, up_m=TAKE_OFF_M)
    assert not px4.taken_over("OFFBOARD", State.SEARCH)
    assert not px4.taken_over("OFFBOARD", State.APPROACH, Authority.OURS)
    ardupilot = Modes("ardupilot", "STABILIZE")
    assert not ardupilot.taken_over("STABILIZE", State.ARM)
    for state in (State.ARM, State.TAKE_OFF, State.WAYPOINT, State.SEARCH):
        assert not ardupilot.taken_over("GUIDED", state)


@pytest.mark.parametrize("state", WITHOUT_CONTROL)
@pytest.mark.parametrize(
    ("kind", "mode"),
    [*(("px4", mode) for mode in PX4_OTHERS), *(("ardupilot", mode) for mode in ARDUPILOT_OTHERS)],
)
def test_before_control_any_mode_that_was_not_requested_is_a_pilots(
    state: State, kind: AutopilotKind, mode: str
) -> None:
    modes = Modes(kind, "AUTO.LOITER" if kind == "px4" else "STABILIZE")
    modes.take_off()
    assert modes.taken_over(mode, state, up_m=TAKE_OFF_M)


@pytest.mark.parametrize("state", sorted(LIVE - UNHEEDED))
@pytest.mark.parametrize("authority", list(Authority))
def test_a_pilots_sticks_are_heeded_in_every_state(state: State, authority: Authority) -> None:
    modes = Modes()
    modes.take_off()
    assert modes.taken_over("POSCTL", state, authority, up_m=TAKE_OFF_M)


@pytest.mark.parametrize("state", sorted(UNHEEDED))
def test_before_the_first_request_every_mode_is_just_found(state: State) -> None:
    modes = Modes()
    for mode in PX4_OTHERS:
        assert not modes.taken_over(mode, state)


def test_a_hold_during_the_climb_is_a_pilots_and_the_one_that_ends_px4s_take_off_is_not() -> None:
    modes, climbed = Modes(), Modes()
    assert not modes.taken_over("AUTO.TAKEOFF", State.TAKE_OFF, up_m=2.0)
    assert modes.taken_over("AUTO.LOITER", State.TAKE_OFF, up_m=2.5)
    climbed.take_off()
    assert not climbed.taken_over("AUTO.LOITER", State.TAKE_OFF, up_m=TAKE_OFF_M - 0.8)


@pytest.mark.parametrize("found", ["POSCTL", "MANUAL", "AUTO.RTL"])
def test_a_mode_chosen_before_the_start_has_to_give_way_to_the_requested_one(found: str) -> None:
    modes = Modes(found=found)
    assert not modes.taken_over(found, State.ARM)
    assert not modes.taken_over(found, State.TAKE_OFF, requested=False)
    assert not modes.taken_over(found, State.TAKE_OFF)  # accepted: it takes a moment
    modes.now_s += TAKES_S
    assert modes.taken_over(found, State.TAKE_OFF)
    # and once it has given way it is a pilot's
    modes = Modes(found=found)
    modes.take_off()
    assert modes.taken_over(found, State.TAKE_OFF, up_m=3.0)


def test_a_change_of_mode_while_arming_is_heeded() -> None:
    assert Modes(found="POSCTL").taken_over("AUTO.MISSION", State.ARM)
    assert not Modes(found="POSCTL").taken_over("AUTO.LOITER", State.ARM)
    ardupilot = Modes("ardupilot", "STABILIZE")
    assert not ardupilot.taken_over("GUIDED", State.ARM)
    assert ardupilot.taken_over("STABILIZE", State.ARM)


@pytest.mark.parametrize("authority", [Authority.OURS, Authority.RELEASED])
@pytest.mark.parametrize(
    ("kind", "mode"),
    [("px4", "AUTO.LAND"), ("ardupilot", "LAND"), ("px4", "OFFBOARD"), ("ardupilot", "GUIDED")],
)
def test_land_that_we_requested_is_no_pilots(kind: AutopilotKind, mode: str, authority: Authority) -> None:
    modes = Modes(kind)
    for state in (State.SET_DOWN, State.AUTO_LAND):
        assert not modes.taken_over(mode, state, authority)


@pytest.mark.parametrize(("kind", "hold"), [("px4", "AUTO.LOITER"), ("ardupilot", "BRAKE")])
def test_a_hold_during_our_landing_is_a_pilots_until_it_is_down(kind: AutopilotKind, hold: str) -> None:
    modes = Modes(kind)
    for state in (State.SET_DOWN, State.AUTO_LAND):
        assert modes.taken_over(hold, state, Authority.OURS)
        modes.landed = LandedState.ON_GROUND  # a PX4 that has disarmed in LAND goes to Hold by itself
        assert not modes.taken_over(hold, state, Authority.OURS)
        modes.landed = LandedState.IN_AIR


HOLDS: tuple[tuple[AutopilotKind, str, str, str], ...] = (
    ("px4", "AUTO.LOITER", "AUTO.LAND", "OFFBOARD"),
    ("ardupilot", "BRAKE", "LAND", "GUIDED"),
)


@pytest.mark.parametrize(("kind", "hold", "land", "control"), HOLDS)
def test_released_the_mode_that_was_asked_for_is_ours_and_no_other(
    kind: AutopilotKind, hold: str, land: str, control: str
) -> None:
    modes, asked = Modes(kind, control), frozenset({ActionKind.HOLD})
    assert not modes.taken_over(hold, State.HOLD, Authority.RELEASED, asked=asked)
    assert not modes.taken_over(control, State.HOLD, Authority.RELEASED, asked=asked)  # not carried out yet
    assert modes.taken_over(land, State.HOLD, Authority.RELEASED, asked=asked)
    assert modes.taken_over(hold, State.HOLD, Authority.RELEASED, asked=frozenset({ActionKind.LAND}))


@pytest.mark.parametrize(("kind", "hold", "land", "control"), HOLDS)
def test_after_the_end_only_what_was_asked_last_is_ours(
    kind: AutopilotKind, hold: str, land: str, control: str
) -> None:
    modes = Modes(kind, control)
    modes.take_off()
    assert not modes.taken_over(control, State.APPROACH, Authority.OURS)
    for asked, ours in ((ActionKind.HOLD, hold), (ActionKind.LAND, land)):
        found = {mode: modes.taken_since_end(mode, asked) for mode in (hold, land, control)}
        assert found == {mode: mode not in {ours, control} for mode in found}
    # one that has come down in LAND goes to Hold by itself
    modes.landed = LandedState.ON_GROUND
    assert not modes.taken_since_end(hold, ActionKind.LAND, ActionKind.DISARM)


def test_control_is_ours_after_the_end_only_where_it_was_still_asked_for() -> None:
    modes = Modes()
    modes.take_off()
    assert not modes.taken_over("AUTO.LOITER", State.SEARCH, up_m=TAKE_OFF_M)
    assert modes.taken_since_end("OFFBOARD", ActionKind.HOLD)
    assert not modes.taken_since_end("OFFBOARD", ActionKind.HOLD, ActionKind.TAKE_CONTROL)


OFFBOARD_WAITS = AutopilotState(
    10.0, connected=True, autopilot_kind="px4", mode="AUTO.LOITER", intended_mode="OFFBOARD"
)


OBEYS = replace(OFFBOARD_WAITS, mode="OFFBOARD", offboard=True)


def after_silence(autopilot: AutopilotState, *, silent_s: float, since_s: float) -> bool:
    """Whether the mode counts as a pilot's, `since_s` after a silence ended, with control ours."""
    return silenced(ModeMonitor(TAKE_OFF_M), OBEYS, autopilot, silent_s=silent_s, since_s=since_s)


def silenced(
    monitor: ModeMonitor,
    before: AutopilotState,
    after: AutopilotState,
    *,
    silent_s: float,
    since_s: float,
    from_s: float = 10.0,
    keeps_s: float = 1.0,
) -> bool:
    monitor.listen(before, LinkHealth(0.0, keeps_s), from_s)
    unheard = replace(before, connected=False, offboard=False)
    monitor.listen(unheard, LinkHealth(silent_s, keeps_s), from_s + silent_s)
    now_s = from_s + silent_s + since_s
    monitor.listen(after, LinkHealth(0.0, keeps_s), now_s)
    return monitor.taken_over(
        State.APPROACH, Authority.OURS, after, requested=True, over_home_m=5.0, now_s=now_s
    )


@pytest.mark.parametrize("mode", ["AUTO.LOITER", "AUTO.RTL", "AUTO.LAND"])
def test_as_a_lost_link_comes_back_the_failsafe_for_want_of_setpoints_is_no_pilots_word(mode: str) -> None:
    waits = replace(OFFBOARD_WAITS, mode=mode)
    assert not after_silence(waits, silent_s=1.0, since_s=0.1)
    assert not after_silence(waits, silent_s=5.0, since_s=0.9)
    assert after_silence(waits, silent_s=1.0, since_s=1.1)  # it obeys the first setpoint that arrives


@pytest.mark.parametrize("intended", ["AUTO.LOITER", ""])
def test_a_hold_that_was_chosen_or_may_have_been_is_a_pilots_however_silent_the_link_was(
    intended: str,
) -> None:
    assert after_silence(replace(OFFBOARD_WAITS, intended_mode=intended), silent_s=1.0, since_s=0.1)


def test_sticks_are_heeded_whoever_chose_their_mode() -> None:
    assert after_silence(replace(OFFBOARD_WAITS, mode="POSCTL"), silent_s=1.0, since_s=0.1)


def test_it_has_to_obey_again_before_another_silence_is_excused() -> None:
    monitor = ModeMonitor(TAKE_OFF_M)
    assert not silenced(monitor, OBEYS, OFFBOARD_WAITS, silent_s=1.0, since_s=0.1)
    assert silenced(monitor, OFFBOARD_WAITS, OFFBOARD_WAITS, silent_s=1.2, since_s=0.1, from_s=11.1)


def test_without_a_silence_a_failsafe_in_control_is_final() -> None:
    assert after_silence(OFFBOARD_WAITS, silent_s=0.4, since_s=0.1)


@pytest.mark.parametrize(("keeps_s", "counts"), [(0.5, False), (1.0, True), (3.0, True)])
def test_what_a_silence_is_the_vehicles_own_time_out_says(keeps_s: float, counts: bool) -> None:
    after = {"silent_s": 0.4, "since_s": 0.1, "keeps_s": keeps_s}
    assert silenced(ModeMonitor(TAKE_OFF_M), OBEYS, OFFBOARD_WAITS, **after) is counts


def test_what_has_no_name_says_nothing() -> None:
    assert not Modes().taken_over("", State.SEARCH)


@pytest.mark.parametrize(
    ("mode", "lands"), [("AUTO.LAND", True), ("LAND", True), ("OFFBOARD", False), ("", False)]
)
def test_an_autopilot_in_land_says_so(mode: str, lands: bool) -> None:
    autopilot = AutopilotState(0.0, connected=True, autopilot_kind="px4", mode=mode)
    assert in_land(autopilot) is lands
    assert not in_land(replace(autopilot, connected=False))  # what it said before is old


# ---------------- test_requests

ARM = Action(ActionKind.ARM)
GO = Action(ActionKind.GO_TO, position=(47.0, 8.0, 7.0))
GYROS, POSITION = "Arming denied: gyros not calibrated", "Arm: Need Position Estimate"


def refused(kind: ActionKind = ActionKind.ARM, text: str = GYROS) -> tuple[ActionResult, ...]:
    return (ActionResult(0.0, kind, False, text),)


def requests() -> Requests:
    return Requests(retry_s=2.0, answer_s=5.0, attempts=3)


def test_an_action_is_sent_once_however_often_it_is_asked() -> None:
    r = requests()
    sent: list[Action] = []
    for cycle in range(60):
        r.ask(ARM, cycle / 30.0)
        sent += r.due(cycle / 30.0)
    assert sent == [ARM]


def test_a_disarming_that_may_be_forced_takes_the_place_of_one_that_may_not() -> None:
    r, plain, forced = requests(), Action(ActionKind.DISARM), Action(ActionKind.DISARM, force=True)
    r.ask(plain, 0.0)
    assert r.due(0.0) == (plain,)
    assert r.hear(refused(ActionKind.DISARM), 0.1) == ()
    r.ask(forced, 0.2)
    r.ask(plain, 0.3)
    assert r.due(0.3) == (forced,)


def test_a_refused_action_is_tried_again_only_after_a_pause() -> None:
    r = requests()
    r.ask(ARM, 0.0)
    assert r.due(0.0) == (ARM,)
    assert r.hear(refused(), 0.5) == ()
    assert r.due(2.4) == ()
    assert r.due(2.5) == (ARM,)


def test_after_its_attempts_it_is_given_up_with_the_autopilots_words() -> None:
    r = requests()
    r.ask(GO, 0.0)
    given_up: tuple[str, ...] = ()
    for k in range(3):
        assert r.due(10.0 * k) == (GO,)
        given_up = r.hear(refused(ActionKind.GO_TO, "too far"), 10.0 * k + 1.0)
        assert (given_up == ()) == (k < 2)
    assert given_up == ("go to refused 3 times: too far",)
    assert r.due(100.0) == ()


def test_arming_is_never_given_up_and_each_new_reason_is_reported_once() -> None:
    r = requests()
    r.ask(ARM, 0.0)
    told: list[tuple[str, ...]] = []
    for k, text in enumerate([GYROS, GYROS, GYROS, GYROS, POSITION, POSITION]):
        assert r.due(10.0 * k) == (ARM,)
        assert r.hear(refused(text=text), 10.0 * k + 1.0) == ()
        told.append(r.news())
    first, then = (f"arm refused: {text}; retry every 2 s" for text in (GYROS, POSITION))
    assert told == [(first,), (), (), (), (then,), ()]


def test_silence_counts_as_a_refusal() -> None:
    r = requests()
    r.ask(ARM, 0.0)
    r.due(0.0)
    assert r.hear((), 4.9) == ()
    r.hear((), 5.0)
    assert r.due(6.9) == ()
    assert r.due(7.0) == (ARM,)


def test_a_granted_action_is_remembered_until_forgotten() -> None:
    r = requests()
    r.ask(ARM, 0.0)
    r.due(0.0)
    r.hear((ActionResult(0.1, ActionKind.ARM, True),), 0.1)
    assert r.granted(ActionKind.ARM)
    r.ask(ARM, 1.0)
    assert r.due(1.0) == ()
    r.forget()
    assert not r.granted(ActionKind.ARM)
    r.ask(ARM, 2.0)
    assert r.due(2.0) == (ARM,)


def test_answers_to_what_was_not_asked_change_nothing() -> None:
    r = requests()
    r.ask(ARM, 0.0)
    r.hear((ActionResult(0.0, ActionKind.ARM, True),), 0.0)  # not sent yet: an answer to an older one
    assert not r.granted(ActionKind.ARM)
    r.hear((ActionResult(0.0, ActionKind.LAND, True),), 0.0)
    assert not r.granted(ActionKind.LAND)


def test_different_actions_do_not_wait_for_each_other() -> None:
    r = requests()
    r.ask(ARM, 0.0)
    r.ask(GO, 0.0)
    assert r.due(0.0) == (ARM, GO)
    assert r.asked(ActionKind.GO_TO)
    assert not r.asked(ActionKind.LAND)


def test_what_is_reported_goes_out_once_and_awaits_nothing() -> None:
    r = requests()
    r.tell(Action(ActionKind.REQUEST_PAD_POSITION))
    assert [a.kind for a in r.due(0.0)] == [ActionKind.REQUEST_PAD_POSITION]
    assert r.due(0.1) == ()
    assert r.hear((), 100.0) == ()


def test_what_was_asked_last_is_what_may_still_be_carried_out() -> None:
    r, control, hold = requests(), Action(ActionKind.TAKE_CONTROL), Action(ActionKind.HOLD)
    r.ask(ARM, 0.0)
    r.due(0.0)
    r.hear((ActionResult(0.1, ActionKind.ARM, True, ""),), 0.1)
    r.ask(control, 0.2)
    r.due(0.2)
    assert r.asked_last == {ActionKind.ARM, ActionKind.TAKE_CONTROL}
    r.forget()
    r.ask(hold, 0.3)
    assert r.asked_last == {ActionKind.HOLD, ActionKind.TAKE_CONTROL}  # which has had no answer
    r.due(0.3)
    r.forget()
    assert r.asked_last == {ActionKind.HOLD}


@pytest.mark.parametrize("left", [True, False])
def test_a_try_that_does_not_leave_says_nothing_of_the_one_before_it(left: bool) -> None:
    r = requests()
    r.ask(GO, 0.0)
    for k, in_doubt in enumerate((True if left else None, None)):
        assert r.due(10.0 * k) == (GO,)
        r.hear((ActionResult(10.0 * k, ActionKind.GO_TO, False, "not now", in_doubt),), 10.0 * k)
        assert (r.in_doubt(ActionKind.GO_TO), r.awaited(ActionKind.GO_TO)) == (left, False)
    r.due(20.0)
    r.hear((ActionResult(20.0, ActionKind.GO_TO, False, "denied"),), 20.0)
    assert not r.in_doubt(ActionKind.GO_TO)


@pytest.mark.parametrize(
    ("answer", "in_doubt"),
    [
        (None, True),  # none at all
        (ActionResult(0.0, ActionKind.GO_TO, False, "no answer", in_doubt=True), True),
        (ActionResult(0.0, ActionKind.GO_TO, False, "denied"), False),
    ],
)
def test_what_was_given_up_may_still_be_carried_out_unless_it_was_denied(
    answer: ActionResult | None, in_doubt: bool
) -> None:
    r = requests()
    r.ask(GO, 0.0)
    assert not r.in_doubt(ActionKind.GO_TO)  # it has not left
    for k in range(3):
        assert r.due(10.0 * k) == (GO,)
        assert r.awaited(ActionKind.GO_TO)
        given_up = r.hear(() if answer is None else (answer,), 10.0 * k + 6.0)
        assert (given_up == ()) == (k < 2)
    assert r.in_doubt(ActionKind.GO_TO) is in_doubt
    assert r.awaited(ActionKind.GO_TO) is (answer is None)
    assert r.asked_last == ({ActionKind.GO_TO} if in_doubt else set())
    r.forget()
    assert r.asked_last == ({ActionKind.GO_TO} if in_doubt else set())
    r.forget()
    assert r.asked_last == set()
