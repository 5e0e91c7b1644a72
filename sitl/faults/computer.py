"""The companion computer as far as a scenario's faults change it; a harness applies it to the app."""

from __future__ import annotations

from typing import Literal

SolverFault = Literal["none", "infeasible", "late", "nan"]


class ComputerFaults:
    """What goes wrong there at present."""

    def __init__(self) -> None:
        self.clear_faults()

    def clear_faults(self) -> None:
        """All well."""
        self.solver: SolverFault = "none"
        self.imu_nan = False
        self.disk_full = False
        self.disk_write_s = 0.0
