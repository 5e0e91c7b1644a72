"""What `--record` leaves behind, and that the usual tools read it."""

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from pymavlink import mavutil

from tests.scenario.flying import FlownCommand, SharedFlights, run

pytestmark = pytest.mark.slow

LOGS = {"flight.mcap", "flight.tlog", "result.json", "report.html", "settings.yaml"}
TOPICS = {
    *("/imu", "/mag", "/gps", "/range", "/camera", "/sighting", "/frame_report", "/vehicle", "/pad", "/plan"),
    *("/setpoint", "/control_report", "/action", "/action_result", "/notice", "/truth"),
}


@pytest.fixture(scope="module")
def recorded(shared_flights: SharedFlights) -> tuple[Path, FlownCommand]:
    return shared_flights.recorded()


def test_all_files_are_there(recorded: tuple[Path, FlownCommand]) -> None:
    record, flown = recorded
    assert {path.name for path in record.iterdir()} == LOGS
    assert json.loads((record / "result.json").read_text()) == flown.landing
    assert str(record) in flown.stdout


def test_the_log_holds_every_topic_in_order_of_time(recorded: tuple[Path, FlownCommand]) -> None:
    record, flown = recorded
    times: list[int] = []
    with (record / "flight.mcap").open("rb") as stream:
        reader = make_reader(stream)
        counts: dict[str, int] = {}
        for _schema, channel, message in reader.iter_messages(log_time_order=False):
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            assert json.loads(message.data)
            if channel.topic == "/plan":
                times.append(message.log_time)
    assert counts.keys() >= TOPICS
    assert times == sorted(times)
    seconds = flown.landing["time"]["total_s"]
    assert counts["/imu"] == pytest.approx(200 * seconds, rel=0.05)
    assert counts["/camera"] == pytest.approx(5 * seconds, rel=0.1)


def test_the_tlog_holds_both_directions(recorded: tuple[Path, FlownCommand]) -> None:
    record, _ = recorded
    log = mavutil.mavlink_connection(str(record / "flight.tlog"))
    heard: dict[tuple[int, int], set[str]] = {}
    while (message := log.recv_match()) is not None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        heard.setdefault(sender, set()).add(message.get_type())
    assert {"HEARTBEAT", "COMMAND_ACK"} <= heard[1, 1]
    assert {"HEARTBEAT", "COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED"} <= heard[1, 191]


def test_a_replay_gives_the_flights_estimates_again_to_the_bit(
    recorded: tuple[Path, FlownCommand], tmp_path: Path
) -> None:
    record, flown = recorded
    replayed = run("replay", record, "-o", tmp_path, result=tmp_path / "replay.json")
    assert replayed.code == 0, replayed
    assert replayed.result is not None
    assert replayed.result["repetition"]["identical"], replayed
    truth = replayed.result["errors"]["truth"]
    # the flight's own result draws the line between ground and air a sample elsewhere
    told = flown.landing["estimate"]
    assert truth["attitude_deg"]["rms"] == pytest.approx(told["attitude_rmse_deg"], rel=0.02)
    assert truth["velocity_m_s"]["rms"] == pytest.approx(told["velocity_rmse_m_s"], rel=0.02)
