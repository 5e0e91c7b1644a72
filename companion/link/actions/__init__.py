"""Actions to the autopilot: arm, take off, land, change mode."""
