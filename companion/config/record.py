"""How much room the flight logs may take."""

from __future__ import annotations

from pydantic import Field

from companion.config.reading import StrictModel


class RecordConfig(StrictModel):
    """What is looked at before a flight's log begins: the oldest flights are removed first."""

    total_mb: float = Field(default=8000.0, ge=100.0)  # of all flights together
    free_mb: float = Field(default=1000.0, ge=0.0)  # that stay free on the disk
