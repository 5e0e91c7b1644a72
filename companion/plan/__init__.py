"""Plan: the mission's state machine, the fuzzy pilot's speed and the minimum-jerk reference."""
