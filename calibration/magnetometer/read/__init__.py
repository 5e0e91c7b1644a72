"""Reads samples: tables, logs and an autopilot's messages."""
