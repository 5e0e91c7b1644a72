"""What the parts of the planner announce: each time, once, now and then, or at a change."""

from companion.plan.events import Announcements


def kinds(say: Announcements) -> list[str]:
    return [notice.kind for notice in say.drain()]


def test_a_cycle_announces_what_was_said_in_it_and_no_more() -> None:
    say = Announcements()
    say("commit", "sinking", 1.0)
    say("strayed", "1.0 m", 1.0, "warning")
    assert [(n.kind, n.severity, n.time_s) for n in say.drain()] == [
        ("commit", "info", 1.0),
        ("strayed", "warning", 1.0),
    ]
    assert say.drain() == ()


def test_what_holds_on_is_warned_of_once_and_by_what_it_is_of() -> None:
    say = Announcements()
    for of in ("beacon", "beacon", "commit"):
        say.once(of, "fence", "outside", 1.0)
    assert kinds(say) == ["fence", "fence"]


def test_what_is_waited_for_is_said_again_after_a_while_each_kind_for_itself() -> None:
    say = Announcements()
    for now_s in (0.0, 9.9, 10.0, 15.0):
        say.again("waiting", "no home", now_s, 10.0)
    assert kinds(say) == ["waiting", "waiting"]
    say.again("standby", "no camera", 15.0, 10.0, "warning")
    assert [(n.kind, n.severity) for n in say.drain()] == [("standby", "warning")]


def test_a_change_is_said_unless_it_follows_the_last_too_soon() -> None:
    say = Announcements()
    for now_s, kind in ((0.0, "clear"), (1.0, "detour"), (2.0, "clear"), (3.0, "clear"), (4.0, "clear")):
        say.change("obstacles", kind, kind, now_s, 2.0, "info")
    assert [(n.kind, n.time_s) for n in say.drain()] == [("detour", 1.0), ("clear", 3.0)]
