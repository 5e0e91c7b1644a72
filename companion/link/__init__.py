"""Link: setpoints, telemetry and actions to and from the autopilot over MAVLink."""
