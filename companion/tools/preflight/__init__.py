"""`companion check` without anything held in the hand: the preflight check."""
