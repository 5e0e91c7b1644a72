"""What the autopilot reports: state, readings, its own sensors."""
