"""ArduPilot's profile."""
