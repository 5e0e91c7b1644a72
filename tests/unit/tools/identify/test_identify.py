"""`companion identify`: from a log to lines for the settings, and what it says of logs that tell nothing."""

import math
from pathlib import Path

import numpy as np
import pytest
import typer

from companion.base.geometry import IDENTITY
from companion.base.messages import ControlReport, Phase, PlanStep, Setpoint, VehicleState
from companion.config import (
    CONFIG_FOLDER,
    CompanionConfig,
    ConfigError,
    VehicleConfig,
    load_config,
    load_vehicle,
)
from companion.control.response.identification import IdentifiedResponse, ResponseEstimate
from companion.flightlog.record import FlightLog
from companion.tools.commands import identify_command
from companion.tools.identify import judge
from companion.tools.identify.judge import read_flight
from tests.unit.control.controller_inputs import vehicle_state

PERIOD_S = 1.0 / 30.0
HOVER_THRUST = 0.56


def _config(setpoint: str) -> tuple[CompanionConfig, VehicleConfig]:
    config = load_config(CONFIG_FOLDER / "companion.yaml")
    control = config.control.model_copy(update={"setpoint": setpoint})
    return config.model_copy(update={"control": control}), load_vehicle("x500", None, config.camera)


def _state(time_s: float, velocity_m_s: float, acceleration_m_s2: float) -> VehicleState:
    velocity, acceleration = (velocity_m_s, 0.0, 0.0), (acceleration_m_s2, 0.0, 0.0)
    return vehicle_state(time_s, velocity_ned_m_s=velocity, acceleration_ned_m_s2=acceleration)


def _record(
    folder: Path, setpoint: str, *, lag_s: float = 0.3, seconds: float = 20.0, autopilot_kind: str = "px4"
) -> Path:
    """A flight that sways north, recorded as the app does."""
    log, (config, vehicle) = FlightLog(folder, 0.0), _config(setpoint)
    log.write_settings(config=config, vehicle=vehicle)
    v = a = 0.0
    by_attitude = setpoint == "attitude" or autopilot_kind == "ardupilot"
    heeded = setpoint == "velocity"
    rng = np.random.default_rng(1)
    for k in range(round(seconds / PERIOD_S)):
        now_s = k * PERIOD_S
        wanted = 1.5 * math.sin(2.3 * now_s) + math.sin(5.1 * now_s + 1.0)
        offset = 0.0 if by_attitude else 0.5 * math.sin(1.3 * now_s)
        log.write("plan", PlanStep(now_s, Phase.APPROACH), now_s)
        log.write("vehicle", _state(now_s, v + rng.normal(0.0, 0.004), a), now_s)
        sent = Setpoint(
            now_s,
            velocity_ned_m_s=(v + offset, 0.0, 0.0),
            acceleration_ned_m_s2=(wanted, 0.0, 0.0),
            attitude=IDENTITY if by_attitude else None,
            thrust=HOVER_THRUST * math.hypot(1.0, a / 9.80665) if by_attitude else None,
            holds_horizontal_velocity=heeded,
        )
        log.write("setpoint", sent, now_s)
        report = ControlReport(now_s, solved=True, iterations=20, solve_s=0.0, hover_thrust=0.55)
        log.write("control_report", report, now_s)
        for _ in range(4):
            a += (wanted + (2.2 if heeded else 0.0) * offset - a) / lag_s * PERIOD_S / 4
            v += a * PERIOD_S / 4
    log.close()
    return folder


def run(log: Path, check: Path | None = None) -> int:
    """The command's exit code."""
    with pytest.raises(typer.Exit) as ended:
        identify_command(log, check=check)
    return ended.value.exit_code


def test_by_velocity_the_lag_goes_into_the_settings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight, other = (_record(tmp_path / name, "velocity") for name in ("one", "two"))
    assert run(flight, check=other) == 0
    said = capsys.readouterr().out
    lag = next(line for line in said.splitlines() if "autopilot_lag_s" in line)
    assert float(lag.split(":")[1]) == pytest.approx(0.3, abs=0.06)
    checked = next(
        line for line in said.splitlines() if "half a second ahead in" in line and str(other) in line
    )
    now, before = (
        float(word)
        for word in checked.removeprefix("velocity sideways").split(": ")[1].split()
        if word.startswith("0.")
    )
    assert now < before
    assert "hover thrust: no thrust in the log" in said


def test_by_attitude_hover_thrust_goes_into_the_vehicle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(_record(tmp_path / "one", "attitude")) == 0
    said = capsys.readouterr().out
    hover = next(line for line in said.splitlines() if line.startswith("hover_thrust:"))
    assert float(hover.split(":")[1]) == pytest.approx(HOVER_THRUST, rel=0.02)
    assert "configs/vehicles/x500.yaml" in said
    assert "0.550" in said  # as learnt in flight


