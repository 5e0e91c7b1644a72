"""The real PX4 and ArduCopter as the simulated vehicle's autopilot: our world is the physics, in lockstep."""
