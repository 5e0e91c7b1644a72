"""The bench of interruptions: its moments, its judge, and going on."""

from collections.abc import Iterable
from pathlib import Path

import pytest
from mcap.writer import Writer

from benchmarks.service import judging
from benchmarks.service.bench_interruptions import NotFlown, main
from benchmarks.service.judging import (
    KINDS,
    OFFBOARD,
    PHASES,
    POSCTL,
    AppCommand,
    Beat,
    InterruptedTrial,
    Kind,
    SeenTraffic,
    moment,
    reached,
)
from benchmarks.service.running import NEAR, ROOT
from companion.base.messages import Phase
from companion.link.codec import Codec, command_long, mavlink
from sitl.scenario.scenario import load_scenario

FLIES, FAILSAFE = (OFFBOARD, True), (POSCTL, True)
HOLD = (4 << 16 | 3 << 24, True)
STANDS = (POSCTL, False)


def seen(
    *modes: tuple[int, bool], setpoints: Iterable[float] = (), commands: Iterable[float] = ()
) -> SeenTraffic:
    """A heartbeat a second from 0 s, and what the app sent."""
    beats = [Beat(float(second), *mode) for second, mode in enumerate(modes)]
    return SeenTraffic(list(setpoints), [AppCommand(at_s, 176) for at_s in commands], beats)


# ---------------------------------------------------------------- moments


def test_moments_are_drawn_over_all_phases_of_a_flight() -> None:
    assert set(PHASES) <= set(Phase)
    for kind in KINDS:
        drawn = [moment(kind, seed) for seed in range(20)]
        assert {one.phase for one in drawn} == set(PHASES)
        assert all(0.0 <= one.delay_s <= PHASES[one.phase] for one in drawn)
        assert len({one.delay_s for one in drawn}) == len(drawn)
        assert drawn == [moment(kind, seed) for seed in range(20)]
    assert len({moment(kind, 0) for kind in KINDS}) == len(KINDS)


def test_a_phase_that_was_passed_over_counts_as_reached() -> None:
    assert reached("descend", "descend")
    assert reached("descend", "search")
    assert not reached("approach", "descend")
    assert not reached("abort", "descend")


def test_the_scenario_is_one_and_near() -> None:
    scenario = load_scenario(NEAR)
    assert scenario.companion["plan"]["mission"]["waypoint_ned_m"] == [2.0, 0.0]


# ---------------------------------------------------------------- the witness


def passed(message: object, *, from_app: bool) -> SeenTraffic:
    """What a witness notes of a message, as the line carries it."""
    noted = SeenTraffic()
    (decoded,) = Codec(1).decode(Codec(1, 191 if from_app else 1).encode(message))
    noted.take(decoded, 5.0, from_app=from_app)
    return noted


def test_a_witness_notes_setpoints_orders_and_heartbeats() -> None:
    setpoint = mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0, *[0.0] * 11)
    assert passed(setpoint, from_app=True).setpoints == [5.0]
    assert passed(setpoint, from_app=False).setpoints == []
    arm = command_long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), 1)
    assert passed(arm, from_app=True).commands == [AppCommand(5.0, 400)]
    asking = command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (32.0, 1e5), 1)
    assert passed(asking, from_app=True).commands == []
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 128 | 1, OFFBOARD, 4, 3)
    assert passed(beat, from_app=False).beats == [Beat(5.0, OFFBOARD, armed=True)]
    assert passed(beat, from_app=True).beats == []


# ---------------------------------------------------------------- the judge


def test_a_kill_is_safe_when_all_is_silent_and_the_failsafe_acts() -> None:
    good = seen(FLIES, FLIES, FLIES, FAILSAFE, STANDS, setpoints=[0.5, 1.5, 1.7], commands=[0.2])
    assert judging.killed(good, 1.5) == []
    assert judging.left_after_s(good, 1.5) == 1.5


@pytest.mark.parametrize(
    ("wrong", "found"),
    [
        (seen(FLIES, FLIES, FAILSAFE, setpoints=[2.0]), ["1 setpoints"]),
        (seen(FLIES, FLIES, FAILSAFE, commands=[2.0, 3.0]), ["commands 176"]),
        (seen(FLIES, FLIES, FLIES, FLIES, FLIES, FLIES), ["the autopilot's failsafe did not act"]),
        (seen(FLIES, FAILSAFE, STANDS, STANDS, FAILSAFE), ["armed"]),
    ],
)
def test_a_kill_is_unsafe_when(wrong: SeenTraffic, found: list[str]) -> None:
    assert judging.killed(wrong, 0.5) == found


def test_what_was_asked_before_a_kill_may_show_itself_after_it() -> None:
    assert judging.killed(seen(STANDS, HOLD, HOLD, commands=[0.4]), 0.5) == []


def test_a_stopped_process_that_goes_on_orders_nothing_against_the_failsafe() -> None:
    modes = (FLIES, FLIES, FLIES, FAILSAFE, FAILSAFE, FAILSAFE, FAILSAFE, FAILSAFE)
    assert judging.stopped(seen(*modes, setpoints=[0.9]), 1.0, 6.0) == []
    assert judging.stopped(seen(*modes, setpoints=[2.0]), 1.0, 6.0) == ["1 setpoints while it was stopped"]
    assert judging.stopped(seen(*modes, commands=[6.1]), 1.0, 6.0) == ["commands 176"]
    # granted just before, which the next heartbeat shows
    taken = (HOLD, HOLD, FLIES, FAILSAFE, *[FAILSAFE] * 5)
    assert judging.stopped(seen(*taken, commands=[6.1]), 1.5, 6.0) == ["commands 176"]
    # before control was ours it may go on with what it was ordered to
    assert judging.stopped(seen(*[HOLD] * 8, commands=[6.1]), 1.0, 6.0) == []


