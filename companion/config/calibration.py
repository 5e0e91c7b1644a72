"""What the calibration tools write and the app reads."""

from __future__ import annotations

from pydantic import Field

from companion.config.reading import StrictModel


class Provenance(StrictModel):
    """Where a calibration comes from, for whoever wonders in a year; nothing is reckoned with it."""

    tool: str  # program and version
    source: str  # device, connection or file that the samples came from
    date: str  # ISO 8601, UTC, of the calibration
    samples: int = Field(ge=0)  # used
    dropped: int = Field(default=0, ge=0)  # left out as outliers
