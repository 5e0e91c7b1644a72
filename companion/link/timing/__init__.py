"""The autopilot's clock on ours."""
