"""The paper's figure 14: MPC, Riccati recursion and PID under disturbances."""

from typing import Final

# of the disturbances, for a command that needs no more than their names
CASE_NAMES: Final = ("nominal", "gust", "mass, inertia", "noise", "all")
