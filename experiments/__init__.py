"""What only the paper's figures and our own comparisons need."""

from typing import Final

# the scenarios in which the speed laws are compared
PROFILED: Final = ("static", "line", "circle")