def test_by_the_shipped_settings_the_setpoints_tell_what_was_sent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN flights by `auto`: PX4 gets accelerations, ArduPilot attitudes
    px4, ardupilot = (_record(tmp_path / name, "auto", autopilot_kind=name) for name in ("px4", "ardupilot"))
    assert run(px4) == 0
    said = capsys.readouterr().out
    assert "by acceleration setpoints" in said
    assert "sideways: velocity gain" not in said
    lag = next(line for line in said.splitlines() if line.startswith("acceleration_time_constant_s"))
    assert float(lag.split(":")[1]) == pytest.approx(0.3, abs=0.06)
    assert "autopilot_lag_s" not in said
    assert read_flight(ardupilot).control.setpoint == "attitude"
    assert read_flight(ardupilot).starting_points()["sideways"].gain_1_s == 0.0


def test_a_number_that_predicts_its_own_flight_worse_is_withheld(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a fit that is sure of a lag that the flight does not have, as one is whose setpoints answer gusts
    flight = _record(tmp_path / "one", "acceleration", lag_s=0.11)
    wrong = ResponseEstimate(IdentifiedResponse(0.0, 0.314), 0.0, 0.03, windows=38)
    monkeypatch.setattr(judge, "fit", lambda *_: wrong)
    assert run(flight) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "withheld: what was found predicts this flight no better than what is assumed" in said
    assert "nothing is offered" in said
    assert "acceleration_time_constant_s" not in said


def test_a_number_that_predicts_another_flight_worse_is_withheld(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a flight that shows a lag of 0.3 s, and another in which the vehicle answers as assumed
    flight = _record(tmp_path / "slow", "acceleration", lag_s=0.3)
    assumed_s = read_flight(flight).starting_points()["sideways"].lag_s
    other = _record(tmp_path / "as_assumed", "acceleration", lag_s=assumed_s)
    assert run(flight) == 0
    assert "acceleration_time_constant_s: 0.2" in capsys.readouterr().out
    assert run(flight, check=other) == 1
    said = capsys.readouterr().out
    assert f"sideways: withheld: what was found predicts {other} no better than what is assumed" in " ".join(
        said.split()
    )
    assert "acceleration_time_constant_s" not in said


def test_a_hover_thrust_that_another_flight_contradicts_is_withheld(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = _record(tmp_path / "one", "attitude")
    assumed = read_flight(flight).vehicle.hover_thrust
    monkeypatch.setattr("tests.unit.tools.identify.test_identify.HOVER_THRUST", assumed)
    other = _record(tmp_path / "other", "attitude")
    assert run(flight, check=other) == 1
    said = capsys.readouterr().out
    assert "hover thrust: withheld: the other flight is nearer to what is assumed" in said
    assert "hover_thrust:" not in said


def test_what_tells_nothing_ends_in_one_line(tmp_path: Path) -> None:
    short = _record(tmp_path / "short", "velocity", seconds=3.0)
    with pytest.raises(ConfigError, match=r"short: \d windows of 1 s of flight by setpoints, expected 10"):
        identify_command(short)
    with pytest.raises(
        ConfigError, match=r"nowhere: cannot be read: No such file or directory; expected a flight's folder,"
    ):
        identify_command(tmp_path / "nowhere")
    bare = FlightLog(tmp_path / "bare", 0.0)
    bare.close()
    with pytest.raises(ConfigError, match="no settings in it"):
        read_flight(tmp_path / "bare")
    flight = _record(tmp_path / "one", "velocity", seconds=12.0)
    other = _record(tmp_path / "other", "attitude", seconds=12.0)
    with pytest.raises(ConfigError, match="by attitude setpoints; expected the same kind"):
        identify_command(flight, check=other)


def test_setpoints_that_were_not_obeyed_do_not_count(tmp_path: Path) -> None:
    log, (config, vehicle) = FlightLog(tmp_path / "waiting", 0.0), _config("velocity")
    log.write_settings(config=config, vehicle=vehicle)
    for k in range(300):
        now_s = k * PERIOD_S
        log.write("plan", PlanStep(now_s, Phase.SEARCH), now_s)
        log.write("vehicle", _state(now_s, 0.0, 0.0), now_s)
        log.write("setpoint", Setpoint(now_s), now_s)
        log.write("control_report", ControlReport(now_s, True, 1, 0.0, obeyed=False), now_s)
    log.close()
    with pytest.raises(ConfigError, match="no flight by setpoints in it"):
        identify_command(tmp_path / "waiting")
