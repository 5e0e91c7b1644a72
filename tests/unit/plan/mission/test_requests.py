from companion.base.messages import Action, ActionKind, ActionResult
from companion.plan.mission.requests import Requests

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
    assert given_up == ("go_to refused 3 times: too far",)
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
