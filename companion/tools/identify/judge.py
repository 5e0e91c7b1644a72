"""What of a flight's numbers may be offered: those that predict a flight better than the assumed ones. Pure.

A fit gives numbers even where the flight's setpoints leave something open; then what they were fitted to,
the remains of whole windows, is explained better by numbers that fly worse. So each pair of gain and lag has
to predict the velocity half a second ahead better than the assumed pair, and the hover thrust has to be
nearer to what another flight shows: in the flight that it comes from, and in the other if there is one.

The flight is what the app recorded (flight.mcap): its own estimates, the setpoints as they left, and when the
autopilot obeyed, on an even grid. NED, SI units.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.base.messages import Phase
from companion.config import CompanionConfig, ConfigError, ControlConfig, VehicleConfig, validate_recorded
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
from companion.flightlog.log_file import LogReader

TOPICS: Final = ("vehicle", "setpoint", "plan", "control_report")
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
        return self.control.setpoint == "attitude"

    def starting_points(self) -> dict[str, IdentifiedResponse]:
        by_velocity = self.control.setpoint == "velocity"
        gains = velocity_gains(self.vehicle, self.control, self.autopilot_kind, sideways=by_velocity)
        tau = lags(self.vehicle, self.control, self.autopilot_kind)
        return {name: IdentifiedResponse(gains[axes[0]], tau[axes[0]]) for name, axes in DIRECTIONS.items()}


def read_flight(path: Path) -> IdentificationLog:
    """Read the topics that show how the vehicle answered."""
    reader = LogReader(path)
    messages: dict[str, list[dict[str, Any]]] = {topic: [] for topic in TOPICS}
    for topic, message in reader.messages():
        if topic in TOPICS:
            messages[topic].append(reader.content(topic, message))
    path, settings = reader.path, reader.settings
    if not {"config", "vehicle"} <= settings.keys():
        raise ConfigError(f"{path}: no settings in it; expected a flight.mcap that `--record` left")
    config = validate_recorded(CompanionConfig, settings["config"], f"{path}: config")
    vehicle = validate_recorded(VehicleConfig, settings["vehicle"], f"{path}: vehicle")
    # in a flight by `auto` the setpoints show whose autopilot it was: PX4 is sent no attitudes then
    by_attitude = any(row.get("attitude") is not None for row in messages["setpoint"])
    autopilot_kind: AutopilotKind = (
        "ardupilot" if by_attitude and config.control.setpoint == "auto" else "px4"
    )
    return IdentificationLog(resolved(config.control, autopilot_kind), vehicle, messages, autopilot_kind)


def flown(record: IdentificationLog, path: Path) -> ResponseRecord:
    """The flight on an even grid at the setpoints' rate."""
    vehicles, setpoints = record.messages["vehicle"], record.messages["setpoint"]
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
    phases = {plan["time_s"]: plan["phase"] for plan in record.messages["plan"]}
    reports = [report for report in record.messages["control_report"] if report.get("obeyed", True)]
    times_s = [report["time_s"] for report in reports if phases.get(report["time_s"]) in IN_THE_AIR]
    return np.array(times_s)


def _pieces(time_s: FloatArray, obeyed_s: FloatArray) -> tuple[tuple[int, int], ...]:
    """Rows [first, last) of the runs in which no two cycles lie far apart."""
    breaks = np.flatnonzero(np.diff(obeyed_s) > LONGEST_STEP_S)
    begins, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(obeyed_s) - 1]])
    places = np.searchsorted(time_s, np.stack([obeyed_s[begins], obeyed_s[ends]], axis=1))
    return tuple((int(first), int(last)) for first, last in places)


# ---------------------------------------------------------------- what may be offered

OWN: Final = "this flight"


@dataclass(frozen=True, slots=True)
class Prediction:
    """Errors of the numbers found and of those assumed, over one flight: m/s rms half a second ahead."""

    flight: str
    found: float
    assumed: float

    @property
    def holds(self) -> bool:
        """Whether the numbers found are the better ones."""
        return self.found < self.assumed


@dataclass(frozen=True, slots=True)
class Judged:
    """One direction's response: as found, what would be adopted of it, and how that predicts flights."""

    assumed: IdentifiedResponse
    estimate: ResponseEstimate
    adopted: IdentifiedResponse
    predictions: tuple[Prediction, ...]

    @property
    def contradicts(self) -> bool:
        return self.adopted != self.assumed

    @property
    def withheld(self) -> bool:
        """Whether it is not offered, since it predicts a flight worse."""
        return self.contradicts and not all(prediction.holds for prediction in self.predictions)

    @property
    def offered(self) -> IdentifiedResponse:
        return self.assumed if self.withheld else self.adopted


@dataclass(frozen=True, slots=True)
class JudgedHover:
    """The hover thrust as found with its standard deviation, as assumed, and as another flight shows it."""

    assumed: float
    found: float
    std: float
    other: float | None = None

    @property
    def adopted(self) -> float:
        """What the flight alone would have."""
        return adopted(self.found, self.std, self.assumed)

    @property
    def withheld(self) -> bool:
        """Whether another flight is nearer to what is assumed."""
        contradicts = self.adopted != self.assumed
        return (
            contradicts
            and self.other is not None
            and (abs(self.adopted - self.other) >= abs(self.assumed - self.other))
        )

    @property
    def offered(self) -> float:
        return self.assumed if self.withheld else self.adopted


@dataclass(frozen=True, slots=True)
class Identified:
    """What one flight shows; a text where it does not show."""

    responses: dict[str, Judged | str]
    hover: JudgedHover | str

    @property
    def all_hold(self) -> bool:
        judged = (*self.responses.values(), self.hover)
        return not any(each.withheld for each in judged if not isinstance(each, str))


def identify(
    record: IdentificationLog, data: ResponseRecord, other: tuple[str, ResponseRecord] | None
) -> Identified:
    """All that a flight shows, held against itself and against another flight (its name and rows)."""
    delay_s, responses = record.control.command_delay_s, dict[str, Judged | str]()
    for name, axes in DIRECTIONS.items():
        assumed = record.starting_points()[name]
        try:
            cut = windows(data, axes, delay_s)
            estimate = fit(cut, assumed)
        except TooLittleError as error:
            responses[name] = str(error)
            continue
        now = estimate.adopted(assumed)
        flights = [(OWN, cut)]
        if other is not None:
            try:
                flights.append((other[0], windows(other[1], axes, delay_s)))
            except TooLittleError as error:
                raise ConfigError(f"--check {other[0]}: {error}") from error
        predictions = tuple(
            Prediction(flight, *(prediction_error_m_s(each, numbers) for numbers in (now, assumed)))
            for flight, each in flights
        )
        responses[name] = Judged(assumed, estimate, now, predictions)
    hover = _hover(record, data, None if other is None else other[1])
    if all(isinstance(each, str) for each in (*responses.values(), hover)):
        raise ConfigError(str(responses["sideways"]))
    return Identified(responses, hover)


def _hover(
    record: IdentificationLog, data: ResponseRecord, other: ResponseRecord | None
) -> JudgedHover | str:
    try:
        found, std = hover_thrust(data)
    except TooLittleError as error:
        return str(error)
    try:
        elsewhere = None if other is None else hover_thrust(other)[0]
    except TooLittleError:
        elsewhere = None
    return JudgedHover(record.vehicle.hover_thrust, found, std, elsewhere)


def is_open(std: float) -> bool:
    """Whether a number is as assumed because the flight leaves it open."""
    return math.isinf(std)
