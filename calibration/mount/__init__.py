"""`calibrate-mount`."""
