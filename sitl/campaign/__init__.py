"""Campaigns: scenarios under many seeds, each run one of `companion --sitl --fast`, and what they came to."""

from typing import Final

# the reference scenarios; the default of `companion-sitl campaign`
SCENARIOS: Final = ("static", "line", "circle", "figure_8", "heave")
