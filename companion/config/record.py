"""How much room the flight logs may take."""

from pydantic import Field

from companion.config.reading import StrictModel


class RecordConfig(StrictModel):
    """What is looked at before a flight's log begins: the oldest flights are removed first."""

    total_mb: float = Field(default=8000.0, ge=100.0)
    """Size of all recorded flights together (10⁶ bytes); the oldest are removed before a flight's log
    begins, the newest is kept. A minute of flight takes about 25. Raise it on a large disk, lower it on a
    small one"""
    free_mb: float = Field(default=1000.0, ge=0.0)
    """The oldest flights are also removed until this much is free on the disk; raise it if other programs
    need the disk"""
