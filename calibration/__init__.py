"""Calibration a person can do in the field: magnetometer, camera, and how they are mounted."""
