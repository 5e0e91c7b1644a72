"""`calibrate-magnetometer`."""