def test_a_service_that_is_ended_hands_back_in_time_with_its_exit_code() -> None:
    handed_back = seen(FLIES, FLIES, HOLD, HOLD, HOLD, setpoints=[0.5], commands=[1.1])
    assert judging.terminated(handed_back, 0.9, 1.2, 4, standby=False) == []
    assert judging.terminated(handed_back, 0.9, 1.2, 4, standby=True) == ["ended with 4"]
    assert judging.terminated(handed_back, 0.9, 1.2, -6, standby=False) == ["ended with -6"]
    assert judging.terminated(handed_back, -30.0, 1.2, 0, standby=False) == ["ended after 31 s"]
    assert judging.terminated(seen(STANDS, STANDS), 0.1, 0.3, 0, standby=True) == []


@pytest.mark.parametrize(
    ("wrong", "found"),
    [
        (seen(FLIES, FLIES, HOLD, HOLD, commands=[1.1, 2.0]), ["commands 176"]),
        # its setpoints stopped, and the failsafe had to act
        (seen(FLIES, FLIES, FAILSAFE, FAILSAFE), ["control was not handed back"]),
        # what was asked before the end was asked for is no handing back either
        (seen(FLIES, FLIES, HOLD, HOLD, commands=[0.5]), ["control was not handed back"]),
        (seen(FLIES, FLIES, HOLD, FAILSAFE, commands=[1.1]), ["the mode changed after the end"]),
        (seen(FLIES, FLIES, *[FLIES] * 5, commands=[1.1]), ["the autopilot's failsafe did not act"]),
        (seen(FLIES, FLIES, commands=[1.1]), ["nothing heard of the vehicle any more"]),
    ],
)
def test_a_service_that_is_ended_is_unsafe_when(wrong: SeenTraffic, found: list[str]) -> None:
    assert judging.terminated(wrong, 0.9, 1.2, 4, standby=False) == found


def test_the_end_may_take_as_long_as_the_unit_waits() -> None:
    unit = (ROOT / "systemd" / "companion.service").read_text(encoding="utf-8")
    assert f"TimeoutStopSec={judging.ENDS_WITHIN_S:.0f}\n" in unit


def log(path: Path, last_unix_s: float) -> bytes:
    """A log of a message a second over 5 s, as it stands on the disk after a kill: without its end."""
    path.parent.mkdir(parents=True)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=64)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channel = writer.register_channel("/x", "json", schema)
        for second in range(5):
            stamp_ns = int(1e9 * (last_unix_s - 4.0 + second))
            writer.add_message(channel, log_time=stamp_ns, publish_time=stamp_ns, data=b"{}")
            writer.flush()  # type: ignore[no-untyped-call]
    return path.read_bytes()


def test_a_killed_flights_log_has_to_read_back_to_its_last_second(tmp_path: Path) -> None:
    assert judging.log_missing(tmp_path, 99.5, 100.0) == []  # ordered half a second before
    assert judging.log_missing(tmp_path, 90.0, 100.0) == ["no log of 10.0 s"]
    path = tmp_path / "flight-0001" / "flight.mcap"
    whole = log(path, 99.6)
    assert judging.log_missing(tmp_path, 95.0, 100.0) == []
    assert judging.log_missing(tmp_path, 95.0, 102.0) == ["log misses 2.4 s"]
    assert judging.log_missing(tmp_path, 92.0, 100.0) == ["log misses 3.6 s"]  # its beginning
    path.write_bytes(whole[: len(whole) // 2])
    (found,) = judging.log_missing(tmp_path, 90.0, 100.0)
    assert found.startswith("log misses")
    path.write_bytes(b"")
    assert judging.log_missing(tmp_path, 90.0, 100.0) == ["log misses 10.0 s"]


# ---------------------------------------------------------------- going on


def trial(kind: Kind, seed: int, code: str, found: tuple[str, ...] = ()) -> InterruptedTrial:
    return InterruptedTrial(kind, seed, code, "descend", 12.3, 1.5, found)


def test_the_same_command_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flown: list[tuple[Kind, int]] = []

    def fly(kind: Kind, seed: int, code: str) -> InterruptedTrial:
        flown.append((kind, seed))
        if len(flown) == 3:
            raise NotFlown("too busy")
        return trial(kind, seed, code)

    command = ("--trials", "2", "--out", str(tmp_path))
    assert main(command, fly).exit_status == 1
    assert "kill 2, stop 2, term 1, 1 not flown; 0 unsafe FAILS" in capsys.readouterr().out
    assert main(command, fly).exit_status == 0
    assert flown == [(kind, seed) for seed in range(2) for kind in KINDS] + [("term", 0)]
    assert "kill 2, stop 2, term 2; 0 unsafe holds" in capsys.readouterr().out


def test_no_trial_begins_after_its_time_and_an_unsafe_one_fails_the_bar(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fly(kind: Kind, seed: int, code: str) -> InterruptedTrial:
        return trial(kind, seed, code, found=("armed",) if kind == "stop" else ())

    assert main(("--trials", "1", "--minutes", "-1", "--out", str(tmp_path)), fly).exit_status == 1
    assert "3 not flown" in capsys.readouterr().out
    assert main(("--trials", "1", "--out", str(tmp_path)), fly).exit_status == 1
    assert "kill 1, stop 1, term 1; 1 unsafe FAILS" in capsys.readouterr().out
