"""What of a flight's numbers may be offered: those that predict a flight better than the assumed ones. Pure.

A fit gives numbers even where the flight's setpoints leave something open; then what they were fitted to,
the remains of whole windows, is explained better by numbers that fly worse. So each pair of gain and lag has
to predict the velocity half a second ahead better than the assumed pair, and the hover thrust has to be
nearer to what another flight shows: in the flight that it comes from, and in the other if there is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from companion.config import ConfigError
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
from companion.tools.identify.flight import DIRECTIONS, IdentificationLog

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
        """Whether the flight contradicts what is assumed."""
        return self.adopted != self.assumed

    @property
    def withheld(self) -> bool:
        """Whether it is not offered, since it predicts a flight worse."""
        return self.contradicts and not all(prediction.holds for prediction in self.predictions)

    @property
    def offered(self) -> IdentifiedResponse:
        """What there is reason to fly with."""
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
        """What there is reason to fly with."""
        return self.assumed if self.withheld else self.adopted


@dataclass(frozen=True, slots=True)
class Identified:
    """What one flight shows; a text where it does not show."""

    responses: dict[str, Judged | str]
    hover: JudgedHover | str

    @property
    def all_hold(self) -> bool:
        """Whether nothing was withheld."""
        judged = (*self.responses.values(), self.hover)
        return not any(each.withheld for each in judged if not isinstance(each, str))


def identify(
    record: IdentificationLog, data: ResponseRecord, other: tuple[str, ResponseRecord] | None
) -> Identified:
    """All that a flight shows, held against itself and against another flight (its name and rows).

    Raises:
        ConfigError: it shows nothing, or the other is too short.
    """
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
