"""The process that flies for a campaign: every request is answered, whatever is asked and whatever fails."""

import asyncio
import io
import json
import sys
import time
from pathlib import Path

import pytest

from companion.app.command import Output
from companion.base.messages import Outcome
from companion.config import CONFIG_FOLDER, ConfigError
from companion.flightlog.result import Result, ResultEvent
from companion.sim import command, flights
from companion.sim.flights import Answer, Request, answer
from companion.sim.process import SimulatorError, SimulatorProcess
from companion.sim.runner import SitlFlight
from companion.sim.scoring import reason
from companion.sim.settings import sitl_settings, vehicle_differs
from companion.sim.trial import Trial
from sitl.campaign.rows import make_row
from sitl.campaign.worker import RunResult
from sitl.run.process_control import SimulationReport
from sitl.run.tick_timer import LATE_S, TickTimer
from tests.unit.sitl.campaign.campaign_parts import flight
from tests.unit.sitl.campaign.fake_flights import result


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"", "Invalid JSON"),
        (b'{"scenario": "static"}', "seed"),
        (b'{"scenario": "nosuch", "seed": 0}', "scenarios: no 'nosuch'"),
        (b'{"scenario": "static", "seed": 0, "config": "nosuch.yaml"}', "nosuch.yaml: cannot be read"),
    ],
)
def test_a_request_that_cannot_be_flown_is_refused_in_one_line(line: bytes, words: str) -> None:
    refused = answer(line).refused
    assert refused is not None
    assert words in refused
    assert "\n" not in refused


def test_a_fault_of_ours_is_reported_and_shown_in_full(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(_request: Request) -> Answer:
        raise ZeroDivisionError("of a bug")

    monkeypatch.setattr(flights, "fly_request", fails)
    assert answer(b'{"scenario": "static", "seed": 0}') == Answer(fault="ZeroDivisionError: of a bug")
    assert "Traceback" in capsys.readouterr().err


def test_an_answer_has_all_its_keys() -> None:
    said = json.loads(Answer(refused="no").model_dump_json())
    assert said == {"result": None, "reason": "", "touchdown_pad_m": None, "refused": "no", "fault": None}


def test_requests_are_handed_on_until_the_input_ends() -> None:
    told: list[object] = []
    flights._read(io.BytesIO(b"one\ntwo\n"), told.append, told.append)
    assert told == [b"one\n", b"two\n", 0]


# ----------------
# Why a flight did not land, as a campaign's row has it: what ended the mission, not how the hold ended.

SEARCH = "search: control granted: OFFBOARD"
HELD = "hold: pad disputed: camera's rotation: 45 deg apart"
RESTS = "abort: clear: at rest"
ABORTED = ("the app aborted",)


def row_reason(outcome: Outcome, failures: tuple[str, ...], *phases: str) -> str:
    texts = [("phase", text) for text in phases]
    said = [*texts[:1], ("climb", "climbing 1.0 m clear of the pad"), *texts[1:]]
    events = tuple(ResultEvent(time_s=1.0 + k, kind=kind, text=text) for k, (kind, text) in enumerate(said))
    report = SimulationReport(outcome, failures, None, 0.0, 30.0, 0.0, ())
    why = reason(Result.model_construct(outcome=outcome, events=events), SitlFlight(report, 1.0, 0.0))
    return make_row(RunResult(flight(1), 1.0, result(1, "static", outcome.value), why), "0.1.0").reason


@pytest.mark.parametrize(
    ("phases", "told"),
    [
        ((SEARCH, HELD, RESTS), "pad disputed: camera's rotation: 45 deg apart"),
        ((SEARCH, "abort: taken over: mode POSCTL"), "taken over: mode POSCTL"),
        # it went on from the first hold, which ended nothing
        (
            (SEARCH, "hold: link lost: 1.2 s", "search: link up: 0.1 s", "hold: stop requested: told", RESTS),
            "stop requested: told",
        ),
        ((), "the app aborted"),
    ],
)
def test_the_reason_of_an_aborted_flight_is_the_first_event_that_ended_it(
    phases: tuple[str, ...], told: str
) -> None:
    assert row_reason(Outcome.ABORTED, ABORTED, *phases) == told


def test_what_was_touched_stands_beside_it() -> None:
    touched = "touched 1.0 m off at 0.9 m/s"
    aborted = row_reason(Outcome.ABORTED, (*ABORTED, touched), SEARCH, HELD, RESTS)
    assert aborted == f"pad disputed: camera's rotation: 45 deg apart; {touched}"
    crashed = row_reason(Outcome.CRASHED, ("crashed", touched), SEARCH, HELD)
    assert crashed == f"pad disputed: camera's rotation: 45 deg apart; crashed; {touched}"


def test_a_flight_that_gave_nothing_up_has_what_it_failed_by_alone() -> None:
    went_on = (SEARCH, HELD, SEARCH, "landed: disarmed: by LAND")
    assert row_reason(Outcome.MISSED, ("0.9 m off",), *went_on) == "0.9 m off"
    assert row_reason(Outcome.LANDED, (), SEARCH, "landed: disarmed: by LAND") == ""


# ---------------- What is said of settings that describe another vehicle than the simulated one


def test_a_vehicle_like_the_airframe_is_not_reported() -> None:
    trial = Trial.load("line", 0)
    assert vehicle_differs(sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True), trial) is None


