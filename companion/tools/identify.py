"""`companion identify`: a flight in, the flight model's numbers and their lines for the settings out.

Reads what the app recorded (flight.mcap): its own estimates, the setpoints as they left, and when the
autopilot obeyed. NED, SI units; the fits are `companion.control.response.identification`.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from mcap.records import Channel, Message, Metadata
from rich.console import Console
from rich.table import Table

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.base.messages import Phase
from companion.config import CompanionConfig, ConfigError, ControlConfig, VehicleConfig, validate
from companion.control.response.flight_model import lags, velocity_gains
from companion.control.response.identification import (
    IdentifiedResponse,
    ResponseEstimate,
    ResponseRecord,
    TooLittleError,
    adopted,
    fit,
    hover_thrust,
    prediction_error_m_s,
    windows,
)
from companion.control.setpoints import resolved
from companion.flightlog.log_file import SETTINGS_RECORD, log_file, records

HELP: Final = """Hover thrust and the autopilot's response, from a recorded flight.

LOG is a flight's folder or its flight.mcap. Prints what it finds with its standard deviations, and the lines
for configs/vehicles and the settings; writes nothing.

\b
companion identify flights/circle
companion identify flights/circle --check flights/line
"""
TOPICS: Final = {"/vehicle", "/setpoint", "/plan", "/control_report"}
# low over the ground, or on it, other forces act than the model knows
IN_THE_AIR: Final = {Phase.ROUTE.value, Phase.SEARCH.value, Phase.APPROACH.value, Phase.DESCEND.value}
LONGEST_STEP_S: Final = 0.2
DIRECTIONS: Final[dict[str, tuple[int, ...]]] = {"sideways": (0, 1), "down": (2,)}


@dataclass
class IdentificationLog:
    """What the log says: the settings that were flown with, and messages by topic in their order.

    `control.setpoint` is the kind that was sent, and `autopilot_kind` whose autopilot it was sent to.
    """

    control: ControlConfig
    vehicle: VehicleConfig
    messages: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    autopilot_kind: AutopilotKind = "px4"

    @property
    def by_attitude(self) -> bool:
        """Whether attitude and thrust were sent."""
        return self.control.setpoint == "attitude"

    def starting_points(self) -> dict[str, IdentifiedResponse]:
        """The responses that the settings assume."""
        by_velocity = self.control.setpoint == "velocity"
        gains = velocity_gains(self.vehicle, self.control, self.autopilot_kind, sideways=by_velocity)
        tau = lags(self.vehicle, self.control, self.autopilot_kind)
        return {name: IdentifiedResponse(gains[axes[0]], tau[axes[0]]) for name, axes in DIRECTIONS.items()}


@dataclass(frozen=True)
class IdentificationResult:
    """What one flight shows; a text where it does not show."""

    responses: dict[str, ResponseEstimate | str]
    hover: tuple[float, float] | str
    learnt_hover_thrust: float | None


def identify_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The flight.", show_default=False)],
    *,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Another flight, to hold the numbers against.", metavar="LOG"),
    ] = None,
) -> None:
    """Read, fit and show.

    Raises:
        ConfigError: something the user can correct; also when the flight shows nothing at all.
    """
    record = read_flight(log)
    found = identify(record, log)
    console = Console()
    grid, lines = _table(record, found)
    console.print(grid)
    lines += settings_lines(record, found)
    if check is not None:
        lines += check_lines(read_flight(check), record, found, check)
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def read_flight(path: Path) -> IdentificationLog:
    """Read the topics that show how the vehicle answered.

    Raises:
        ConfigError: it is not a flight of ours.
    """
    path = log_file(path)
    topics: dict[int, str] = {}
    messages: dict[str, list[dict[str, Any]]] = {topic: [] for topic in TOPICS}
    settings: dict[str, str] = {}
    try:
        with path.open("rb") as stream:
            for item in records(stream, lambda: None):
                if isinstance(item, Channel):
                    topics[item.id] = item.topic
                elif isinstance(item, Metadata) and item.name == SETTINGS_RECORD:
                    settings = item.metadata
                elif isinstance(item, Message) and topics[item.channel_id] in TOPICS:
                    messages[topics[item.channel_id]].append(json.loads(item.data))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; expected a flight.mcap") from error
    if not {"config", "vehicle"} <= settings.keys():
        raise ConfigError(f"{path}: no settings in it; expected a flight.mcap that `--record` left")
    config = validate(CompanionConfig, json.loads(settings["config"]), f"{path}: config")
    vehicle = validate(VehicleConfig, json.loads(settings["vehicle"]), f"{path}: vehicle")
    # in a flight by `auto` the setpoints show whose autopilot it was: PX4 is sent no attitudes then
    by_attitude = any(row.get("attitude") is not None for row in messages["/setpoint"])
    autopilot_kind: AutopilotKind = (
        "ardupilot" if by_attitude and config.control.setpoint == "auto" else "px4"
    )
    return IdentificationLog(resolved(config.control, autopilot_kind), vehicle, messages, autopilot_kind)


def flown(record: IdentificationLog, path: Path) -> ResponseRecord:
    """The flight on an even grid at the setpoints' rate.

    Raises:
        ConfigError: the autopilot never obeyed setpoints in it.
    """
    vehicles, setpoints = record.messages["/vehicle"], record.messages["/setpoint"]
    obeyed = _obeyed_times(record)
    if len(obeyed) < 2 or len(vehicles) < 2:
        raise ConfigError(f"{path}: no flight by setpoints in it; expected one to a pad, or a search for one")
    period_s = 1.0 / record.control.rate_hz
    time_s = np.arange(obeyed[0], obeyed[-1], period_s)

    def column(rows: list[dict[str, Any]], key: str) -> FloatArray:
        at = [row["time_s"] for row in rows]
        values = np.array([row[key] for row in rows], dtype=float).reshape(len(rows), -1)
        return np.stack([np.interp(time_s, at, each) for each in values.T], axis=1)

    acceleration = column(vehicles, "acceleration_ned_m_s2")
    return ResponseRecord(
        time_s=time_s,
        velocity_ned_m_s=column(vehicles, "velocity_ned_m_s"),
        force_m_s2=np.linalg.norm(acceleration - np.array([0.0, 0.0, GRAVITY_M_S2]), axis=1),
        command_velocity_ned_m_s=column(setpoints, "velocity_ned_m_s"),
        command_acceleration_ned_m_s2=column(setpoints, "acceleration_ned_m_s2"),
        thrust=column(setpoints, "thrust")[:, 0] if record.by_attitude else None,
        pieces=_pieces(time_s, obeyed),
    )


def _obeyed_times(record: IdentificationLog) -> FloatArray:
    """Times of the cycles in which the autopilot obeyed, in the air."""
    phases = {plan["time_s"]: plan["phase"] for plan in record.messages["/plan"]}
    reports = [report for report in record.messages["/control_report"] if report.get("obeyed", True)]
    times_s = [report["time_s"] for report in reports if phases.get(report["time_s"]) in IN_THE_AIR]
    return np.array(times_s)


def _pieces(time_s: FloatArray, obeyed_s: FloatArray) -> tuple[tuple[int, int], ...]:
    """Rows [first, last) of the runs in which no two cycles lie far apart."""
    breaks = np.flatnonzero(np.diff(obeyed_s) > LONGEST_STEP_S)
    begins, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(obeyed_s) - 1]])
    places = np.searchsorted(time_s, np.stack([obeyed_s[begins], obeyed_s[ends]], axis=1))
    return tuple((int(first), int(last)) for first, last in places)


def identify(record: IdentificationLog, path: Path) -> IdentificationResult:
    """All that a flight shows.

    Raises:
        ConfigError: it shows nothing.
    """
    data, responses = flown(record, path), dict[str, ResponseEstimate | str]()
    for name, axes in DIRECTIONS.items():
        try:
            cut = windows(data, axes, record.control.command_delay_s)
            responses[name] = fit(cut, record.starting_points()[name])
        except TooLittleError as error:
            responses[name] = str(error)
    try:
        hover: tuple[float, float] | str = hover_thrust(data)
    except TooLittleError as error:
        hover = str(error)
    if not any(isinstance(each, ResponseEstimate) for each in responses.values()) and isinstance(hover, str):
        raise ConfigError(f"{path}: {responses['sideways']}")
    learnt = record.messages["/control_report"][-1].get("hover_thrust") if record.by_attitude else None
    return IdentificationResult(responses, hover, learnt)


# ---------------------------------------------------------------- what is shown


def _table(record: IdentificationLog, found: IdentificationResult) -> tuple[Table, list[str]]:
    """What was found, and why the rest was not."""
    notes: list[str] = []
    grid = Table(title=f"How {record.vehicle.name} answers, by {record.control.setpoint} setpoints")
    for heading in ("", "assumed", "found", "standard deviation", "from"):
        grid.add_column(heading, justify="left" if not heading else "right")
    for name, assumed in record.starting_points().items():
        estimate = found.responses[name]
        if isinstance(estimate, str):
            notes.append(f"{name}: {estimate}")
            continue
        best, count = estimate.response, f"{estimate.windows} windows"
        if assumed.gain_1_s > 0.0:
            gain, std = f"{best.gain_1_s:.2f} 1/s", f"{estimate.gain_std_1_s:.2f}"
            if math.isinf(estimate.gain_std_1_s):
                gain, std = "as assumed", "too little excitation"
            grid.add_row(f"{name}: velocity gain", f"{assumed.gain_1_s:.2f} 1/s", gain, std, count)
        lag, std = f"{best.lag_s:.3f} s", f"{estimate.lag_std_s:.3f}"
        grid.add_row(f"{name}: lag", f"{assumed.lag_s:.3f} s", lag, std, count)
    assumed_hover = f"{record.vehicle.hover_thrust:.3f}"
    if isinstance(found.hover, str):
        notes.append(f"hover thrust: {found.hover}")
    else:
        grid.add_row(
            "hover thrust", assumed_hover, f"{found.hover[0]:.3f}", f"{found.hover[1]:.4f}", "thrust"
        )
    if found.learnt_hover_thrust is not None:
        grid.add_row("hover thrust, learnt in flight", assumed_hover, f"{found.learnt_hover_thrust:.3f}")
    return grid, notes


def settings_lines(record: IdentificationLog, found: IdentificationResult) -> list[str]:
    """The lines for the vehicle's file and the settings."""
    vehicle, control = _numbers(record, found)
    lines = []
    if vehicle:
        lines += [f"# configs/vehicles/{record.vehicle.name}.yaml", *_yaml(vehicle)]
    if control:
        lines += ["# the app's settings", "control:", *(f"  {line}" for line in _yaml(control))]
    return lines or ["nothing found contradicts the settings: they may stay as they are"]


