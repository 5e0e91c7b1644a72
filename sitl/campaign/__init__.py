"""Campaigns: scenarios under many seeds, each run one of `companion --sitl --fast`, and what they came to."""

from typing import Final

# what the landings are measured by; `companion-sitl campaign` flies these unless told otherwise
SCENARIOS: Final = ("static", "line", "circle", "figure_8", "heave")
