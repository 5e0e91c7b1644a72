"""Calibrates the accelerometer and the gyroscope from static intervals."""
