"""The simulated autopilot's MAVLink: endpoint, protocols, streams."""
