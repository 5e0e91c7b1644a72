"""The world about somebody else's autopilot, in real time."""
