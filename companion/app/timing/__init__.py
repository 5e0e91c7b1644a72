"""When control cycles begin, and what a cycle does that comes late."""