def _numbers(
    record: IdentificationLog, found: IdentificationResult
) -> tuple[dict[str, float], dict[str, float]]:
    """Settings of the vehicle and of control by their names."""
    vehicle, control = dict[str, float](), dict[str, float]()
    by_velocity = record.control.setpoint == "velocity"
    if not isinstance(found.hover, str):
        hover = adopted(*found.hover, record.vehicle.hover_thrust)
        if hover != record.vehicle.hover_thrust:
            vehicle["hover_thrust"] = hover
    for name, own_lag, gain, lag in (
        ("sideways", "acceleration_time_constant_s", "autopilot_velocity_gain_1_s", "autopilot_lag_s"),
        ("down", "thrust_time_constant_s", "autopilot_climb_gain_1_s", "autopilot_climb_lag_s"),
    ):
        estimate = found.responses[name]
        if isinstance(estimate, str):
            continue
        assumed = record.starting_points()[name]
        now = estimate.adopted(assumed)
        if now.gain_1_s != assumed.gain_1_s:
            control[gain] = now.gain_1_s
        if now.lag_s != assumed.lag_s:
            numbers, key = (control, lag) if by_velocity else (vehicle, own_lag)
            numbers[key] = now.lag_s
    return vehicle, control


def _yaml(numbers: dict[str, float]) -> list[str]:
    return [f"{name}: {value:.3f}" for name, value in numbers.items()]


def check_lines(
    other: IdentificationLog, record: IdentificationLog, found: IdentificationResult, path: Path
) -> list[str]:
    """How well the numbers predict another flight's velocity half a second ahead, beside the settings' own.

    Raises:
        ConfigError: the other flight went by other setpoints, or is too short.
    """
    if other.control.setpoint != record.control.setpoint:
        raise ConfigError(f"--check {path}: by {other.control.setpoint} setpoints; expected the same kind")
    data, lines = flown(other, path), []
    for name, axes in DIRECTIONS.items():
        estimate = found.responses[name]
        if isinstance(estimate, str):
            continue
        try:
            cut = windows(data, axes, other.control.command_delay_s)
        except TooLittleError as error:
            raise ConfigError(f"--check {path}: {error}") from error
        assumed = record.starting_points()[name]
        now, before = (prediction_error_m_s(cut, each) for each in (estimate.adopted(assumed), assumed))
        lines.append(
            f"velocity {name}, half a second ahead in {path}: {now:.3f} m/s rms, {before:.3f} as assumed"
        )
    return lines
