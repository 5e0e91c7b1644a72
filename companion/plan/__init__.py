"""Plan: the mission's state machine, the fuzzy speed controller and the minimum-jerk reference."""
