"""The calibration file, the figures and the pictures."""