def test_a_vehicle_that_sits_otherwise_is_reported_with_what_differs(tmp_path: Path) -> None:
    text = (CONFIG_FOLDER / "vehicles" / "x500.yaml").read_text()
    other = tmp_path / "other.yaml"
    other.write_text(text.replace("camera_yaw_deg: 0.0", "camera_yaw_deg: 90.0"))
    trial = Trial.load("line", 0)
    # by the settings, and by the scenario's own overrides of them
    settings = tmp_path / "settings.yaml"
    settings.write_text("vehicle: other.yaml\n")
    scenario = trial.scenario.model_copy(update={"companion": {"vehicle": str(other)}})
    for config, told in (
        (settings, trial),
        (CONFIG_FOLDER / "companion.yaml", Trial(trial.path, scenario, 0)),
    ):
        said = vehicle_differs(sitl_settings(config, told, fast=True), told)
        assert said == (
            f"vehicle '{other}' is not the scenario's airframe 'x500': camera_yaw_deg 90.0 (simulated 0.0)"
        )


# ---------------- A machine too busy for real time is said while it flies, not at its end


async def test_a_tick_that_comes_too_late_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    timer = TickTimer(0.01)

    def tick() -> None:
        if timer.count == 5:
            raise EOFError
        time.sleep(1.2 * LATE_S)

    with pytest.raises(EOFError):
        await timer.run(tick)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].endswith(" s late: too busy a machine for real time")


@pytest.mark.parametrize(("late_s", "stands_still_s"), [(0.9 * LATE_S, 0.0), (1.1 * LATE_S, 1.1 * LATE_S)])
async def test_the_world_stands_still_only_where_that_is_said(late_s: float, stands_still_s: float) -> None:
    # the clock of a simulated autopilot that jumps makes the app's attitude wrong, and no real one's does
    timer = TickTimer(0.01)
    begun_s = timer.start_s
    for _ in range(3):
        timer.keep_pace(late_s)
    assert timer.start_s == pytest.approx(begun_s + 3 * stands_still_s, abs=1e-6)


async def test_what_the_simulator_says_in_flight_is_passed_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = tmp_path / "stderr"
    words.touch()
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", "input()", stdin=asyncio.subprocess.PIPE
    )
    watching = asyncio.create_task(SimulatorProcess(process, {}, words).watch())
    words.write_text("companion-sitl: 0.2 s late\n")
    async with asyncio.timeout(20.0):
        while "0.2 s late" not in capsys.readouterr().err:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    process.kill()
    with pytest.raises(SimulatorError, match="ended in flight"):
        await watching


def test_a_result_that_cannot_be_written_is_in_the_record_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("write_report", "result_table"):
        monkeypatch.setattr(command, name, lambda *_, **__: "")
    report = SimulationReport(Outcome.LANDED, (), None, 0.0, 30.0, 0.0, ())
    output = Output(tmp_path, Path("/dev/full"), live=False)
    trial, flown = Trial.load("static", 0), SitlFlight(report, 1.0, 0.0)
    landed = Result.model_construct(outcome=Outcome.LANDED)
    with pytest.raises(ConfigError, match="No space left"):
        command.publish(trial, landed, flown, output)
    assert (tmp_path / "result.json").exists()
