"""Two sources of a quantity that differ, for the planner's tests."""

from typing import Final

from companion.base.messages import Quantity, SourceComparison

STD: Final = 0.5


def differ(quantity: Quantity, difference: float) -> SourceComparison:
    """Two figures so far apart, in the unit of the quantity's row, with a standard deviation of `STD`."""
    return SourceComparison(50.0, quantity, "one figure", "another figure", difference, STD)
