"""The calibration board: its description, its shape and its print."""
