"""The report on a flight that has ended, and its transfer between processes."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

from companion.base.messages import ContactResult, Outcome, Truth


@dataclass(frozen=True, slots=True)
class SimulationReport:
    """How a flight ended by the truth, and the truth itself.

    `latest_tick_s` is how far the simulation fell behind the clock at worst: 0 in virtual time.
    `nearest_obstacle_m` is the least distance from the rotors' tips to an obstacle, None without any.
    `touchdown_pad_m` is where on the pad it came down: along the pad's heading and to its right. `contacts`
    have the truth's times; `as_built` is what was built against what was believed, None where all was
    believed rightly.
    """

    outcome: Outcome
    failures: tuple[str, ...]
    touchdown: dict[str, float] | None
    pad_speed_m_s: float
    duration_s: float
    latest_tick_s: float
    truth: tuple[Truth, ...]
    nearest_obstacle_m: float | None = None
    touchdown_pad_m: tuple[float, float] | None = None
    contacts: tuple[ContactResult, ...] = ()
    as_built: dict[str, float | list[float]] | None = None


def write_report(report: SimulationReport, path: Path) -> None:
    """Write a report as JSON."""
    path.write_bytes(TypeAdapter(SimulationReport).dump_json(report))


def read_report(path: Path) -> SimulationReport:
    """Read what `write_report` wrote.

    Raises:
        OSError: the file cannot be read.
        pydantic.ValidationError: it is something else.
    """
    return TypeAdapter(SimulationReport).validate_json(path.read_bytes())
