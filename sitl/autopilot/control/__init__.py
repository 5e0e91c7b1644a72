"""The control cascade of both autopilots."""
