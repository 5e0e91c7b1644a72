"""What the autopilot tells: state, readings, its own sensors."""
